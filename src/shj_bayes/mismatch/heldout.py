"""Cycles that are left out: what a model gains there, and what is not borne out."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes.inference.convergence import cycles_through
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.findings import Answer, Reason, answer_of
from shj_bayes.mismatch.hypothesis import ALPHA, Hypothesis, without
from shj_bayes.mismatch.laplace import Laplace, laplace, laplace_under
from shj_bayes.mismatch.moves import Search
from shj_bayes.results.codec import finite
from shj_bayes.results.diagnosis import DiagnosisVerdict, Dropped

FEW_CYCLES = 12  # with fewer cycles than this, half-cycles are left out
PARTS = 8  # the model is fitted anew so many times, each time without every eighth cycle


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Prediction of each cycle by a fit that did not see it.

    The first cycle of a run is never left out: only it tells of the state in which the run began.
    """

    residual: FloatArray  # shape (n,): measured less predicted force of each block, kN; 0 where nothing was left out
    # squares, count, log_density: shape (n_cycles,), of each cycle that was left out: sum of the squares of its
    # residual (kN2), its blocks, its log predictive density but for a constant that is the same for all models (nats)
    squares: FloatArray
    count: FloatArray
    log_density: FloatArray

    @property
    def rmse_kN(self) -> float:
        """Root mean square of the residual of what was left out, kN."""
        return math.sqrt(float(self.squares.sum() / max(self.count.sum(), 1.0)))


@dataclass(frozen=True)
class Gain:
    """What a model predicts better than another one: of cycles that neither saw."""

    elpd: float  # log predictive density over that of the other model, nats
    elpd_se: float  # its standard error over cycles
    before_kN: float  # error of the other model
    after_kN: float  # and of this one
    rmse_se_kN: float  # standard error of their difference

    @classmethod
    def of(cls, before: HeldOut, after: HeldOut) -> "Gain":
        """Compare two models on the same cycles, the standard errors being those over cycles."""
        n, gain = before.count.size, after.log_density - before.log_density
        errors = [one.rmse_kN for one in (before, after)]
        # Influence of each cycle on the difference of the two errors.
        moved = np.zeros(n)
        for sign, one, error in zip((-1.0, 1.0), (before, after), errors, strict=True):
            moved += sign * (one.squares - one.count * error**2) / max(2.0 * error * one.count.sum(), 1e-300)
        scale = math.sqrt(n / (n - 1)) if n > 1 else 0.0
        spread = float(np.linalg.norm(gain - gain.mean())) if n > 1 else 0.0
        return cls(float(gain.sum()), scale * spread, errors[0], errors[1], scale * float(np.linalg.norm(moved)))

    @property
    def is_worse(self) -> bool:
        """Whether the error has grown by more than its own standard error, or is no number."""
        return not self.after_kN <= self.before_kN + self.rmse_se_kN

    @property
    def improves(self) -> bool:
        """Whether what was left out is predicted better."""
        return self.elpd > 0.0 and not self.is_worse


def cycles_of(data: BinnedData) -> IntArray:
    """Cycle of each block, counted through all runs; half-cycles where there are few cycles."""
    blocks = [np.diff(part.timing.half) for part in data.blocks]  # of each half-cycle
    n_half = [own.size for own in blocks]
    cycle = cycles_through(n_half, 2 if sum(n_half) // 2 >= FEW_CYCLES else 1)
    return np.repeat(cycle, np.concatenate(blocks))


def places_left_out(data: BinnedData) -> tuple[IntArray, int]:
    """Give for each block the place of its cycle among those that are left out (below 0: it is not), and their number.

    The first cycle of a run is none of them.
    """
    cycle = cycles_of(data)
    sizes = [part.n for part in data.blocks]
    first = np.isin(cycle, cycle[np.cumsum([0, *sizes[:-1]])])
    numbers, place = np.unique(np.where(first | (data.blocks.used == 0), -1, cycle), return_inverse=True)
    n_left = int(np.count_nonzero(numbers >= 0))
    return place - (numbers.size - n_left), n_left


def held_out(metric: ErrorModel, state: Laplace) -> HeldOut:
    """Predict cycles with a model that is fitted without them, from where it is with them, until it stands.

    Every eighth cycle is left out at a time, so that each is told from neighbours as in a test of other cycles. A
    prediction holds the error of the zero and what else is integrated out at its mean, but for the generic
    discrepancy, which is no prediction.
    """
    data = metric.data
    evidence, (place, n_left) = data.blocks.used > 0, places_left_out(data)
    residual, density = np.zeros(evidence.size), np.zeros(n_left, dtype=np.float64)
    n_parts = min(PARTS, n_left)
    for part in range(n_parts):
        left = (place >= 0) & (place % n_parts == part)
        rest = ErrorModel(data, metric.setting, metric.slope, ~left[evidence])
        try:
            refit = laplace(rest, state.model, state.z)
            predicted = refit.residual - rest.integrated_out(refit.residual)[1]
        except np.linalg.LinAlgError:  # no prediction without these cycles
            predicted = np.full(evidence.size, np.inf)
        residual[left] = predicted[left]
        news = metric.setting.whitened(data, np.nan_to_num(predicted[:, None], posinf=1e30), metric.slope)[0][:, 0]
        own = left[evidence]
        density += np.bincount(place[evidence][own], weights=-0.5 * news[own] ** 2, minlength=n_left)
    counted = place >= 0
    count = np.bincount(place[counted], minlength=n_left).astype(np.float64)
    squares = np.bincount(place[counted], weights=residual[counted] ** 2, minlength=n_left)
    return HeldOut(residual, np.asarray(squares, dtype=np.float64), count, density)


@dataclass(frozen=True, eq=False)
class Proven:
    """An answer whose dependences all improve what was left out."""

    out: Search  # the search, without the hypotheses that hold what was dropped
    answer: Answer
    fine: BinnedData  # the recordings in blocks as fine as those of a fit of the model that is shown
    # before, after: the base law in them and the model that is shown, under the noise of the latter; one state where
    # nothing is shown
    before: Laplace
    after: Laplace
    held: tuple[HeldOut, HeldOut]  # of both
    dropped: tuple[Dropped, ...] = ()  # in the order in which they were dropped

    @property
    def gain(self) -> Gain:
        """What the model that is shown predicts better than the base law."""
        return Gain.of(*self.held)


def proven(out: Search, tell: Callable[[str], None] = lambda _: None) -> Proven:
    """Weigh what a finished search found, and drop what does not improve cycles that were left out.

    The dependence that is dropped is the one without which they are predicted best; the others are weighed anew, and it
    does not come back. What is then still missing, but has no dependence left that improves anything, is unknown.
    """
    dropped: tuple[Dropped, ...] = ()
    missing = False
    while True:
        answer = answer_of(out, [one.class_ for one in dropped])
        tell("predicting cycles that were left out")
        shown = _left_out(out, answer)
        if not dropped:
            missing = bool(answer.findings) and dict(answer.sets).get(frozenset(), 0.0) < ALPHA
        worst = _worst(shown)
        if worst is None:
            break
        tell(f"{worst.class_} does not improve cycles that were left out")
        dropped += (worst,)
        out = _less(out, answer.shown, worst.class_)
    if missing and not answer.findings and not out.chatter:  # whose teeth are in all that was found
        answer = replace(answer, verdict=DiagnosisVerdict.UNKNOWN, reason=Reason.NOT_BORNE_OUT)
    return replace(shown, answer=answer, dropped=dropped)


def _less(out: Search, shown: Hypothesis, of: str) -> Search:
    """Give a search without the hypotheses that hold a class, and with the shown one less that class."""
    found = {key: h for key, h in out.found.items() if of not in key}
    if shown.key - {of} not in found:
        place = [member.of.id for member in shown.members].index(of)
        fitted = out.fitter.fitted(*without(out.data, shown, place))
        rest = None if fitted is None else out.fitter.with_own_noise(fitted, out.metric.setting)
        found |= {} if rest is None else {rest.key: rest}
    best = max(found.values(), key=lambda h: h.log_weight)
    return replace(out, found=found, fitter=replace(out.fitter, metric=best.metric or out.metric))


def _left_out(out: Search, answer: Answer) -> Proven:
    """Fit the base law and the model of an answer, in blocks as fine as those of a fit, and leave cycles out."""
    h, base, setting = answer.shown, out.found[frozenset()].state, out.metric.setting
    fine = out.data.finer_at(h.state.model, h.state.z)
    metric, before = laplace_under(fine, setting, base.model, base.z)
    if not answer.findings:
        alone = held_out(metric, before)
        return Proven(out, answer, fine, before, before, (alone, alone))
    after = laplace_under(fine, setting, h.state.model, h.state.z)[1]
    metric = ErrorModel(fine, setting, after.slope)
    return Proven(out, answer, fine, before, after, (held_out(metric, before), held_out(metric, after)))


def _worst(shown: Proven) -> Dropped | None:
    """Find the dependence without which what was left out is predicted best; None where each improves it."""
    if not shown.answer.findings:
        return None
    fine, setting, members = shown.fine, shown.out.metric.setting, shown.answer.shown.members
    metric, gains = ErrorModel(fine, setting, shown.after.slope), []
    for place in range(len(members)):
        rest = shown.held[0]
        if len(members) > 1:
            less, z = without(fine, replace(shown.answer.shown, state=shown.after), place)
            state = laplace_under(fine, setting, shown.out.fitter.model_of(less), z)[1]
            rest = held_out(metric, state)
        gains.append(Gain.of(rest, shown.held[1]))
    if all(gain.improves for gain in gains) and not shown.gain.is_worse:
        return None
    place = int(np.argmin([gain.elpd if np.isfinite(gain.elpd) else -np.inf for gain in gains]))
    worst = gains[place]
    told = finite((worst.elpd, worst.before_kN, worst.after_kN))
    return Dropped(class_=members[place].of.id, elpd_gain=told[0], without_kN=told[1], with_kN=told[2])
