"""The virtual test of every device of a campaign, beside what was measured, as devices to be pooled.

Each device gives one value of each design quantity with its own uncertainty. A quantity that bounds the force from
below is the least of what the device showed, of what its best model predicts and of what the law alone predicts, one
that bounds it from above the largest; typical quantities are those of the best model brought to what was measured. So
neither a wrong model nor a missing one makes a bound less safe than the recordings themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins.asked import Following, LoadCase, LoadingHistory, courses, following_of
from shj_bayes.margins.quantities import SIDE, TABLE, counted_from, of_readings, pooled
from shj_bayes.margins.row import LOW
from shj_bayes.margins.specimen import Belief, Specimen
from shj_bayes.margins.virtual_test import Readings, drive, read_off
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray, base_of
from shj_bayes.population.device import NO_TAGS, DeviceEstimate, Tags
from shj_bayes.population.quantities import Likelihood, Measurement, band_of

LEAST_ERROR = 1e-3
"""Least standard deviation of the logarithm with which a value is taken to be known."""
Runs = tuple[Readings, ...]
Values = dict[str, FloatArray]
Loop = tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class Trial:
    """A device after its virtual test."""

    name: str
    set_name: str
    # per run and quantity of ``quantities.TABLE``: 5, 50 and 95 % of the best model's draws, and the measured value
    # (NaN where none)
    table: tuple[dict[str, tuple[float, float, float, float]], ...]
    values: Mapping[str, float]  # pooled quantities: value of this device, natural unit
    # standard deviation of the logarithm with which it is known: that of whatever gave the value, a model or the
    # recording
    errors: Mapping[str, float]
    model_errors: Mapping[str, float]  # logarithm of measured over predicted, in its own test; empty without recordings
    # shape (n,): the same of the plateau force of each half-cycle that slides, predicted without it
    cycle_errors: FloatArray
    # per run the widest cycle, each branch as displacement, shape (n,), and force of the draws, shape (m, n)
    loops: tuple[Loop, ...] = field(repr=False, default=())
    laws: tuple[str, ...] = ("tested",)  # laws of what was not tested; "tested" alone where all was
    # whether the history is another one than that of its own test, so that the error of the model is carried over
    carried: bool = False
    following: tuple[Following, ...] = ()  # further channels that its force follows

    def __post_init__(self) -> None:
        """Refuse a value without a logarithm."""
        wrong = {name: value for name, value in self.values.items() if not (np.isfinite(value) and value > 0)}
        if wrong:
            raise PopulationError(
                f"{self.set_name}, {self.name}: {', '.join(f'{k} = {v:.4g}' for k, v in wrong.items())} in the virtual "
                "test; a force or energy must be above zero. Look at the fit of this device"
            )

    def estimate(self, tags: Tags = NO_TAGS) -> DeviceEstimate:
        """As a device of a population."""
        known = {
            name: Measurement(
                float(np.log(value)),
                Likelihood(False, np.log([value]), np.array([self.errors[name]]), np.ones(1)),
            )
            for name, value in self.values.items()
        }
        return DeviceEstimate(self.name, self.set_name, known, tags)


def try_all(
    specimens: Sequence[Specimen], asked: LoadingHistory | None, *, extrapolate: bool = False
) -> tuple[Trial, ...]:
    """Put every device through the virtual test: the history asked for, None for the test that each went through.

    `PopulationError` if the history leaves what was tested and is not to be extrapolated, or nothing slides in it.
    """
    driven = [_driven(s, courses(asked, s, extrapolate=extrapolate)) for s in specimens]
    first = [next(iter(found.values()))[0] for found, _ in driven]
    common = max((a for a in map(counted_from, first) if np.isfinite(a)), default=np.inf)
    least = [_from(readings, common) for readings in first]
    own, own_least = first, least
    if asked is not None:
        own = [own_readings(s) for s in specimens]
        own_least = [max(map(counted_from, own))] * len(own)
    each = zip(specimens, driven, least, own, own_least, strict=True)
    return tuple(_trial(*of_one, carried=asked is not None) for of_one in each)


def _driven(
    specimen: Specimen, histories: Mapping[LoadCase, tuple[History, ...]]
) -> tuple[dict[LoadCase, list[Runs]], tuple[Loop, ...]]:
    """Drive a device: readings by course and model, and the widest cycle of the best model."""
    found: dict[LoadCase, list[Runs]] = {}
    loops: tuple[Loop, ...] = ()
    for course, runs in histories.items():
        found[course] = []
        starts = specimen.start_force_kN if runs is specimen.histories else ()
        for belief in specimen.beliefs:
            forces = drive(belief.model, belief.theta, runs, starts)
            found[course].append(tuple(read_off(f, h.motion, h.travel_m) for f, h in zip(forces, runs, strict=True)))
            loops = loops or tuple(_widest(h, f) for h, f in zip(runs, forces, strict=True))
    return found, loops


def _widest(history: History, force: FloatArray) -> Loop:
    """Cut a complete cycle of the largest amplitude out of a run, with a quarter of the draws."""
    motion = history.motion
    stroke = np.abs(np.diff(motion.turning_mm))
    wide = np.flatnonzero((stroke[:-1] >= 0.99 * stroke.max()) & (stroke[1:] >= 0.99 * stroke.max()))
    first = int(wide[-1]) if wide.size else int(np.argmax(stroke))
    branches = []
    for h in (first, min(first + 1, motion.n_half - 1)):
        part = slice(motion.start[h], motion.start[h + 1])
        branches.append((motion.displacement_mm[part], force[::4, part]))
    up = 0 if motion.direction[first] > 0 else 1
    return branches[up], branches[1 - up]


def own_readings(specimen: Specimen) -> Runs:
    """Read the force that the best model of a device gives in its own test."""
    belief, runs = specimen.beliefs[0], specimen.histories
    forces = drive(belief.model, belief.theta, runs, specimen.start_force_kN)
    return tuple(read_off(f, h.motion, h.travel_m) for f, h in zip(forces, runs, strict=True))


def _from(first: Runs, common: float) -> float:
    """Amplitude from which half-cycles count: common to all devices, unless this one has none as wide."""
    widest = max(float(r.amplitude_mm[r.complete].max(initial=0.0)) for r in first)
    return common if widest >= 0.99 * common else counted_from(first)


def _trial(
    specimen: Specimen,
    driven: tuple[Mapping[LoadCase, list[Runs]], tuple[Loop, ...]],
    least: float,
    own: Runs,
    own_least: float,
    *,
    carried: bool,
) -> Trial:
    """Hold a driven device against what was measured in its own test, of which its best model gives `own`."""
    found, loops = driven
    by_course = {one: [dict(pooled(_quantities(runs, least))) for runs in models] for one, models in found.items()}
    tables = _quantities(next(iter(found.values()))[0], least)
    seen: list[Values] = [{}] * len(tables)
    gap: dict[str, float] = {}
    cycles, noise = np.empty(0), 0.0
    if specimen.measured_kN:
        measured = tuple(
            read_off(force[None], h.motion, h.travel_m, measured=True)
            for force, h in zip(specimen.measured_kN, specimen.histories, strict=True)
        )
        of_test = _quantities(measured, own_least)
        seen = seen if carried else of_test
        predicted = {q: float(np.median(v)) for q, v in pooled(_quantities(own, own_least))}
        gap = {q: float(np.log(v[0] / predicted[q])) for q, v in pooled(of_test) if v[0] > 0 and predicted[q] > 0}
        cycles, noise = _cycle_errors(measured, own, own_least, specimen.beliefs[0])
    n = max(cycles.size, 1)
    values, errors = {}, {}
    belief = specimen.beliefs[0]
    shares = {"plateau": n, "energy": n, "ratio": n / 2, "third": 2}
    for q in by_course[next(iter(by_course))][0]:
        typical = [[_middle_and_sd(model[q]) for model in models] for models in by_course.values()]
        best = [models[0] for models in typical]
        # In its own test that is the measured value, of which no model is unsure.
        ours = 1.0 if carried else 0.0
        brought = [(x * float(np.exp(gap[q])), ours * sd) for x, sd in best] if q in gap else []
        side = SIDE.get(base_of(q))
        if side:
            values[q], sd = (min if side == LOW else max)([*(one for models in typical for one in models), *brought])
        else:
            values[q], sd = (float(x) for x in np.median(brought or best, axis=0))
        reading = noise / np.sqrt(max(shares.get(base_of(q), 1), 1))
        errors[q] = max(float(np.hypot(sd, reading)), LEAST_ERROR)
    stiffness = np.log(belief.theta[:, belief.model.index("K")])
    values["K"], errors["K"] = float(np.exp(np.mean(stiffness))), max(float(np.std(stiffness)), LEAST_ERROR)
    table = tuple(map(_summary, tables, seen))
    laws = tuple(dict.fromkeys(course.law for course in found))
    told = (specimen.name, specimen.set_name, table, values, errors, gap, cycles, loops, laws, carried)
    return Trial(*told, following_of(specimen))


def _middle_and_sd(draws: FloatArray) -> tuple[float, float]:
    """Median, and half the width of the middle 68 % of the logarithm: one wild draw of 64 is no error of the others."""
    low, middle, high = np.quantile(np.maximum(draws, 1e-9), (0.1587, 0.5, 0.8413))
    return float(middle), 0.5 * float(np.log(high / low))


def _summary(run: Values, seen: Values) -> dict[str, tuple[float, float, float, float]]:
    """5, 50 and 95 % of every quantity of a run, and its measured value."""
    return {name: (*band_of(run[name]), float(seen[name][0]) if name in seen else np.nan) for name in TABLE}


def _quantities(runs: Runs, least: float) -> list[Values]:
    return [of_readings(readings, least) for readings in runs]


def _cycle_errors(measured: Runs, predicted: Runs, least: float, belief: Belief) -> tuple[FloatArray, float]:
    """Log of measured over predicted plateau of every half-cycle that counts, and how much of it is noise.

    Each half-cycle is predicted without it: draws are weighted with the inverse of its likelihood. The noise is that of
    the difference between half-cycles of the same direction that follow each other: what the model misses changes
    slowly from one to the next.
    """
    errors, apart = [], []
    for run, (seen, said) in enumerate(zip(measured, predicted, strict=True), start=1):
        counted = np.flatnonzero(seen.complete & (seen.amplitude_mm >= 0.99 * least))
        left_out = [_without(said.plateau_kN[:, h], belief.likely.get((run, int(h)))) for h in counted]
        ratio = seen.plateau_kN[0, counted] / np.array(left_out)
        error = np.log(np.maximum(ratio, 1e-3))
        errors.append(error)
        apart.append(error[2:] - error[:-2])
    steps = np.concatenate(apart)
    noise = float(np.median(np.abs(steps)) / (0.6745 * np.sqrt(2.0))) if steps.size else 0.0
    return np.concatenate(errors), noise


def _without(plateau_kN: FloatArray, likely: FloatArray | None) -> float:
    """Mean of a prediction over the draws as they would be without the half-cycle; weights are truncated."""
    if likely is None:
        return float(np.median(plateau_kN))
    weight = np.exp(np.min(likely) - likely)
    weight = np.minimum(weight, weight.mean() * np.sqrt(weight.size))
    return float(np.average(plateau_kN, weights=weight))
