"""Whether independent ensembles agree, whether the cycles do, and the verdict on a fit.

An interval that does not trust the noise model goes by how much the parameters scatter from cycle to cycle.
The infinitesimal jackknife (Giordano, Stephenson, Liu, Jordan and Broderick 2019, AISTATS; the sandwich of Huber
1967): with the score g_c of cycle c and the covariance S of the posterior, the parameters scatter as
S (sum g_c g_c') S, whatever the noise is. Where the model holds this is S again. A law that is a little wrong is wrong
alike in all cycles of one amplitude, so stretches of equal amplitude are left out as well; the wider of both counts.

What chance does: cycles tell unequally much, so the sum over few that tell nearly all scatters more than one over many.
With the information I_c of a cycle, v_c = (S I_c S)_pp, the sum for parameter p has (sum v)^2 / sum v^2 degrees of
freedom (Satterthwaite 1946, Biometrics Bulletin 2, 110-114). The score of a variance is the square of few independent
numbers, two or so of a slow noise in a cycle: its square scatters four times as much as that of a normal one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtri, ndtri

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.start import Start
from shj_bayes.model.filter import whiten
from shj_bayes.results.fit import Trust

TAILS = (0.05, 0.95)
FEWEST_ABOVE, EVEN = 5, 1e-9  # weights that a law is fitted to; of the largest weight: rounding
CHANCE = 0.01  # of calling the intervals of a right model too narrow, over all its parameters
SAME_AMPLITUDE = 0.05  # of the largest: cycles of one stretch
OF_VARIANCES = 4.0  # by how much the squares of their scores scatter more
FEWEST = 6  # pieces; fewer say too little of their scatter
STEP = 0.1  # of a posterior standard deviation, for the scores


def rhat(chains: FloatArray) -> float:
    """Rank-normalised split R-hat of one scalar, the larger of bulk and folded; chains of shape (n_chains, n_draws)."""
    halves = _split(chains)
    return max(_rhat(_normal_scores(halves)), _rhat(_normal_scores(np.abs(halves - np.median(halves)))))


def ess_bulk(chains: FloatArray) -> float:
    """Bulk effective sample size of one scalar, chains of shape (n_chains, n_draws)."""
    return _ess(_normal_scores(_split(chains)))


def ess_tail(chains: FloatArray) -> float:
    """Effective sample size of the 5 and 95 % quantiles, the smaller; chains of shape (n_chains, n_draws)."""
    return min(_ess(_split(chains <= edge).astype(np.float64)) for edge in np.quantile(chains, TAILS))


def _split(chains: FloatArray) -> FloatArray:
    """Halves of the chains as chains; of an odd number of draws the middle one is left out."""
    half = chains.shape[1] // 2
    return np.concatenate([chains[:, :half], chains[:, -half:]])


def _normal_scores(chains: FloatArray) -> FloatArray:
    """Turn draws into normal scores of their ranks among all; ties get their mean rank."""
    _, place, count = np.unique(chains, return_inverse=True, return_counts=True)
    rank = np.cumsum(count) - 0.5 * (count - 1.0)
    return np.asarray(ndtri((rank[place] - 0.375) / (chains.size + 0.25)).reshape(chains.shape))


def _rhat(chains: FloatArray) -> float:
    n = chains.shape[1]
    between, within = n * chains.mean(axis=1).var(ddof=1), chains.var(axis=1, ddof=1).mean()
    return float(np.sqrt((between / within + n - 1) / n))


def _ess(chains: FloatArray) -> float:
    """Effective sample size by Geyer's initial monotone sequence."""
    if np.ptp(chains) < np.finfo(float).resolution:
        return float(chains.size)
    n_chains, n = chains.shape
    spectrum = np.abs(rfft(chains - chains.mean(axis=1, keepdims=True), next_fast_len(2 * n), axis=1)) ** 2
    covariance = irfft(spectrum, next_fast_len(2 * n), axis=1)[:, :n].mean(axis=0) / n
    within = covariance[0] * n / (n - 1.0)
    total = covariance[0] + (chains.mean(axis=1).var(ddof=1) if n_chains > 1 else 0.0)
    rho = 1.0 - (within - covariance) / total
    rho[0] = 1.0
    even, odd = rho[0 : n // 2 * 2 : 2], rho[1 : n // 2 * 2 : 2]
    last = max(0, (n - 3) // 2)  # the last pair that is looked at, or the first that is not above 0
    negative = np.flatnonzero(even[: last + 1] + odd[: last + 1] <= 0)
    last = min(last, int(negative[0])) if negative.size else last
    pairs = np.minimum.accumulate((even + odd)[:last])
    rest = even[last] if even[last] > 0 or even[last] + odd[last] >= 0 else 0.0
    tau = max(-1.0 + 2.0 * float(pairs.sum()) + float(rest), 1.0 / np.log10(chains.size))
    return float(chains.size / tau)


def pareto_k(log_weights: FloatArray) -> float:
    """Shape of the generalised Pareto law of the largest weights, shape (n,): above 0.7 few draws carry all of them.

    Vehtari, Simpson, Gelman, Yao and Gabry 2024, J. Mach. Learn. Res. 25, 72; the law is fitted as by Zhang and
    Stephens 2009, Technometrics 51, 316.
    """
    n = log_weights.size
    weights = np.exp(np.sort(log_weights) - log_weights.max())
    n_tail = int(np.ceil(min(0.2 * n, 3.0 * np.sqrt(n))))
    above = weights[-n_tail:] - weights[-n_tail - 1]
    above = above[above > 0.0]
    if above.size < FEWEST_ABOVE:
        return 0.0 if np.ptp(weights) < EVEN else float("inf")
    m = 30 + int(np.sqrt(above.size))
    b = 1.0 - np.sqrt(m / (np.arange(1, m + 1) - 0.5))
    b = b / (3.0 * above[int(above.size / 4.0 + 0.5) - 1]) + 1.0 / above[-1]
    shape = np.log1p(-b[:, None] * above).mean(axis=1)
    height = above.size * (np.log(-b / shape) - shape - 1.0)
    share = np.exp(height - height.max())
    share[share < 10.0 * np.finfo(float).eps * share.sum()] = 0.0
    found = np.log1p(-float(np.average(b, weights=share)) * above).mean()
    return float((above.size * found + 5.0) / (above.size + 10.0))


RHAT_LIMIT, ESS_LIMIT, TAU_LIMIT = 1.01, 1000.0, 50.0
ACCEPTANCE_LIMIT = 0.05


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Convergence figures of each parameter (arrays of shape (d,)) and of each ensemble."""

    names: tuple[str, ...]
    tau: FloatArray  # shape (d,): integrated autocorrelation time, steps (mean over ensembles)
    rhat: FloatArray  # shape (d,): rank-normalised split R-hat across ensembles
    # ess_bulk, ess_tail: shape (d,): effective sample sizes, the smaller of both estimates for the bulk
    ess_bulk: FloatArray
    ess_tail: FloatArray
    acceptance: FloatArray  # shape (n_ensembles, n_walkers): accepted share of proposals of each walker
    # n_steps, n_burn: steps kept for the posterior, and dropped before them
    n_steps: int
    n_burn: int
    n_failed: int = 0  # evaluations whose density was zero or overflowed

    @property
    def lengths(self) -> float:
        """Steps kept in units of the longest autocorrelation time."""
        return float(self.n_steps / self.tau.max())


@dataclass(frozen=True)
class FitVerdict:
    """How far a fit may be trusted, with reasons and advice in words."""

    word: Trust
    reasons: tuple[str, ...]


def burn_in(tau: float, n_total: int) -> int:
    """Count the steps to drop: ten autocorrelation times, at most half of what there is."""
    return min(int(np.ceil(10 * tau)), n_total // 2)


def autocorrelation_time(chains: Sequence[FloatArray]) -> FloatArray:
    """Integrated autocorrelation time of each parameter, mean over ensembles, shape (d,), in steps.

    The same number as `emcee.autocorr.integrated_time`, all walkers in one transform: one after the other they took a
    tenth of a fit.
    """
    mean = np.mean([_time_of_ensemble(chain) for chain in chains], axis=0)
    # Where a walker never moves, what is left after subtracting its mean is rounding, and looks like white noise.
    moves = np.all([np.ptp(chain, axis=0).min(axis=0) > 0 for chain in chains], axis=0)
    return np.where(np.isfinite(mean) & moves, np.maximum(mean, 1.0), np.inf)


def _time_of_ensemble(chain: FloatArray) -> FloatArray:
    """Autocorrelation summed over the shortest lag that is five times that sum (Sokal), shape (d,)."""
    n = chain.shape[0]
    spectrum = np.abs(rfft(chain - chain.mean(axis=0), 2 * next_fast_len(n), axis=0)) ** 2
    correlation = irfft(spectrum, 2 * next_fast_len(n), axis=0)[:n]
    with np.errstate(divide="ignore", invalid="ignore"):  # 0/0 for walkers that stand still
        times = 2.0 * np.cumsum(np.mean(correlation / correlation[0], axis=1), axis=0) - 1.0
    inside = np.arange(n)[:, None] < 5.0 * times
    last = np.where(inside.all(axis=0), n - 1, np.argmin(inside, axis=0))
    return np.asarray(times[last, np.arange(times.shape[1])])


def diagnose_chains(
    names: tuple[str, ...], chains: Sequence[FloatArray], acceptance: FloatArray, n_failed: int = 0
) -> Diagnostics:
    """Convergence figures of chains of shape (n_steps, n_walkers, d), one per ensemble, all steps from the start.

    `acceptance` are the accepted shares, shape (n_ensembles, n_walkers); `n_failed` is passed through.
    """
    n_total = chains[0].shape[0]
    # The walkers start from a wide ball: the first fifth would lengthen the time that decides how much to drop.
    rough = autocorrelation_time([chain[n_total // 5 :] for chain in chains])
    burn = burn_in(float(rough.max()), n_total) if np.isfinite(rough).all() else n_total // 2
    kept = np.stack([chain[burn:] for chain in chains])
    tau = autocorrelation_time(list(kept))
    n_ensembles, n_steps, n_walkers, d = kept.shape
    by_ensemble = kept.reshape(n_ensembles, n_steps * n_walkers, d)
    by_walker = kept.transpose(0, 2, 1, 3).reshape(n_ensembles * n_walkers, n_steps, d)
    agreement, bulk, tail = (np.empty(d) for _ in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):  # 0/0 for walkers that stand still
        for i in range(d):
            agreement[i] = rhat(by_ensemble[:, :, i])
            bulk[i] = min(ess_bulk(by_walker[:, :, i]), n_ensembles * n_walkers * n_steps / tau[i])
            tail[i] = ess_tail(by_walker[:, :, i])
    # A parameter on which all walkers stand still has no variance: its R-hat is not a number, and that is not good.
    agreement = np.where(np.isfinite(agreement), agreement, np.inf)
    bulk, tail = (np.where(np.isfinite(values), values, 0.0) for values in (bulk, tail))
    return Diagnostics(names, tau, agreement, bulk, tail, np.asarray(acceptance), n_steps, burn, n_failed)


def judge(d: Diagnostics) -> FitVerdict:
    """Verdict with reasons that say what to do.

    ``reliable``: for every parameter R-hat < 1.01 across ensembles, ESS (bulk and tail) >= 1000 and more than 50
    autocorrelation times, and no stuck walker. ``unusable``: R-hat > 1.1, ESS < 100 or half of the walkers stuck.
    Else ``tentative``.
    """
    problems: list[str] = []
    worst = int(np.argmax(d.rhat))
    if d.rhat[worst] >= RHAT_LIMIT:
        problems.append(
            f"R-hat of {d.names[worst]} is {d.rhat[worst]:.3f} across the ensembles (below {RHAT_LIMIT} is wanted): "
            "they have not agreed yet; run longer (--max-steps), and look for two peaks in the corner plot"
        )
    ess = np.minimum(d.ess_bulk, d.ess_tail)  # the 5 and 95 % points are printed too, so the tails count as well
    least = int(np.argmin(ess))
    if ess[least] < ESS_LIMIT:
        problems.append(
            f"effective sample size of {d.names[least]} is {ess[least]:.0f} ({ESS_LIMIT:.0f} is wanted); run longer"
        )
    if d.lengths < TAU_LIMIT:
        problems.append(
            f"the chain is {d.lengths:.0f} autocorrelation times long ({TAU_LIMIT:.0f} is wanted); run longer"
        )
    stuck = float(np.mean(d.acceptance < ACCEPTANCE_LIMIT))
    if stuck > 0:
        problems.append(
            f"{100 * stuck:.0f} % of the walkers accept fewer than {100 * ACCEPTANCE_LIMIT:.0f} % of their moves: "
            "the start or the priors do not suit the data"
        )
    if not problems:
        text = (
            f"the {d.acceptance.shape[0]} independent ensembles agree (R-hat at most {d.rhat.max():.3f}), effective "
            f"sample size at least {ess.min():.0f}, {d.lengths:.0f} autocorrelation times, "
            f"acceptance {d.acceptance.mean():.2f}"
        )
        return FitVerdict(Trust.RELIABLE, (text,))
    bad = d.rhat[worst] > 1.1 or ess[least] < 100 or stuck >= 0.5
    return FitVerdict(Trust.UNUSABLE if bad else Trust.TENTATIVE, tuple(problems))


@dataclass(frozen=True, eq=False)
class Widening:
    """By how much the intervals of a posterior must be wider for what the cycles scatter."""

    names: tuple[str, ...]
    factor: FloatArray  # shape (d,): widening of each parameter's interval, 1 or more
    # shape (d,): standard deviation from cycle to cycle over that of the posterior, as it was found
    scatter: FloatArray
    n_pieces: int  # pieces that were left out one at a time; 0 where there are too few to say

    @property
    def widened(self) -> tuple[str, ...]:
        """Parameters whose intervals are wider than the posterior."""
        return tuple(name for name, factor in zip(self.names, self.factor, strict=True) if factor > 1.0)

    def spread(self, chains: FloatArray, centre: FloatArray) -> FloatArray:
        """Widen draws in the unbounded space, shape (..., d), around a centre of shape (d,)."""
        return np.asarray(centre + (chains - centre) * self.factor)


def widening_of(likelihood: Likelihood, start: Start) -> Widening:
    """Compare the width of a posterior with the scatter from cycle to cycle at its top."""
    scores, information = _scores(likelihood, start), _information(likelihood, start)
    sd, n_law = np.sqrt(np.diag(start.covariance)), likelihood.model.n_law
    told = likelihood.model.predicted
    law = start.covariance[:n_law, :n_law]
    scatter, factor = np.zeros(sd.size), np.ones(sd.size)
    n_pieces = 0
    for pieces in (cycles_through([run.motion.n_half for run in likelihood.runs]), _stretches(likelihood)):
        n = int(pieces[-1]) + 1
        if n < FEWEST:
            continue
        n_pieces = max(n_pieces, n)
        of_piece = np.stack([np.bincount(pieces, weights=column, minlength=n) for column in scores.T], axis=1)
        moves = (of_piece - of_piece.mean(axis=0)) @ start.covariance
        ratio = np.sqrt(n / (n - 1) * np.sum(moves**2, axis=0)) / sd
        share = np.zeros((n, n_law, n_law))
        np.add.at(share, pieces, information)
        variance = np.einsum("ip,cij,jp->cp", law, share, law)
        free = np.full(sd.size, (n - 1) / OF_VARIANCES)
        free[:n_law] = variance.sum(axis=0) ** 2 / np.sum(variance**2, axis=0) * (n - 1) / n
        limit = np.sqrt(chdtri(free, CHANCE / told.sum() / 2.0) / free)
        scatter = np.maximum(scatter, ratio)
        factor = np.maximum(factor, np.where(told & (ratio > limit), ratio, 1.0))
    # The prior holds what the cycles do not: no interval need be wider than its own.
    factor = np.minimum(factor, np.maximum(1.0, 1.0 / sd))
    return Widening(likelihood.model.names, factor, scatter, n_pieces)


def _scores(likelihood: Likelihood, start: Start) -> FloatArray:
    """Give the derivatives of each half-cycle's log likelihood after the unbounded parameters, shape (n_half, d)."""
    width = STEP * np.sqrt(np.diag(start.covariance))
    points = np.concatenate([start.free + np.diag(width), start.free - np.diag(width)])
    value = likelihood.log_likelihood_by_half_cycle(likelihood.model.laws.natural(points))
    above, below = np.split(value, 2)
    return np.asarray(((above - below) / (2.0 * width[:, None])).T)


def _information(likelihood: Likelihood, start: Start) -> FloatArray:
    """Give what each half-cycle is expected to tell of the parameters of the law, shape (n_half, n_law, n_law)."""
    model, out = likelihood.model, []
    theta = likelihood.model.laws.natural(start.free[None])
    noise = {name: float(values[0]) for name, values in model.noise_values(theta).items()}
    width = STEP * np.sqrt(np.diag(start.covariance))[: model.n_law]
    moves = np.eye(start.free.size)[: model.n_law] * width[:, None]
    around = likelihood.model.laws.natural(np.concatenate([start.free + moves, start.free - moves]))
    for part in likelihood.blocks:
        above, below = np.split(part.residual_and_slope(part.force(model, around))[0], 2)
        slope = part.residual_and_slope(part.force(model, theta))[1][0]
        rows, _ = whiten(model.noise, noise, ((above - below) / (2.0 * width[:, None])).T, slope, part.timing)
        half = np.repeat(np.arange(part.timing.half.size - 1), np.diff(part.timing.half))[part.timing.kind >= 0]
        own = np.zeros((part.timing.half.size - 1, model.n_law, model.n_law))
        np.add.at(own, half, rows[:, :, None] * rows[:, None, :])
        out.append(own)
    return np.concatenate(out)


def cycles_through(n_half: Sequence[int], width: int = 2) -> IntArray:
    """Cycle of each half-cycle of runs that have so many, a cycle being `width` of them, numbered through all runs.

    The first half-cycle of a run is a quarter and joins the cycle after it.
    """
    out, count = [], 0
    for n in n_half:
        own = np.maximum(np.arange(n) - 1, 0) // width
        out.append(count + own)
        count += int(own[-1]) + 1
    return np.concatenate(out)


def _stretches(likelihood: Likelihood) -> IntArray:
    """Stretch of neighbouring half-cycles of equal amplitude that each half-cycle belongs to."""
    amplitudes = [history.amplitude_mm[history.motion.start[:-1]] for history in likelihood.histories]
    largest = likelihood.histories[0].half_stroke_mm
    run = np.concatenate([np.full(a.size, i) for i, a in enumerate(amplitudes)])
    place = np.round(np.concatenate(amplitudes) / (SAME_AMPLITUDE * largest))
    return np.concatenate([[0], np.cumsum((np.diff(place) != 0) | (np.diff(run) != 0))])
