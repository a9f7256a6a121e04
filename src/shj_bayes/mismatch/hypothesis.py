"""A set of dependences with the model that holds them: its members, their sizes, and their shapes."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shj_bayes.mismatch.classes import ALPHA, EXPLAINED, MIN_EFFECT, Candidate
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.laplace import Laplace, drawn_from, largest, visible
from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.diagnosis import DependenceId

CONSTANT = str(DependenceId("added", "constant"))
TEETH = DependenceId("motion", "stick-slip")
POSITION, DISTANCE, DIRECTION, SLIP, TRAVEL, TIME = (
    str(DependenceId("capacity", name)) for name in ("position", "distance", "direction", "slip", "travel", "time")
)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of classes with the model that holds them."""

    members: tuple[Candidate, ...]  # classes, in the order of the effects of the model behind those that were given
    state: Laplace  # the model, fitted
    log_weight: float  # log of the evidence times the probability before the test
    metric: ErrorModel | None = None  # noise and discrepancy under which it was weighed; None during a search

    @property
    def key(self) -> frozenset[str]:
        """Ids of the classes."""
        return frozenset(member.of.id for member in self.members)


def columns_of(data: BinnedData, state: Laplace, place: int) -> list[int]:
    """Positions of the parameters of a member, in the place among its classes, in the vector of a model."""
    effect = state.model.effects[len(data.device.effects) + place]
    return [i for i, name in enumerate(state.model.law_names) if name.startswith(f"{effect.id}.")]


def without(data: BinnedData, h: Hypothesis, place: int) -> tuple[tuple[Candidate, ...], FloatArray]:
    """Members of a hypothesis less the one in a place, and where the rest of its model is."""
    members = (*h.members[:place], *h.members[place + 1 :])
    return members, np.delete(h.state.z, columns_of(data, h.state, place))


def joined(h: Hypothesis, c: Candidate) -> FloatArray:
    """Start of a hypothesis with one more class: the parameters of the smaller one, and where the class begins."""
    return np.concatenate([h.state.z, c.start[-len(c.variant.effect.parameters) :]])


def replaced(h: Hypothesis, place: int, member: Candidate) -> tuple[Candidate, ...]:
    """Give the members of a hypothesis with another one in a place."""
    return (*h.members[:place], member, *h.members[place + 1 :])


def is_curve(member: Candidate) -> bool:
    """Whether a class has no formula here: it is a curve, or it acts on the motion."""
    return member.variant.curve is not None or not any(v.curve is not None for v in member.of.variants)


def second_of(member: Candidate) -> str | None:
    """Class that a curve may hold beside its own: position and distance, or time and direction where both count."""
    curve = member.variant.curve
    if curve is not None and curve.sides:
        return DIRECTION
    return DISTANCE if curve is not None and member.of.id == POSITION else None


def same_twice(a: Candidate, b: Candidate) -> bool:
    """Whether one of two is a curve over position and the other a function of the distance, its even part."""
    pairs = [(m, n) for m, n in ((a, b), (b, a)) if (m.of.id, n.of.id) == (POSITION, DISTANCE)]
    return any(m.variant.curve is not None for m, _ in pairs)


MOTION = "motion"
N_SIZES = 60  # draws from which the upper limit of a size is taken
NO_FORCE = 1e6  # size of a draw whose force is not finite


def size_of(data: BinnedData, h: Hypothesis, place: int) -> float:
    """Size of a member at the most probable parameters, as a share of Fy.

    The 99th percentile of its force that the base law could not make, by `visible`; of a constant, all of it.
    """
    return float(_sizes_at(data, h, place, h.state.z[None])[0])


def largest_size_of(data: BinnedData, h: Hypothesis, place: int) -> float:
    """Upper limit of the size of a member, exceeded with a probability of `ALPHA`, a share of Fy."""
    return float(np.quantile(sizes_of(data, h, place), 1.0 - ALPHA))


def sizes_of(data: BinnedData, h: Hypothesis, place: int) -> FloatArray:
    """Sizes of a member for draws of the parameters of its model, shape (N_SIZES,), as shares of Fy.

    Far from what fits a model may have no force at all; nothing says that the member is small there.
    """
    return np.nan_to_num(_sizes_at(data, h, place, drawn_from(h.state, N_SIZES)), nan=NO_FORCE, posinf=NO_FORCE)


def _sizes_at(data: BinnedData, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Size of a member for each of some parameter sets of its model, shape (m, n_law) to (m,).

    What acts on the motion makes its force between the bends of the base law, where the blocks of a search are long. A
    constant is as large as it is: the law makes none, also where it begins loaded by it.
    """
    if h.members[place].of.id == CONSTANT:
        return np.asarray(np.abs(_change(data, h, place, z)[:, data.used > 0]).max(axis=1) / data.scale_kN)
    if h.members[place].of.action == MOTION:
        data = data.finer_at(h.state.model, h.state.z)
    return visible(data, _law_slopes(h, data), _change(data, h, place, z).T)


def _change(data: BinnedData, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Force of a member for each of some parameter sets of its model, shape (m, n_law) to (m, n), kN."""
    model, effect = h.state.model, h.members[place].variant.effect
    rest = tuple(e for e in model.effects if e.id != effect.id)
    others = np.delete(z, columns_of(data, h.state, place), axis=1)
    return data.residual(model.with_effects(rest), others) - data.residual(model, z)


def _law_slopes(h: Hypothesis, data: BinnedData) -> FloatArray:
    """Give the derivatives of the law by itself, shape (n, n_law), kN.

    Beside a constant of many times Fy, a change of Fy is a change of the constant.
    """
    device, law = data.device, h.state.of_law(data.device)
    return data.jacobian(device, law, data.residual(device, law[None])[0])


def tolerance(data: BinnedData, h: Hypothesis, place: int) -> float:
    """How far a formula may be from a curve that it is the name of, a share of Fy.

    At most half of the curve: a formula that leaves more than it explains says nothing.
    """
    size = size_of(data, h, place)
    return min(max(MIN_EFFECT, (1.0 - EXPLAINED) * size), 0.5 * size)


def force_distance(data: BinnedData, a: Hypothesis, b: Hypothesis) -> float:
    """How far the forces of two hypotheses are apart (99th percentile over the samples), as a share of Fy."""
    used = data.used > 0
    apart = (b.state.residual - a.state.residual)[used, None]
    return float(largest(apart, data.count[used])[0]) / data.scale_kN


@dataclass(frozen=True)
class Shape:
    """A curve over a share u of a range: linear in its sizes, with one length or place that is not."""

    name: str  # short word
    # ``columns(u, length)``, shape (n, n_sizes); the last size is a constant
    columns: Callable[[FloatArray, float], FloatArray]
    lengths: FloatArray  # lengths or places to try, as shares of the range
    # ``text(sizes, length, name, unit)`` writes the formula; lengths are in the unit
    text: Callable[[FloatArray, float, str, str], str]


def _with_one(*columns: FloatArray) -> FloatArray:
    return np.stack([*columns, np.ones_like(columns[0])], axis=1)


def _wave(sizes: FloatArray, length: float, x: str, unit: str) -> str:
    size, phase = float(np.hypot(sizes[0], sizes[1])), float(np.arctan2(sizes[1], sizes[0]))
    return f"{size:.3g} sin(2 pi {x} / {length:.3g} {unit} {phase:+.2g}) {sizes[2]:+.3g}"


SHAPES = (
    Shape("line", lambda u, _: _with_one(u), np.ones(1), lambda s, _, x, unit: f"{s[0]:.3g} {x}/range {s[1]:+.3g}"),
    Shape(
        "parabola", lambda u, _: _with_one(u**2, u), np.ones(1),
        lambda s, _, x, unit: f"{s[0]:.3g} ({x}/range)^2 {s[1]:+.3g} {x}/range {s[2]:+.3g}",
    ),
    Shape(
        "modulus", lambda u, c: _with_one(np.abs(u - c)), np.linspace(0.05, 0.95, 91),
        lambda s, c, x, unit: f"{s[0]:.3g} |{x} - {c:.3g} {unit}|/range {s[1]:+.3g}",
    ),
    Shape(
        "step", lambda u, c: _with_one(1.0 / (1.0 + np.exp(-np.clip((u - c) / 0.01, -50, 50)))),
        np.linspace(0.05, 0.95, 91), lambda s, c, x, unit: f"{s[0]:.3g} step({x} - {c:.3g} {unit}) {s[1]:+.3g}",
    ),
    Shape(
        "exponential", lambda u, c: _with_one(np.exp(-u / c)), np.geomspace(1 / 60, 2.0, 40),
        lambda s, c, x, unit: f"{s[0]:.3g} exp(-{x} / {c:.3g} {unit}) {s[1]:+.3g}",
    ),
    Shape("sine", lambda u, c: _with_one(np.sin(2 * np.pi * u / c), np.cos(2 * np.pi * u / c)),
          1.0 / np.arange(1.0, 16.0, 0.1), _wave),
)  # fmt: skip


def formula_of(at: FloatArray, mean: FloatArray, low: FloatArray, high: FloatArray, name: str, unit: str) -> str | None:
    """Simplest formula that lies within the band of a curve, per cent of Fy, or misses it by less than what matters.

    Its right-hand side, with symbol and unit of the coordinate; None where no shape of a few numbers does.
    """
    first, span = float(at[0]), float(np.ptp(at))
    u = (at - first) / span
    weight = 1.0 / np.maximum(high - low, 0.2 * 100 * MIN_EFFECT)
    allowed = np.maximum(0.5 * (high - low), 100 * MIN_EFFECT)
    for shape in SHAPES:
        best: tuple[float, FloatArray, float] | None = None
        for length in shape.lengths:
            columns = shape.columns(u, float(length))
            solved = np.linalg.lstsq(columns * weight[:, None], mean * weight, rcond=1e-9)[0]
            sizes = np.asarray(solved, dtype=np.float64)
            worst = float(np.max(np.abs(columns @ sizes - mean) / allowed))
            if best is None or worst < best[0]:
                best = (worst, sizes, float(length))
        assert best is not None
        if best[0] <= 1.0:
            place = best[2] * span + (first if shape.name in ("modulus", "step") else 0.0)
            symbol = name if first == 0.0 or shape.name in ("modulus", "step") else f"({name} - {first:.3g} {unit})"
            return shape.text(best[1], place, symbol, unit)
    return None
