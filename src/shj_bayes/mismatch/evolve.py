"""Symbolic regression of a profile: gplearn evolves shapes, least squares finds their numbers.

pyoperon is faster, but has no wheels for Windows. Evolving a sum of several shapes at once took gplearn thousands of
programs; here one shape is evolved at a time, on what the earlier ones leave, and all numbers are fitted together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lombscargle

from shj_bayes.mismatch.expression import (
    Factor,
    Sum,
    Term,
    apply,
    evaluate,
    n_numbers,
    number,
    sensible,
    tidy,
    times,
    value_of,
    variable,
)
from shj_bayes.mismatch.polish import freed, polish, shortened
from shj_bayes.model.parameters import FloatArray

MAX_NUMBERS = 7  # in a formula that is still simple: a wave with a harmonic, a step up and down, two bumps
# A wave takes up a part of any shape and would crowd out the others, so each kind of shape evolves by itself.
ISLANDS = {
    "waves": ("add", "mul", "sin", "exp"),
    "places": ("add", "sub", "step", "bell"),
    "trends": ("add", "sub", "mul", "abs", "exp"),
}
TRIED = 6  # programs of one evolution whose numbers are fitted
STAGES = 3
GAIN = {"exp": 3.0, "bell": 5.0, "step": 20.0}  # of the argument, so that constants near 1 make shapes of a good width
EDGE = 50.0  # slope with which a step starts
DONE = 0.02  # of the sum of squares: what is left is not worth another term


@dataclass(frozen=True)
class Effort:
    """How long to evolve.

    Parameters
    ----------
    population, generations : int
        As gplearn names them; a program takes about 0.4 ms.
    """

    population: int
    generations: int


QUICK = Effort(120, 5)
FULL = Effort(300, 8)


def evolve(x: FloatArray, y: FloatArray, weight: FloatArray, *, seed: int, effort: Effort) -> list[tuple[Sum, float]]:
    """Find formulas for a profile, from short to long.

    Parameters
    ----------
    x : array, shape (n,)
        Coordinate, its range scaled to -1..1 or 0..1.
    y : array, shape (n,)
        Residual, of order one.
    weight : array, shape (n,)
        Number of samples behind each point.
    seed : int
        Same seed, same formulas.
    effort : Effort
        How long to evolve.

    Returns
    -------
    list of (Sum, float)
        The best formula of each number of numbers up to `MAX_NUMBERS`, with its weighted sum of squared errors; the
        first is a constant.
    """
    best: dict[int, tuple[Sum, float]] = {}
    whole = float(weight @ (y - np.average(y, weights=weight)) ** 2)
    _keep(best, [polish(number(1.0), x, y, weight), *shortened(variable(1.0, 1.0), x, y, weight)], x, y)
    for island in ISLANDS:
        so_far: Sum = ()
        for stage in range(STAGES):
            shapes = _shapes(x, y - evaluate(so_far, x), weight, island, seed + stage, effort)
            found = [polish(freed(tidy((*so_far, *shape))), x, y, weight) for shape in shapes]
            found = sorted((f for f in found if sensible(f[0], x, y)), key=lambda pair: pair[1])
            if not found:
                break
            # The runner-up may be the one that stays good when it is shortened.
            for candidate in found[:2]:
                _keep(best, shortened(candidate[0], x, y, weight), x, y)
            so_far = found[0][0]
            if found[0][1] < DONE * whole or n_numbers(so_far) > MAX_NUMBERS:
                break
    return [best[k] for k in sorted(best) if k <= MAX_NUMBERS]


def _keep(best: dict[int, tuple[Sum, float]], found: list[tuple[Sum, float]], x: FloatArray, y: FloatArray) -> None:
    """Keep the best sum of each length."""
    for terms, error in found:
        size = n_numbers(terms)
        if sensible(terms, x, y) and (size not in best or error < best[size][1]):
            best[size] = (terms, error)


def _shapes(x: FloatArray, y: FloatArray, weight: FloatArray, island: str, seed: int, effort: Effort) -> list[Sum]:
    """Evolve single shapes for a profile, the most promising first."""
    # scikit-learn takes a second to import, and only an `unknown` verdict needs it.
    from gplearn.functions import make_function  # noqa: PLC0415
    from gplearn.genetic import SymbolicRegressor  # noqa: PLC0415

    features = (variable(), *_features(x, y, weight, island))
    own = {"exp": _exp, "bell": _bell, "step": _step}
    functions = [
        make_function(function=own[name], name=name, arity=1, wrap=False) if name in own else name
        for name in ISLANDS[island]
    ]
    search = SymbolicRegressor(
        population_size=effort.population,
        generations=effort.generations,
        tournament_size=10,
        stopping_criteria=0.9999,
        const_range=(-1.0, 1.0),
        init_depth=(1, 3),
        function_set=functions,
        metric="pearson",  # blind to a factor and a constant, which least squares finds afterwards
        parsimony_coefficient=0.005,
        random_state=seed,
    )
    search.fit(np.stack([evaluate(f, x) for f in features], axis=1), y, sample_weight=weight)
    ranked = sorted(search._programs[-1], key=lambda p: (-p.fitness_, p.length_))  # noqa: SLF001 the last generation
    out: dict[tuple[object, ...], Sum] = {}
    for program in ranked:
        terms = _read(program.program, features)
        if terms is not None and (terms := tidy(terms)) and 1 <= len(terms) <= 4:
            out.setdefault(tuple((t.degree, tuple(f.name for f in t.factors)) for t in terms), terms)
        if len(out) == TRIED:
            break
    # A step up and one down seldom evolve together; as a terminal, a ready patch would crowd out the bumps.
    return [*out.values(), _patch(x, y, weight)] if island == "places" else list(out.values())


def _exp(u: FloatArray) -> FloatArray:
    return value_of("exp", GAIN["exp"] * u)


def _bell(u: FloatArray) -> FloatArray:
    return value_of("bell", GAIN["bell"] * u)


def _step(u: FloatArray) -> FloatArray:
    return value_of("step", GAIN["step"] * u)


def _features(x: FloatArray, y: FloatArray, weight: FloatArray, island: str) -> tuple[Sum, ...]:
    """Read off the profile what evolution would find last: the strongest wave, edges, the top, curvature."""
    low, span = float(x.min()), float(np.ptp(x))
    if island == "waves":
        turns = 2 * np.pi * np.arange(1.0, max(x.size / 3, 3.0), 0.1) / span
        level = y - np.average(y, weights=weight)
        turn = float(turns[int(np.argmax(lombscargle(x, level, turns)))])
        columns = np.stack([np.sin(turn * x), np.cos(turn * x), np.ones_like(x)], axis=1) * np.sqrt(weight)[:, None]
        a, b, _ = np.linalg.lstsq(columns, y * np.sqrt(weight), rcond=None)[0]
        return (variable(turn, float(np.arctan2(b, a))),)
    if island == "places":
        level = y - np.average(y, weights=weight)
        top = int(np.argmax(np.abs(np.convolve(level, np.ones(3) / 3, mode="same"))))
        return tuple(variable(1.0, -float(place)) for place in (*_stretch(x, level, weight), x[top]))
    u = variable(2 / span, -1 - 2 * low / span)  # -1..1: a law that follows level and slope leaves Legendre polynomials
    square = times(u, u) or ()
    cube = times(square, u) or ()
    return square, tidy((*(times(number(2.5), cube) or ()), *(times(number(-1.5), u) or ())))


def _patch(x: FloatArray, y: FloatArray, weight: FloatArray) -> Sum:
    """Write the stretch that stands out most as a step up and a step down."""
    ends = _stretch(x, y - np.average(y, weights=weight), weight)
    steps = [Factor("step", EDGE, -EDGE * end) for end in ends]
    return tuple(Term(sign, 0, (step,)) for sign, step in zip((1.0, -1.0), steps, strict=False))


def _stretch(x: FloatArray, level: FloatArray, weight: FloatArray) -> tuple[float, ...]:
    """Find the stretch whose mean stands out most from that of the rest; one end where it reaches the border."""
    edges = (x[1:] + x[:-1]) / 2
    below, n_below = (np.concatenate([[0.0], np.cumsum(v)]) for v in (weight * level, weight))
    inside = below[None, :] - below[:, None]
    n_inside = np.clip(n_below[None, :] - n_below[:, None], 1e-300, None)
    n_outside = np.clip(n_below[-1] - n_inside, 1e-300, None)
    between = np.triu(inside**2 * (1 / n_inside + 1 / n_outside), 1)
    between[0, -1] = 0.0
    first, last = np.unravel_index(int(np.argmax(between)), between.shape)
    return tuple(float(edges[i - 1]) for i in (first, last) if 0 < i <= edges.size)


def _read(program: list[object], features: tuple[Sum, ...]) -> Sum | None:
    """Bring a program of gplearn (functions, features and constants in prefix order) into the form of a sum."""
    stack: list[Sum] = []
    for node in reversed(program):
        if isinstance(node, float):
            stack.append(number(node))
        elif isinstance(node, (int, np.integer)):
            stack.append(features[int(node)])
        else:
            value = _applied(str(getattr(node, "name", "")), stack)
            if value is None:
                return None
            stack.append(value)
    return stack.pop()


def _applied(name: str, stack: list[Sum]) -> Sum | None:
    """Apply one function to the arguments on top of the stack."""
    first = stack.pop()
    if name not in ("add", "sub", "mul"):
        scaled = times(number(GAIN.get(name, 1.0)), first)
        return None if scaled is None else apply(name, scaled)
    second = stack.pop()
    if name == "mul":
        return times(first, second)
    return tidy((*first, *(second if name == "add" else times(number(-1.0), second) or ())))
