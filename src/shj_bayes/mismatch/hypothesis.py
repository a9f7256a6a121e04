"""What a device may do beyond its base law, one dependence for each coordinate and way of acting; and sets of them.

A hypothesis is a set with the model that holds it: its members, their sizes, and their shapes.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from scipy.special import expit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.gaussian import Gaussian, log_gains
from shj_bayes.inference.start import extended, start_values
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.laplace import Laplace, drawn_from, largest, visible
from shj_bayes.model.coordinates import coordinate_named, coordinates, coordinates_of
from shj_bayes.model.curve import SIZES, Curve
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect, catalogue
from shj_bayes.model.history import Measured
from shj_bayes.results.diagnosis import DependenceId

MIN_EFFECT = 0.01  # of Fy: a smaller effect is negligible for design
ALPHA = 0.05  # probability that is given up: verdicts hold with 95 %
EXPLAINED = 0.8  # of a curve, that a formula must follow to be its name where it is not within what matters
PRIOR_INCLUSION = 0.05  # probability of each class before the test: about one in a device
LOG_PRIOR_ODDS = math.log(PRIOR_INCLUSION / (1.0 - PRIOR_INCLUSION))
TYPICAL, SPREAD = 0.04, 1.2  # of Fy, and of its logarithm: how large a curve is where there is one
FORMS = 0.5  # probability that a dependence that may be a curve has one of the published formulas of its coordinate
FEW_STARTS = 12  # formulas with more are tried in the place of a curve only
CURVES = (
    *dict.fromkeys(("capacity", one.group or one.id) for one in coordinates().values() if one.times is None),
    *(("added", name) for name, one in coordinates().items() if one.adds),
)
CONSTANT = str(DependenceId("added", "constant"))
TEETH = DependenceId("motion", "stick-slip")
POSITION, DISTANCE, DIRECTION, SLIP, TRAVEL, TIME = (
    str(DependenceId("capacity", name)) for name in ("position", "distance", "direction", "slip", "travel", "time")
)


@dataclass(frozen=True, eq=False)
class Parametrisation:
    """One way to write a class: a curve of some smoothness, or an effect of the catalogue."""

    curve: Curve | None  # the curve
    effect: Effect  # the same as an effect, or the effect of the catalogue
    weight: float  # probability of the variant within its class


@dataclass(frozen=True, eq=False)
class Dependence:
    """A dependence of the force on one coordinate."""

    action: str  # how it acts
    coordinate: str  # on what it depends
    unit: str  # unit of the coordinate
    variants: tuple[Parametrisation, ...]  # ways to write it

    @property
    def id(self) -> str:
        """Short word."""
        return str(DependenceId(self.action, self.coordinate))


@dataclass(frozen=True, eq=False)
class Candidate:
    """A class that could be added to a model, to first order."""

    of: Dependence  # the class
    variant: Parametrisation  # how it is written
    start: FloatArray  # shape (n_law,): parameters of the larger model to start from
    columns: FloatArray  # shape (n, p): what it could add to the force, kN, by unit of each of its coefficients
    model: DeviceModel  # the larger model
    gain: float = 0.0  # log Bayes factor over the smaller model to first order, with the weight of the variant; nats
    # shape (n,): what it is expected to add to the force, kN, to first order
    change: FloatArray = field(default_factory=lambda: np.zeros(0))


def classes(
    hidden: frozenset[str] = frozenset(), measured: Mapping[str, Measured] = MappingProxyType({})
) -> tuple[Dependence, ...]:
    """All classes; a curve is left out when all effects of its class are `hidden`.

    `measured` holds further channels of the recordings by coordinate: clamping may follow each.
    """
    out = []
    for key in dict.fromkeys(key for effect in catalogue().values() for key in effect.acts):
        action, name = key
        written = formulas(key, hidden)
        shown = [one for one in written if not one.effect.form]
        if not shown:
            continue
        if key not in CURVES:
            out.append(Dependence(action, name, "1", tuple(shown)))
            continue
        over = coordinates_of(name)
        smooth = (1.0 - FORMS) * (1.0 - over[0].repeats)
        sides = over[0].sides if action == "capacity" else 0.0
        variants = [
            Parametrisation(
                curve := Curve(action, u.id, length, own), curve.effect(), smooth * weight * share / len(over)
            )
            for u in over
            for length, weight in u.lengths.items()
            for own, share in ((False, 1.0 - sides), (True, sides))
            if share
        ]
        few = [one for one in shown if math.prod(map(len, start_values(one.effect))) <= FEW_STARTS]
        out.append(Dependence(action, name, over[0].unit, (*variants, *few)))
    both = {name: one.unit for name, one in coordinates().items() if one.times is not None}
    rest = [_without_formula(name, unit, PRIOR_INCLUSION * (1.0 - FORMS)) for name, unit in both.items()]
    return (*out, *rest, *(_without_formula(name, one.unit) for name, one in measured.items() if name not in hidden))


def formulas(key: tuple[str, str], hidden: frozenset[str] = frozenset()) -> list[Parametrisation]:
    """Give the formulas of a class, by action and coordinate, each as probable before the test as the others.

    Together they have what a curve leaves them, or all where there is none: more of them make no class more probable.
    """
    known = [effect for effect in catalogue().values() if key in effect.acts and effect.mechanism not in hidden]
    share = FORMS if key in CURVES else 1.0
    return [Parametrisation(None, effect, share / len(known)) for effect in known]


def _without_formula(name: str, unit: str, weight: float = 1.0) -> Dependence:
    """Class of a sliding force over a coordinate for which no formula beyond its curve is known.

    What needs two coordinates at once has the probabilities of both, and of a class without a formula (`weight`).
    """
    curves = [(Curve("capacity", name, length), share) for length, share in coordinate_named(name).lengths.items()]
    variants = tuple(Parametrisation(curve, curve.effect(), weight * share) for curve, share in curves)
    return Dependence("capacity", name, unit, variants)


def candidates(data: BinnedData, state: Laplace, of: tuple[Dependence, ...]) -> list[Candidate]:
    """Everything that could be added to a model, one at a time, with the columns of the first order."""
    out = []
    for one in of:
        for variant in one.variants:
            model = state.model.with_effects((*state.model.effects, variant.effect))
            if variant.curve is not None:
                n, step = len(variant.effect.parameters), 1e-2
                zero = np.concatenate([state.z, np.zeros(n)])
                points = zero + step * np.eye(n, zero.size, state.z.size)
                columns = (state.residual - data.likelihood.at(model).residual(points)).T / step
                out.append(Candidate(one, variant, zero, columns, model))
                continue
            starts = np.array(extended(state.z, state.model, model, variant.effect))
            changes = (state.residual - data.likelihood.at(model).residual(starts)).T
            finite = np.all(np.isfinite(changes), axis=0) & np.any(changes != 0.0, axis=0)
            out += [Candidate(one, variant, starts[i], changes[:, i : i + 1], model) for i in np.flatnonzero(finite)]
    return out


def unit_columns(c: Candidate) -> FloatArray:
    """Columns of a candidate of the size that fits best, for coefficients with standard normal priors."""
    curve = c.variant.curve  # its columns are of the size with which every class states its curves
    return c.columns if curve is None else np.asarray(c.columns * (curve.size / Curve.size))


def sized(curve: Curve, size: float) -> Curve:
    """Give the same curve the standard deviation of `SIZES` that is nearest to a size, as a share of Fy."""
    nearest = min(SIZES, key=lambda one: abs(np.log(one / size)))
    return replace(curve, size=nearest)


def size_weights() -> FloatArray:
    """Probability of each of `curve.SIZES` before the test."""
    weights = np.exp(-0.5 * (np.log(np.array(SIZES) / TYPICAL) / SPREAD) ** 2)
    return np.asarray(weights / weights.sum())


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


def cancel(state: Laplace, members: tuple[Candidate, ...]) -> bool:
    """Whether a constant force and a difference of push and pull leave less than half of the smaller one together."""
    a, b = (
        sum(state.values_of(m.variant.effect)["size"] for m in members if m.of.id == of) for of in (CONSTANT, DIRECTION)
    )
    return a * b < 0.0 and abs(a + b) < 0.5 * min(abs(a), abs(b))


MOTION = "motion"
N_SIZES = 60  # draws from which the upper limit of a size is taken
STEP = 1e-3  # of a parameter in its unbounded space, for derivatives of the force of a member


def size_of(data: BinnedData, h: Hypothesis, place: int) -> float:
    """Size of a member at the most probable parameters, as a share of Fy.

    The 99th percentile of its force that the base law could not make, by `visible`; of a constant, all of it.
    """
    return float(_sizes(data, h, place, h.state.z[None])[0])


def largest_size_of(data: BinnedData, h: Hypothesis, place: int) -> float:
    """Upper limit of the size of a member, exceeded with a probability of `ALPHA`, a share of Fy."""
    return float(np.quantile(_sizes(data, h, place, drawn_from(h.state, N_SIZES)), 1.0 - ALPHA))


def _sizes(data: BinnedData, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Size of a member for each of some parameter sets of its model, shape (m, n_law) to (m,), to first order.

    Farther from the most probable parameters a formula has forces that the recording refuses, but no Gaussian around
    them does. What acts on the motion makes its force between the bends of the base law, where the blocks of a search
    are long. A constant is as large as it is: the law makes none, also where it begins loaded by it.
    """
    if h.members[place].of.action == MOTION:
        data = data.finer_at(h.state.model, h.state.z)
    away = z - h.state.z
    moves = np.flatnonzero(np.any(away != 0.0, axis=0))
    forces = force_of(data, h, place, h.state.z + STEP * np.vstack([np.zeros(z.shape[1]), np.eye(z.shape[1])[moves]]))
    forces = forces[0] + away[:, moves] @ ((forces[1:] - forces[0]) / STEP)
    if h.members[place].of.id == CONSTANT:
        return np.asarray(np.abs(forces[:, data.blocks.used > 0]).max(axis=1) / data.scale_kN)
    return visible(data, _law_slopes(h, data), forces.T)


def force_of(data: BinnedData, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Force of a member for each of some parameter sets of its model, shape (m, n_law) to (m, n), kN."""
    model, effect = h.state.model, h.members[place].variant.effect
    rest = tuple(e for e in model.effects if e.id != effect.id)
    others = np.delete(z, columns_of(data, h.state, place), axis=1)
    without = data.likelihood.at(model.with_effects(rest))
    return without.residual(others) - data.likelihood.at(model).residual(z)


def _law_slopes(h: Hypothesis, data: BinnedData) -> FloatArray:
    """Give the derivatives of the law by itself, shape (n, n_law), kN.

    Beside a constant of many times Fy, a change of Fy is a change of the constant.
    """
    law = h.state.of_law(data.device)
    return data.likelihood.jacobian(law, data.likelihood.residual(law[None])[0])


def tolerance(data: BinnedData, h: Hypothesis, place: int) -> float:
    """How far a formula may be from a curve that it is the name of, a share of Fy.

    At most half of the curve: a formula that leaves more than it explains says nothing.
    """
    size = size_of(data, h, place)
    return min(max(MIN_EFFECT, (1.0 - EXPLAINED) * size), 0.5 * size)


def force_distance(data: BinnedData, a: Hypothesis, b: Hypothesis) -> float:
    """How far the forces of two hypotheses are apart (99th percentile over the samples), as a share of Fy."""
    used = data.blocks.used > 0
    apart = (b.state.residual - a.state.residual)[used, None]
    return float(largest(apart, data.blocks.n_samples[used])[0]) / data.scale_kN


SIZES_OF_STARTS = np.array([0.25, 0.5, 1.0, 2.0, 4.0])  # of an effect at the values that a search starts from


def screen(metric: ErrorModel, state: Laplace, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Give candidates, as from `classes.candidates`, their gain, best first, with curves of the size that fits."""
    if not candidates:
        return []
    columns, taken = metric.factors_of({c: c.columns for c in candidates})
    along, cross, solved = beside_law(metric, state, columns, taken)
    out, first = [], 0
    for c in candidates:
        own = slice(first, first + c.columns.shape[1])
        first = own.stop
        inner = columns[:, own].T @ columns[:, own] - taken[:, own].T @ taken[:, own] - cross[:, own].T @ solved[:, own]
        out.append(_gained(c, Gaussian(0.0, along[own], inner)))
    return sorted(out, key=lambda c: -c.gain)


def beside_law(
    metric: ErrorModel, state: Laplace, columns: FloatArray, taken: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give what a state leaves of the data to columns, which are given by their factors under a metric.

    Products with the data, shape (p,), once the parameters are integrated out; products with the derivatives, and
    these solved by the precision of the parameters, shape (n_law, p): their product is what the former take up.
    """
    beside, beside_taken = metric.factors(state.beside())
    law = Gaussian.of(beside.T @ beside - beside_taken.T @ beside_taken)
    along, cross = np.split(beside.T @ columns - beside_taken.T @ taken, [1])
    solved = law.solve(cross)
    return np.asarray(along[0] - law.along @ solved), cross, solved


def _gained(c: Candidate, own: Gaussian) -> Candidate:
    """Candidate with its gain, averaged over its size before the test."""
    curve = c.variant.curve
    sizes = SIZES_OF_STARTS if curve is None else np.array(SIZES) / curve.size
    weights = np.full(sizes.size, 1.0 / sizes.size) if curve is None else size_weights()
    parts = log_gains(own.inner, own.along, sizes) + np.log(weights)
    gain = float(np.logaddexp.reduce(parts) + np.log(c.variant.weight))
    best = float(sizes[np.argmax(parts)])
    c = replace(c, change=c.columns @ (best * own.sized(best).mean))
    if curve is None:
        return replace(c, gain=gain)
    curve = sized(curve, curve.size * best)
    effect = curve.effect()
    model = c.model.with_effects((*c.model.effects[:-1], effect))
    return replace(c, gain=gain, model=model, variant=replace(c.variant, curve=curve, effect=effect))


def curves_of(data: BinnedData, state: Laplace, of: Dependence) -> FloatArray | None:
    """Give the curves of a class, kN by unit of normal coefficients, shape (n, p); None where it has none.

    To first order, with the standard deviation of `Curve.size`. A class may have several: heat decays sooner or later.
    What acts on the motion has none.
    """
    curves = [v for v in of.variants if v.curve is not None and not v.curve.sides]
    if not curves:
        return None
    likely = {v.curve.coordinate: v for v in sorted(curves, key=lambda v: v.weight) if v.curve is not None}
    one = replace(of, variants=tuple(likely.values()))
    return np.column_stack([c.columns for c in candidates(data, state, (one,))])


def missed_by(data: BinnedData, state: Laplace, of: Dependence, size: float) -> FloatArray | None:
    """Give what a form of a size, a share of Fy, may miss over the coordinate of a class: curves as of `curves_of`.

    With a standard deviation of 1 - `EXPLAINED` of the size.
    """
    curves = curves_of(data, state, of)
    return None if curves is None else curves * ((1.0 - EXPLAINED) * size / Curve.size)


def beside_missed(
    metric: ErrorModel,
    state: Laplace,
    found: Sequence[tuple[Candidate, float]],
    others: Sequence[Dependence] = (),
) -> Laplace:
    """Give a state with a covariance that counts what its formulas may miss, and the classes that it does not hold.

    A formula may miss a curve, `missed_by`: `found` holds the classes of the model with their sizes, as shares of Fy.
    Each of the `others` counts with its probability: one that is too small to matter for the force may still move the
    parameters by more than noise does. All to first order. The parameters stay as they are; how far they would move is
    uncertainty.
    """
    covariance = state.covariance.copy()
    missed = [
        curves
        for member, size in found
        if member.variant.curve is None and (curves := missed_by(metric.data, state, member.of, size)) is not None
    ]
    if missed:
        covariance = _spread(metric, state, *missed)
    best: dict[str, Candidate] = {}
    for c in screen(metric, state, candidates(metric.data, state, tuple(others))):
        best.setdefault(c.of.id, c)
    for c in best.values():
        column = c.change[:, None] if c.variant.curve is None else unit_columns(c)
        covariance += expit(c.gain + LOG_PRIOR_ODDS) * (_spread(metric, state, column) - state.covariance)
    return replace(state, covariance=covariance)


def _spread(metric: ErrorModel, state: Laplace, *columns: FloatArray) -> FloatArray:
    """Covariance of the parameters beside further columns, with the square of how far they move from where they are."""
    d = state.z.size
    wide = metric.gaussian(state.beside(*columns))
    moved = wide.mean[:d] - state.z
    return np.asarray(wide.covariance[:d, :d] + np.outer(moved, moved))
