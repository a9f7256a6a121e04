"""What a device may do beyond its base law: one class for each coordinate and way of acting."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from shj_bayes.inference.start import extended, start_values
from shj_bayes.mismatch.data import BinnedData
from shj_bayes.mismatch.laplace import Laplace
from shj_bayes.model.coordinates import coordinate_named, coordinates, coordinates_of
from shj_bayes.model.curve import SIZES, Curve
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.history import Measured
from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.diagnosis import DependenceId

MIN_EFFECT = 0.01  # of Fy: a smaller effect is negligible for design
ALPHA = 0.05  # probability that is given up: verdicts hold with 95 %
EXPLAINED = 0.8  # of a curve, that a formula must follow to be its name where it is not within what matters
PRIOR_INCLUSION = 0.05  # probability of each class before the test: about one in a device
LOG_PRIOR_ODDS = math.log(PRIOR_INCLUSION / (1.0 - PRIOR_INCLUSION))
TYPICAL, SPREAD = 0.04, 1.2  # of Fy, and of its logarithm: how large a curve is where there is one
FORMS = 0.5  # probability that a dependence has one of the published formulas of its coordinate
FEW_STARTS = 12  # formulas with more are tried in the place of a curve only
CURVES = (
    *dict.fromkeys(("capacity", one.group or one.id) for one in coordinates().values() if one.times is None),
    *(("added", name) for name, one in coordinates().items() if one.adds),
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
    known = catalogue()
    by_class: dict[tuple[str, str], list[Effect]] = {}
    for effect in known.values():
        for key in effect.acts:
            by_class.setdefault(key, []).append(effect)
    out = []
    for key, effects in by_class.items():
        if all(effect.mechanism in hidden for effect in effects):
            continue
        action, name = key
        shown = [effect for effect in effects if effect.mechanism not in hidden and not effect.form]
        if key in CURVES:
            over = coordinates_of(name)
            smooth = (1.0 - FORMS) * (1.0 - over[0].repeats)
            sides = over[0].sides if action == "capacity" else 0.0
            variants = tuple(
                Parametrisation(
                    curve := Curve(action, u.id, length, own), curve.effect(), smooth * weight * share / len(over)
                )
                for u in over
                for length, weight in u.lengths.items()
                for own, share in ((False, 1.0 - sides), (True, sides))
                if share
            )
            few = [effect for effect in shown if math.prod(map(len, start_values(effect))) <= FEW_STARTS]
            variants += tuple(Parametrisation(None, effect, FORMS / len(shown)) for effect in few)
            out.append(Dependence(action, name, over[0].unit, variants))
        else:
            variants = tuple(Parametrisation(None, effect, 1.0 / len(shown)) for effect in shown)
            out.append(Dependence(action, name, "1", variants))
    both = {name: one.unit for name, one in coordinates().items() if one.times is not None}
    rest = [_without_formula(name, unit, PRIOR_INCLUSION * (1.0 - FORMS)) for name, unit in both.items()]
    return (*out, *rest, *(_without_formula(name, one.unit) for name, one in measured.items() if name not in hidden))


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
                columns = (state.residual - data.residual(model, points)).T / step
                out.append(Candidate(one, variant, zero, columns, model))
                continue
            starts = np.array(extended(state.z, state.model, model, variant.effect))
            changes = (state.residual - data.residual(model, starts)).T
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
