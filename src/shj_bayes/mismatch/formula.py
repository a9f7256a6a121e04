"""A formula for what the catalogue does not explain, where a simple shape predicts the cycles it was not fitted to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from shj_bayes.mismatch.calibrate import Line
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.profiles import AXES, MODES, N_BINS, Axis, Folded, fold, fold_time, signs
from shj_bayes.mismatch.thresholds import FORMULA_P, FORMULA_PART, FORMULA_SHARE, LINE
from shj_bayes.model.parameters import FloatArray

N_FLIPS = 4999
TIE = 0.03  # of what comes again beyond a constant: a simpler shape that is worse by less is preferred
NEGLIGIBLE = 0.005  # of the largest term: less does not show beside its three digits and is not written
WHERE = {
    "friction": "q is +1 in push and -1 in pull (friction: push and pull alike)",
    "force": "the same force in push and in pull",
    "push": "in push only",
    "pull": "in pull only",
}


@dataclass(frozen=True)
class Shape:
    """A curve over a scaled coordinate u: linear in its sizes, with at most one length that is not.

    Parameters
    ----------
    name : str
        Short word for it.
    rank : int
        How much a reader must take in; of shapes that are as good, the lowest is preferred.
    columns : callable
        ``columns(u, length)``: one column for each size, shape (n, n_sizes).
    lengths : callable
        ``lengths(u)`` gives the lengths or places to try, which are refined between them; none where the range of u has
        no room for the shape, any one where the shape has no such number.
    """

    name: str
    rank: int
    columns: Callable[[FloatArray, float], FloatArray]
    lengths: Callable[[FloatArray], FloatArray] = lambda _: np.ones(1)


def _periods(u: FloatArray) -> FloatArray:
    """Periods from half of the range down to what a profile shows, as in a Lomb-Scargle spectrum."""
    return np.asarray(np.ptp(u) / np.arange(2.0, N_BINS / 3, 0.25))


def _places(u: FloatArray) -> FloatArray:
    """Places away from the ends of the range."""
    return np.asarray(u.min() + np.ptp(u) * np.linspace(0.05, 0.95, 91))


def _decays(u: FloatArray) -> FloatArray:
    """Lengths of a decay from the start of a coordinate; one that runs both ways, as a position does, has none."""
    return np.geomspace(1 / 60, 2.0, 40) * np.ptp(u) if u.min() > -0.05 * u.max() else np.empty(0)


def _wave(u: FloatArray, length: float) -> FloatArray:
    return np.stack([np.ones_like(u), np.sin(2 * np.pi * u / length), np.cos(2 * np.pi * u / length)], axis=1)


CONSTANT = Shape("constant", 1, lambda u, _: np.ones((u.size, 1)))  # its sizes: one for push, one for pull
SINE = Shape("sine", 4, _wave, _periods)
SHAPES = (
    CONSTANT,
    Shape("line", 2, lambda u, _: np.stack([np.ones_like(u), u], axis=1)),
    Shape("parabola", 3, lambda u, _: np.stack([np.ones_like(u), u, u**2], axis=1)),
    Shape("modulus", 3, lambda u, place: np.stack([np.ones_like(u), np.abs(u - place)], axis=1), _places),
    Shape("step", 3, lambda u, place: np.stack([np.ones_like(u), 1.0 * (u > place)], axis=1), _places),
    # A rise to a plateau is the same curve from the other side.
    Shape("exponential", 3, lambda u, length: np.stack([np.ones_like(u), np.exp(-u / length)], axis=1), _decays),
    SINE,
)
SINE_OF_PERIOD = replace(SINE, lengths=lambda _: np.ones(1))  # over the time within a known period: one whole turn


@dataclass(frozen=True, eq=False)
class Fitted:
    """A shape with its numbers.

    Parameters
    ----------
    shape : Shape
        Which one.
    mode : str
        ``friction``, ``force``, ``push`` or ``pull``; ``each`` for a constant, which has a size in each direction.
    length : float
        Length or place, in the scaled coordinate.
    sizes : array, shape (n_sizes,)
        kN.
    squares : float
        Sum of squared errors, kN^2.
    """

    shape: Shape
    mode: str
    length: float
    sizes: FloatArray
    squares: float

    def at(self, u: FloatArray, sense: FloatArray) -> FloatArray:
        """Force at a scaled coordinate and a direction (+1 or -1), shape (n,), kN."""
        return np.asarray(_directed(self.shape.columns(u, self.length), self.mode, sense) @ self.sizes)


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
    fitted : Fitted or None
        The best shape, whether good enough or not; None where nothing repeats.
    scale : float
        What the coordinate was divided by.
    share, part : float
        Of the held-out sum of squares of the residual: of what comes again over the coordinate, and of all of it.
    """

    text: str | None
    words: str
    coordinate: str
    fitted: Fitted | None = None
    scale: float = 1.0
    share: float = 0.0
    part: float = 0.0


def find_formula(evidence: Evidence, residual: FloatArray, line: Line, *, seed: int = 1) -> Formula:
    """Look for a simple formula of a residual.

    Every shape is fitted by least squares to every other cycle over the coordinate. The cycles between them judge: of
    the shapes that are as good there as the best, the simplest is kept, if it takes up most of what comes again and
    more than chance does.

    Parameters
    ----------
    evidence : Evidence
        The recordings.
    residual : array, shape (n,)
        Of the final model, kN.
    line : Line
        Strongest line over time in the residual.
    seed : int
        Of the sign flips.

    Returns
    -------
    Formula
    """
    data = _most_regular(evidence, residual, line)
    name = data.axis.name
    if data.repeats <= 0 or np.count_nonzero(data.early.count) < 10:
        return Formula(None, f"No formula: over {name} the misfit does not repeat from cycle to cycle.", name)
    learnt = data.x[data.learn], evidence.stack("direction")[data.learn], residual[data.learn]
    fits = [_fit(shape, *learnt) for shape in ((SINE_OF_PERIOD,) if name == "time" else SHAPES)]
    share, fitted = _simplest([(_share(data, fitted), fitted) for fitted in fits if fitted])
    part, p_value = _held_out(evidence, data, residual, fitted, seed)
    if share < FORMULA_SHARE:
        words = f"none of a few numbers takes up more than {_percent(share)} % of the misfit that repeats over {name}"
    elif p_value > FORMULA_P:
        words = f"on held-out cycles the best one does no better than chance may (p = {p_value:.2g})"
    elif part < FORMULA_PART:
        words = f"the best one takes up only {_percent(part)} % of the misfit of the held-out cycles"
    else:
        words = (
            f"On cycles that were held out, the formula takes up {_percent(share)} % of the misfit that repeats "
            f"over {name}, and {_percent(part)} % of the whole, noise included. Residual: measured less modelled."
        )
        return Formula(_text(fitted, data.axis, data.scale), words, name, fitted, data.scale, share, part)
    return Formula(None, f"No formula: {words}.", name, fitted, data.scale, share, part)


def _most_regular(evidence: Evidence, residual: FloatArray, line: Line) -> Folded:
    """Residual over the coordinate over which most of it comes again on held-out cycles.

    Time is one of them only where the look for lines found one.
    """
    folded = [fold(evidence, residual, axis) for axis in AXES]
    if line.p_value < LINE:
        folded.append(fold_time(evidence, residual, line))
    return max(folded, key=lambda f: f.repeats / max(float(np.sum(residual[f.used & ~f.learn] ** 2)), 1e-300))


def _directed(columns: FloatArray, mode: str, sense: FloatArray) -> FloatArray:
    """Columns with the sign that a mode has in each direction."""
    if mode == "each":
        return np.asarray(np.hstack([columns * (sense > 0)[:, None], columns * (sense < 0)[:, None]]))
    return np.asarray(columns * np.where(sense > 0, *signs(mode))[:, None])


def _fit(shape: Shape, u: FloatArray, sense: FloatArray, residual: FloatArray) -> Fitted | None:
    """Least squares in the mode that fits best; None where there is no room for the shape."""

    def at(length: float, mode: str) -> Fitted:
        columns = _directed(shape.columns(u, length), mode, sense)
        sizes = np.asarray(np.linalg.lstsq(columns, residual, rcond=1e-9)[0], dtype=np.float64)
        return Fitted(shape, mode, length, sizes, float(np.sum((residual - columns @ sizes) ** 2)))

    grid = np.sort(shape.lengths(u))
    tried = [at(float(x), mode) for mode in (("each",) if shape is CONSTANT else MODES) for x in grid]
    best = min(tried, key=lambda fitted: fitted.squares, default=None)
    if best is None or grid.size == 1:
        return best
    k = int(np.searchsorted(grid, best.length))
    ends = (float(grid[max(k - 1, 0)]), float(grid[min(k + 1, grid.size - 1)]))
    found = minimize_scalar(lambda x: at(float(x), best.mode).squares, bounds=ends, method="bounded")
    return min(best, at(float(found.x), best.mode), key=lambda fitted: fitted.squares)


def _simplest(tried: list[tuple[float, Fitted]]) -> tuple[float, Fitted]:
    """Choose the simplest fit that is as good as the best.

    What counts is what a shape takes up beyond a constant, unless that is next to nothing: a large constant would make
    every shape as good as any other.
    """
    best = max(share for share, _ in tried)
    beyond = best - max([0.0, *(share for share, fitted in tried if fitted.shape is CONSTANT)])
    enough = best - TIE * (beyond if beyond > TIE else 1.0)
    good = [(share, fitted) for share, fitted in tried if share >= enough]
    return min(good, key=lambda pair: (pair[1].shape.rank, -pair[0]))


def _share(data: Folded, fitted: Fitted) -> float:
    """Held-out share of what comes again over the coordinate that a formula takes up."""
    late, gain = data.late, 0.0
    for side, sense in enumerate((1.0, -1.0)):
        value = fitted.at(late.x[side], np.full_like(late.x[side], sense))
        gain += float(np.sum(late.count[side] * (2 * late.mean_kN[side] * value - value**2)))
    return gain / max(data.repeats, 1e-300)


def _held_out(evidence: Evidence, data: Folded, residual: FloatArray, fitted: Fitted, seed: int) -> tuple[float, float]:
    """Share of the held-out sum of squares that a formula takes up, and the chance of such a score.

    The chance is that of whole half-cycles with random signs; samples are not independent.
    """
    held = data.used & ~data.learn
    value = fitted.at(data.x, evidence.stack("direction"))
    gain = float(np.sum((2 * residual * value - value**2)[held]))
    scores = np.bincount(data.half_cycle[held], weights=(residual * value)[held])
    flips = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(8,))).choice(
        [-1.0, 1.0], size=(N_FLIPS, scores.size)
    )
    chance = (1 + np.count_nonzero(flips @ scores >= scores.sum())) / (N_FLIPS + 1)
    return gain / max(float(np.sum(residual[held] ** 2)), 1e-300), float(chance)


def _percent(share: float) -> str:
    return f"{100 * min(max(share, 0.0), 1.0):.0f}"


def _text(fitted: Fitted, axis: Axis, scale: float) -> str:
    """Write a formula with its units and what its variables mean."""
    if fitted.shape is CONSTANT:
        push, pull = fitted.sizes
        return f"residual [kN] = {push:.3g} in push, {pull:.3g} in pull"
    terms = _terms(fitted, axis, scale)
    largest = max(abs(size) for size, _ in terms)
    terms = [term for term in terms if abs(term[0]) >= NEGLIGIBLE * largest]
    line = " + ".join(f"{size:.3g} {words}".rstrip() for size, words in terms).replace("+ -", "- ")
    if fitted.mode == "friction":
        line = f"q * ({line})" if len(terms) > 1 else f"q * {line}"
    meaning = f"{axis.meaning}; step(a) is 0 below a = 0 and 1 above" if fitted.shape.name == "step" else axis.meaning
    return f"residual [kN] = {line}; {meaning}; {WHERE[fitted.mode]}"


def _terms(fitted: Fitted, axis: Axis, scale: float) -> list[tuple[float, str]]:
    """Sizes in kN and what each is multiplied by; the constant last."""
    x, (constant, *sizes) = axis.symbol, fitted.sizes.tolist()
    length = f"{abs(fitted.length) * scale:.3g} {axis.unit}"
    away = f"{x} {'-' if fitted.length > 0 else '+'} {length}"
    over = f"{scale:.3g} {axis.unit}"
    name = fitted.shape.name
    if name == "modulus":
        return [(sizes[0], f"|{away}| / {over}"), (constant, "")]
    if name == "step":
        return [(sizes[0], f"step({away})"), (constant, "")]
    if name == "sine":
        size, phase = float(np.hypot(*sizes)), float(np.arctan2(sizes[1], sizes[0]))
        return [(size, f"sin(2 pi {x} / {length} {'-' if phase < 0 else '+'} {abs(phase):.2g})"), (constant, "")]
    if name == "exponential":
        if abs(constant) > abs(constant + sizes[0]):
            return [(-sizes[0], f"(1 - exp(-{x} / {length}))"), (constant + sizes[0], "")]
        return [(sizes[0], f"exp(-{x} / {length})"), (constant, "")]
    powers = [f"{x} / {over}", f"({x} / {over})^2"]
    return [*reversed(list(zip(sizes, powers, strict=False))), (constant, "")]
