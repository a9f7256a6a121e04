"""Which effect of the catalogue was left out: full refits, compared on cycles that were held out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from shj_bayes.inference.posterior import FREE_LIMIT
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import Refit, View, linearise, promising_starts, refit
from shj_bayes.mismatch.thresholds import AS_GOOD, RIVAL_PROBABILITY, RIVAL_SE
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.parameters import FloatArray

N_BOOTSTRAP = 2000
ROUNDS, FEW_ROUNDS = 40, 3
BEHIND = 0.3  # of the best gain on few samples


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect, fitted in full beside the base parameters.

    Parameters
    ----------
    effect : Effect
        What was tried.
    fit : Refit
        The augmented model.
    gain : array, shape (n_blocks,)
        Fall of the held-out sum of squares of each block, kN^2.
    relative : array, shape (n_blocks,)
        Logarithm of the held-out sum of squares without the effect over that with it.
    size_kN : float
        99th percentile of the force the effect makes, kN.
    """

    effect: Effect
    fit: Refit
    gain: FloatArray
    relative: FloatArray
    size_kN: float

    @property
    def t(self) -> float:
        """Student's t of the relative gain over blocks.

        The gains themselves differ by the length of the blocks and the size of the misfit in each, so their mean over
        its standard error stays small when an effect sits in a few blocks, however large it is there.
        """
        spread = float(self.relative.std(ddof=1))
        return float(np.sqrt(self.relative.size) * self.relative.mean() / spread) if spread > 0 else 0.0

    @property
    def without_best(self) -> float:
        """Share of the gain that is left without the block that gains most."""
        total = float(self.gain.sum())
        return 1.0 - float(self.gain.max()) / total if total > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Ranking:
    """All candidates, best first, with what the comparison says.

    Parameters
    ----------
    candidates : tuple of Candidate
        By held-out gain.
    elpd_gain : array, shape (n_candidates,)
        Gain in expected log predictive density of held-out blocks.
    probability : array, shape (n_candidates,)
        Share of resampled sets of blocks in which the candidate is best.
    """

    candidates: tuple[Candidate, ...]
    elpd_gain: FloatArray
    probability: FloatArray

    def excluded(self) -> list[bool]:
        """For each candidate, whether the best one beats it beyond chance, by gain or by relative gain."""
        best = self.candidates[0]
        pairs = zip(self.candidates[1:], self.probability[1:].tolist(), strict=True)
        return [False, *(_beats(best, other) and share < RIVAL_PROBABILITY for other, share in pairs)]


def try_all(evidence: Evidence, base: Refit, effects: Sequence[Effect], *, coarse: Evidence) -> list[Candidate]:
    """Fit the current model with each further effect.

    Parameters
    ----------
    evidence : Evidence
        The recordings.
    base : Refit
        The current model, fitted; it may hold effects already.
    effects : sequence of Effect
        To be tried one at a time.
    coarse : Evidence
        The same recordings with fewer samples: starts are chosen on it.

    Returns
    -------
    list of Candidate
    """
    rough = linearise(coarse, base.model, base.z)
    ends = []
    for effect in effects:
        model = base.model.with_effects((*base.model.effects, effect))
        ends.append(refit(coarse, model, promising_starts(coarse, rough, model, effect), sigma_kN=base.rmse_kN))
    gains = [rough.rmse_kN**2 - end.rmse_kN**2 for end in ends]
    before = base.held_out_squares(evidence)
    out = []
    for effect, end, gain in zip(effects, ends, gains, strict=True):
        # Those far behind are polished less: their place behind does not hang on the last digits.
        ahead = gain > BEHIND * max(gains)
        fit = refit(evidence, end.model, [end.z], rounds=ROUNDS if ahead else FEW_ROUNDS, sigma_kN=base.rmse_kN)
        out.append(compare(evidence, before, fit, effect, check=ahead))
    return out


def compare(evidence: Evidence, before: FloatArray, fit: Refit, effect: Effect, *, check: bool = True) -> Candidate:
    """Hold a fitted model against the one without its effect, whose held-out squares are `before`."""
    after = fit.held_out_squares(evidence, check=check)
    tiny = 1e-12 * float(before.sum()) + 1e-300
    relative = np.log(np.maximum(before, tiny) / np.maximum(after, tiny))
    return Candidate(effect, fit, before - after, relative, effect_size(evidence, fit, effect))


def effect_size(evidence: Evidence, fit: Refit, effect: Effect) -> float:
    """Force that an effect makes in a fitted model: 99th percentile of the change when it is taken out, kN."""
    without = fit.z.copy()
    for i, name in enumerate(fit.model.law_names):
        owner, _, parameter = name.partition(".")
        if owner == effect.id and parameter in effect.neutral:
            neutral = np.asarray(_inside(fit, i, effect.neutral[parameter]))
            without[i] = float(fit.model.laws_of_parameters[i].to_free(neutral))
    change = np.abs(fit.force_kN - View(evidence, fit.model).force(np.clip(without, -FREE_LIMIT, FREE_LIMIT)))
    return float(np.percentile(change[evidence.weight > 0], 99))


def _inside(fit: Refit, i: int, value: float) -> float:
    """Neutral value moved just inside the law's support (a lognormal size is never quite 0)."""
    prior = fit.model.laws_of_parameters[i]
    if prior.law in ("uniform", "loguniform"):
        width = 1e-9 * (prior.b - prior.a)
        return min(max(value, prior.a + width), prior.b - width)
    return max(value, 1e-9 * prior.a) if prior.law == "lognormal" else value


def _simplest(candidates: Sequence[Candidate], best: int, may_enter: Mapping[int, Callable[[], bool]]) -> int:
    """Index of the candidate with fewest parameters among the best one and those it does not beat beyond chance.

    `may_enter` goes from the largest gain down. It is dear, so only those are asked that could come before the best.
    """
    first = best
    enough = AS_GOOD * float(candidates[best].gain.sum())
    for i, may in may_enter.items():
        fewer = len(candidates[i].effect.parameters) < len(candidates[first].effect.parameters)
        as_good = float(candidates[i].gain.sum()) >= enough and not _beats(candidates[best], candidates[i])
        if fewer and as_good and may():
            first = i
    return first


def _beats(best: Candidate, other: Candidate) -> bool:
    """Whether one candidate beats another beyond chance, by gain or by relative gain."""
    pairs = ((best.gain, other.gain), (best.relative, other.relative))
    return any(ahead_beyond_chance(a - b) for a, b in pairs)


def ahead_beyond_chance(apart: FloatArray) -> bool:
    """Whether a difference over blocks, shape (n_blocks,), is above 0 by more standard errors than chance gives."""
    return float(apart.sum()) > RIVAL_SE * float(np.sqrt(apart.size) * apart.std(ddof=1))


def _worth(evidence: Evidence, residual: FloatArray) -> float:
    """Log density that a fall of the sum of squares is worth, 1/kN^2, in noise as correlated as this residual.

    Correlated samples are worth less than independent ones: by what the sums over half-cycles vary more than sums of
    independent samples would. The lag-one correlation alone takes slow drift for evidence (24 nats for a step in it).
    """
    total = max(float(residual @ residual), 1e-300)
    variance = total / max(float(evidence.weight.sum()), 1.0)
    phi = min(max(float(residual[:-1] @ residual[1:]) / total, 0.0), 0.99)
    slow = float(np.sum(evidence.half_cycle_sums(residual) ** 2)) / total
    return 1 / (2 * variance * max(slow, (1 + phi) / (1 - phi)))


def rank(
    evidence: Evidence,
    candidates: Sequence[Candidate],
    rng: np.random.Generator,
    admits: Callable[[Candidate, float], bool] = lambda candidate, nats: True,
) -> Ranking:
    """Compare candidates on held-out blocks.

    The best is the one of largest gain among those that `admits` (called with the gain in nats) lets in; among all,
    when there is none. Of those that it does not beat beyond chance the one with fewest parameters comes first: a
    change of clamping in one direction for the whole test fits as well as an asymmetry, by all its four parameters.

    Gains are turned into log density with the noise of the best candidate: its held-out variance, and the factor
    (1 - phi)/(1 + phi) by which correlated samples are worth less than independent ones.
    """
    gains = np.stack([c.gain for c in candidates])
    order = np.argsort(-gains.sum(axis=1), kind="stable")
    worth = _worth(evidence, candidates[int(order[0])].fit.residual_kN)
    may_enter = {int(i): partial(admits, candidates[i], worth * float(gains[i].sum())) for i in order}
    best = next((i for i, may in may_enter.items() if may()), None)
    first = order[0] if best is None else _simplest(candidates, best, may_enter)
    order = np.array([first, *(i for i in order if i != first)])
    gains = gains[order]
    nats = gains * worth
    weights = rng.dirichlet(np.ones(evidence.n_blocks), size=N_BOOTSTRAP)
    winner = np.argmax(weights @ nats.T, axis=1)
    return Ranking(
        candidates=tuple(candidates[int(i)] for i in order),
        elpd_gain=nats.sum(axis=1),
        probability=np.bincount(winner, minlength=len(candidates)) / N_BOOTSTRAP,
    )
