"""Whether the force of two sets depends alike on a coordinate: on speed, travel, time, position or amplitude.

What the best model of a device says of a coordinate (effects, curves, for the speed gamma besides) is taken as a factor
on its sliding force in the first run, relative to the place where curves over that coordinate are 0. A device whose
model does not hold the coordinate has a factor of 1. The logarithms at a few stated values are pooled one by one like
any other quantity, then tied together by the correlation that devices of one set show, so that all values can be spoken
of at once.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from shj_bayes._util.arrays import FloatArray, one_blas_thread
from shj_bayes.margins.specimen import Specimen
from shj_bayes.model.coordinates import Coordinate, coordinates
from shj_bayes.model.curve import curve_named
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Effect, combine
from shj_bayes.population.compare import ROPE_SPEED, Stratum, members, shift_of, strata_of
from shj_bayes.population.hierarchy import MAIN_PRIOR, DeviceSet, PopulationResult, fit_quantities
from shj_bayes.population.predict import correlation_draws
from shj_bayes.population.quantities import LEVELS, Band, QuantityLikelihood, population_prior, stream

SPEED = "speed"
COMPARED = tuple(name for name, one in coordinates().items() if name == "travel" or not one.of_base)
"""Coordinates that are compared: those that mean the same in every device, and the distance slid, nearly so."""
PLACES = 5
"""Stated values over the shared range, evenly spaced, the one that the factors are relative to among them."""
ENDS = (0.005, 0.995)
"""Of the values of a coordinate in a run: what noise and the first samples reach is no range."""
LEAST_ERROR = 1e-3
"""Least standard deviation of a logarithm with which a factor is taken to be known."""
LEAST_FACTOR = 1e-3


@dataclass(frozen=True)
class CurveContrast:
    """How the force of a over that of b changes along a coordinate."""

    set_a: str
    set_b: str
    coordinate: str
    unit: str
    reference: float  # value at which both sides count as 1
    at: tuple[float, ...]  # stated values
    percent: tuple[Band, ...]  # 5, 50 and 95 % of the factor of a over that of b, less 1, per cent, at each
    # content of the smallest region of all values together that leaves no difference out; the least of the priors of
    # the spread
    probability_other: float
    # probability that the factors differ by less than practical equivalence at every stated value
    probability_rope: float
    rope: float  # half-width of the region of practical equivalence, as a share of the force
    n_a: int
    n_b: int

    def rows(self) -> list[dict[str, object]]:
        """One row per stated value."""
        same = {k: v for k, v in asdict(self).items() if k not in ("at", "percent")}
        return [
            {**same, "at": u, "q05_percent": low, "q50_percent": middle, "q95_percent": high}
            for u, (low, middle, high) in zip(self.at, self.percent, strict=True)
        ]


@one_blas_thread
def compare_curves(
    result: PopulationResult, specimens: Sequence[Specimen], set_a: str, set_b: str, *, rope: float
) -> tuple[CurveContrast, ...]:
    """Compare two sets, or two kinds of sets, over every coordinate that models of both sides hold.

    `result` gives the tags of the sets and the seed, `rope` the half-width of the region of practical equivalence as a
    share of the force. Speed comes first, which the published law holds.
    """
    sides = members(result, strata_of(result, set_a, set_b)[2])
    held = [{name for s in specimens if s.set_name in names for name in _held(s.beliefs[0].model)} for names in sides]
    groups = tuple(group for group in result.sets if group.name in {*sides[0], *sides[1]})
    both = [s for s in specimens if s.set_name in {group.name for group in groups}]
    found = (
        _contrast(replace(result, sets=groups), both, one, (set_a, set_b), rope)
        for name, one in coordinates().items()
        if name in held[0] & held[1]
    )
    return tuple(sorted((c for c in found if c is not None), key=lambda c: c.coordinate != SPEED))


def _over(effect: Effect) -> str:
    """Coordinate that an effect on the capacity depends on; empty where it is another kind of effect."""
    curve = curve_named(effect.id)
    action, name = (curve.action, curve.coordinate) if curve else effect.acts[0]
    return name if action == "capacity" and name in COMPARED else ""


def _held(model: DeviceModel) -> set[str]:
    """Coordinates that the sliding force of a model depends on."""
    return {*filter(None, map(_over, model.effects)), *([SPEED] if model.speed else [])}


def _along(specimen: Specimen, coordinate: Coordinate) -> FloatArray:
    """Coordinate at the samples of the first run, for typical parameters of the device."""
    belief = specimen.beliefs[0]
    base, _ = next(belief.model.acting(belief.typical, 1))
    return coordinate.values(specimen.histories[0], base)


def log_factors(specimen: Specimen, coordinate: Coordinate, at: FloatArray) -> FloatArray:
    """Logarithm of the factor that a coordinate makes in the first run, mean of push and pull.

    At values of the coordinate, shape (n,), for every draw of the device, shape (m, n).
    """
    history, belief = specimen.histories[0], specimen.beliefs[0]
    over = {e.id for e in belief.model.effects if _over(e) == coordinate.id}
    along, ways = _along(specimen, coordinate), []
    for sign in (1, -1):
        own = np.flatnonzero(history.direction == sign)
        ways.append(own[np.argsort(along[own], kind="stable")])
    out = np.empty((belief.theta.shape[0], at.size))
    for j, (base, acting) in enumerate(belief.model.acting(belief.theta, 1)):
        total = combine([effect.act(history, values, base) for effect, values in acting if effect.id in over])
        factor = np.broadcast_to(total.clamping, along.shape)
        if coordinate.id == SPEED:
            factor = factor * (1.0 + (base.gamma + total.gamma_s_per_mm) * along)
        logs = np.log(np.maximum(factor, LEAST_FACTOR))
        out[j] = np.mean([np.interp(at, along[way], logs[way]) for way in ways], axis=0)
    return out


def _contrast(
    result: PopulationResult, specimens: Sequence[Specimen], coordinate: Coordinate, sides: tuple[str, str], rope: float
) -> CurveContrast | None:
    """Compare two sides over a coordinate; None where their devices share no range of it."""
    ends = [np.quantile(_along(specimen, coordinate), ENDS) for specimen in specimens]
    low, high = np.max(ends, axis=0)[0], np.min(ends, axis=0)[1]
    if not low < high:
        return None
    places = np.linspace(low, high, PLACES)
    zero = round(coordinate.zero_share * (PLACES - 1))  # what the factors are relative to
    reference, at = float(places[zero]), np.delete(places, zero)
    logs = {(s.set_name, s.name): log_factors(s, coordinate, np.append(reference, at)) for s in specimens}
    pooled = pool({key: own[:, 1:] - own[:, :1] for key, own in logs.items()}, result, coordinate.id)
    a, b, strata = strata_of(pooled, *sides)
    n_a, n_b = (sum(len(pooled.sets[i].devices) for s in strata for i in s[side]) for side in (0, 1))
    drawn = {label: shifts(pooled, strata, label) for label in (MAIN_PRIOR, *pooled.other_priors)}
    change = np.expm1(drawn[MAIN_PRIOR])
    quantiles = 100.0 * np.quantile(change, LEVELS, axis=0)
    bands = tuple((low, middle, high) for low, middle, high in quantiles.T.tolist())
    same = np.all((change > -rope / (1.0 + rope)) & (change < rope), axis=1)
    head = (a, b, coordinate.id, coordinate.unit, reference, tuple(at.tolist()))
    likely = (min(map(content, drawn.values())), float(np.mean(same)))
    return CurveContrast(*head, bands, *likely, rope, n_a, n_b)


def pool(logs: Mapping[tuple[str, str], FloatArray], result: PopulationResult, word: str) -> PopulationResult:
    """Pool the logarithms of devices, by (set, device), each of shape (m, n), value by value; quantities are numbered.

    `word` is what they are over; sets and seed are those of `result`.
    """
    groups = {group.name: [n for n in group.devices if (group.name, n) in logs] for group in result.sets}
    names = [str(k) for k in range(next(iter(logs.values())).shape[1])]
    middle = {key: own.mean(axis=0) for key, own in logs.items()}
    error = {key: np.maximum(own.std(axis=0), LEAST_ERROR) for key, own in logs.items()}
    gamma = population_prior("gamma")
    # What is believed of gamma, of the force at the speed at which practical equivalence is meant.
    scale = ("centre", "centre_sd", "between_scale", "spread_median")
    prior = replace(gamma, **{name: ROPE_SPEED * getattr(gamma, name) for name in scale})
    data = {
        name: [
            [QuantityLikelihood(False, middle[of, n][[k]], error[of, n][[k]], np.ones(1)) for n in devices]
            for of, devices in groups.items()
        ]
        for k, name in enumerate(names)
    }
    priors = dict.fromkeys(names, prior)
    others = fit_quantities(data, priors, result.seed, "curve", word)
    sets = []
    for group in result.sets:
        own = tuple(groups[group.name])
        points = {name: tuple(float(middle[group.name, n][k]) for n in own) for k, name in enumerate(names)}
        sets.append(DeviceSet(group.name, own, group.tags, points))
    return PopulationResult(tuple(sets), others.pop(MAIN_PRIOR), others, priors, {}, result.seed)


def shifts(pooled: PopulationResult, strata: Sequence[Stratum], prior: str) -> FloatArray:
    """Draws of the difference of both sides at all values together, shape (m, n).

    The values of one draw go together as those of one device do: a normal copula.
    """
    each = np.array([shift_of(pooled, name, strata, prior) for name in pooled.posteriors]).T
    rng = np.random.default_rng(stream(pooled.seed, prior))
    ties = np.linalg.cholesky(correlation_draws(pooled, each.shape[0], prior))
    together = np.einsum("mij,mj->mi", ties, rng.standard_normal(each.shape))
    order = np.argsort(np.argsort(together, axis=0), axis=0)
    return np.asarray(np.take_along_axis(np.sort(each, axis=0), order, axis=0))


def content(drawn: FloatArray) -> float:
    """Content of the smallest region, so many times the 90 % band at every value, that leaves 0 out."""
    low, middle, high = np.quantile(drawn, LEVELS, axis=0)
    away = np.max(np.abs(drawn - middle) / (high - low), axis=1)
    return float(np.mean(away < np.max(np.abs(middle) / (high - low))))
