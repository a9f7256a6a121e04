"""A formula for what the catalogue does not explain, where a simple one predicts the cycles it was not made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shj_bayes.mismatch.calibrate import Line
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.evolve import FULL, QUICK, evolve
from shj_bayes.mismatch.expression import Sum, evaluate
from shj_bayes.mismatch.formula_text import write_sum
from shj_bayes.mismatch.polish import polish
from shj_bayes.mismatch.profiles import AXES, MODES, Folded, fold, fold_time, signs
from shj_bayes.mismatch.thresholds import FORMULA_P, FORMULA_PART, FORMULA_SHARE, LINE
from shj_bayes.model.parameters import FloatArray

N_FLIPS = 4999
TIE = 0.03  # of what comes again: a shorter formula that is worse by less is preferred
WHERE = {
    "friction": "q is +1 in push and -1 in pull (friction: push and pull alike)",
    "force": "the same force in push and in pull",
    "push": "in push only",
    "pull": "in pull only",
}


@dataclass(frozen=True, eq=False)
class Formula:
    """A formula, or why there is none.

    Parameters
    ----------
    text : str or None
        One line with units, and what its variables mean.
    words : str
        How good it is, or why there is none; one sentence.
    coordinate : str
        What the residual is most regular over.
    mode : str
        ``friction``, ``force``, ``push`` or ``pull``.
    terms : Sum
        The formula over coordinate / scale, kN; empty when there is none.
    scale : float
        Of the coordinate.
    share, part : float
        Of the held-out sum of squares of the residual: of what comes again over the coordinate, and of all of it.
    """

    text: str | None
    words: str
    coordinate: str
    mode: str = ""
    terms: Sum = ()
    scale: float = 1.0
    share: float = 0.0
    part: float = 0.0


def most_regular(evidence: Evidence, residual: FloatArray, line: Line) -> Folded:
    """Residual over the coordinate over which most of it comes again on held-out cycles.

    Time is one of them only where the look for lines found one.
    """
    folded = [fold(evidence, residual, axis) for axis in AXES]
    if line.p_value < LINE:
        folded.append(fold_time(evidence, residual, line))
    return max(folded, key=lambda f: f.repeats / max(float(np.sum(residual[f.used & ~f.learn] ** 2)), 1e-300))


def find_formula(
    evidence: Evidence, residual: FloatArray, capacity_kN: float, line: Line, *, seed: int = 1, quick: bool = False
) -> Formula:
    """Look for a simple formula of a residual.

    Every other cycle is learnt from: mean residuals over the coordinate, in units of the sliding force and of the
    coordinate's range, go to symbolic regression. The others judge: of the formulas found, the shortest that is as good
    there as the best is kept, if it takes up most of what comes again and more than chance does.

    Parameters
    ----------
    evidence : Evidence
        The recordings.
    residual : array, shape (n,)
        Of the final model, kN.
    capacity_kN : float
        Sliding force of the first run.
    line : Line
        Strongest line over time in the residual.
    seed : int
        Same seed and residual, same formula.
    quick : bool
        Evolve less.

    Returns
    -------
    Formula
    """
    data = most_regular(evidence, residual, line)
    name = data.axis.name
    mode = max(MODES, key=lambda m: _repeats(data, m))
    learnt = _combined(data, mode)
    if data.repeats <= 0 or learnt[0].size < 10:
        return Formula(None, f"No formula: over {name} the misfit does not repeat from cycle to cycle.", name)
    x, y, weight = learnt
    found = evolve(x, y / capacity_kN, weight, seed=seed, effort=QUICK if quick else FULL)
    ladder = [_in_kN(terms, capacity_kN) for terms, _ in found]
    if name == "time":
        ladder = [_whole_turns(terms, learnt) for terms in ladder]
    share = np.array([_share(data, mode, terms) for terms in ladder])
    best = int(np.flatnonzero(share >= share.max() - TIE)[0])
    terms = ladder[best]
    gain, part, p_value = _held_out(evidence, data, residual, mode, terms, seed)
    if share[best] < FORMULA_SHARE or not gain > 0:
        words = (
            f"none of a few numbers takes up more than {_percent(share[best])} % of the misfit that repeats over {name}"
        )
    elif len(terms) == 1 and terms[0].key == (0, ()):
        words = f"over {name} a constant of {terms[0].size:.2g} kN ({_side(mode)}) says as much as any formula"
    elif p_value > FORMULA_P:
        words = f"on held-out cycles the best one does no better than chance may (p = {p_value:.2g})"
    elif part < FORMULA_PART:
        words = f"the best one takes up only {_percent(part)} % of the misfit of the held-out cycles"
    else:
        return Formula(
            _text(data, mode, terms),
            f"On cycles that were held out, the formula takes up {_percent(share[best])} % of the misfit that repeats "
            f"over {name}, and {_percent(part)} % of the whole, noise included. Residual: measured less modelled.",
            name,
            mode,
            terms,
            data.scale,
            float(share[best]),
            part,
        )
    return Formula(None, f"No formula: {words}.", name, mode, (), data.scale, float(share[best]), part)


def _percent(share: float) -> str:
    return f"{100 * min(max(share, 0.0), 1.0):.0f}"


def _side(mode: str) -> str:
    return {"friction": "along the motion", "force": "in both directions"}.get(mode, f"in {mode}")


def _text(data: Folded, mode: str, terms: Sum) -> str:
    axis = data.axis
    line = write_sum(terms, axis.symbol, data.scale, axis.unit)
    if mode == "friction":
        line = f"q * ({line})" if len(terms) > 1 else f"q * {line}"
    meaning = axis.meaning
    if axis.name == "time" and not _all_whole(terms):
        meaning = f"{meaning}, less whole periods of {data.scale:.3g} s"
    if "step(" in line:
        meaning += "; step(u) = (1 + tanh u) / 2"
    return f"residual [kN] = {line}; {meaning}; {WHERE[mode]}"


def _repeats(data: Folded, mode: str) -> float:
    """Part of what comes again that one formula for push and pull can take up, kN^2."""
    early, late = _combined(data, mode), _combined(data, mode, late=True)
    if early[0].size == 0 or late[0].size == 0:
        return 0.0
    return float(np.sum(late[2] * late[1] * np.interp(late[0], early[0], early[1])))


def _combined(data: Folded, mode: str, *, late: bool = False) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge push and pull: coordinate, mean residual times the sign of the direction, number of samples; in order."""
    profile = data.late if late else data.early
    sign = np.array(signs(mode))[:, None]
    count = profile.count * np.abs(sign)
    total = count.sum(axis=0)
    own = np.flatnonzero(total)
    own = own[np.argsort(((profile.x * count).sum(axis=0)[own] / total[own]), kind="stable")]
    x = (profile.x * count).sum(axis=0)[own] / total[own]
    y = (profile.mean_kN * count * sign).sum(axis=0)[own] / total[own]
    return x, y, total[own]


def _in_kN(terms: Sum, capacity: float) -> Sum:
    return tuple(type(t)(t.size * capacity, t.degree, t.factors) for t in terms)


def _share(data: Folded, mode: str, terms: Sum) -> float:
    """Held-out share of what comes again over the coordinate that a formula takes up."""
    late, gain = data.late, 0.0
    for side, sign in enumerate(signs(mode)):
        value = sign * evaluate(terms, late.x[side])
        gain += float(np.sum(late.count[side] * (2 * late.mean_kN[side] * value - value**2)))
    return gain / max(data.repeats, 1e-300)


def _held_out(
    evidence: Evidence, data: Folded, residual: FloatArray, mode: str, terms: Sum, seed: int
) -> tuple[float, float, float]:
    """Gain on held-out samples in kN^2, the same as a share of their sum of squares, and the chance of such a score.

    The chance is that of whole half-cycles with random signs; samples are not independent.
    """
    held = data.used & ~data.learn
    sense = evidence.stack("direction")
    sign = np.where(sense > 0, *signs(mode))
    value = sign * evaluate(terms, data.x)
    gain = float(np.sum((2 * residual * value - value**2)[held]))
    scores = np.bincount(data.half_cycle[held], weights=(residual * value)[held])
    flips = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(8,))).choice(
        [-1.0, 1.0], size=(N_FLIPS, scores.size)
    )
    chance = (1 + np.count_nonzero(flips @ scores >= scores.sum())) / (N_FLIPS + 1)
    return gain, gain / max(float(np.sum(residual[held] ** 2)), 1e-300), float(chance)


def _whole_turns(terms: Sum, learnt: Sequence[FloatArray]) -> Sum:
    """Give a wave over the time within a period a whole number of turns; it would not meet itself otherwise."""
    moved = []
    for term in terms:
        factors = tuple(
            type(f)(f.name, 2 * np.pi * round(f.slope / (2 * np.pi)), f.shift)
            if f.name == "sin" and abs(f.slope / (2 * np.pi) - round(f.slope / (2 * np.pi))) < 0.1
            else f
            for f in term.factors
        )
        moved.append(type(term)(term.size, term.degree, factors))
    return polish(tuple(moved), *learnt, slopes=False)[0]


def _all_whole(terms: Sum) -> bool:
    factors = [f for t in terms for f in t.factors]
    turns = [f.slope / (2 * np.pi) for f in factors]
    whole = all(f.name == "sin" and abs(n - round(n)) < 1e-9 for f, n in zip(factors, turns, strict=True))
    return whole and all(t.degree == 0 for t in terms)
