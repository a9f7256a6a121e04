"""Virtual tests: the force of every device in a displacement history, read off and held against what was measured.

Each device gives one value of each design quantity with its own uncertainty. A quantity that bounds the force from
below is the least of what the device showed, of what its best model predicts and of what the law alone predicts, one
that bounds it from above the largest; typical quantities are those of the best model brought to what was measured. So
neither a wrong model nor a missing one makes a bound less safe than the recordings themselves.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray, one_blas_thread
from shj_bayes.errors import PopulationError
from shj_bayes.margins.history import LoadCase, LoadingHistory, MeasuredChannel, allowed, load_cases, measured_channels
from shj_bayes.margins.specimen import Belief, Specimen, drive
from shj_bayes.margins.spread import HIGH, LOW
from shj_bayes.model.history import History
from shj_bayes.model.parameters import base_of
from shj_bayes.population.device import NO_TAGS, DeviceEstimate, Tags
from shj_bayes.population.quantities import HIGHEST, LEAST, LOWEST, MOST, Band, Ordered, QuantityLikelihood, band_of
from shj_bayes.population.readings import (
    TABLE,
    THIRD,
    UNEVEN,
    Readings,
    counted_from,
    half_cycles_from,
    of_readings,
    pooled,
    read_off,
    sliding_from,
)
from shj_bayes.recording.motion import Block, exact_motion

SIDE = {LEAST: LOW, LOWEST: LOW, MOST: HIGH, HIGHEST: HIGH}
"""Side on which a quantity, of any run, must not be wrong; all others are typical values."""
LEAST_ERROR = 1e-3
"""Least standard deviation of the logarithm with which a value is taken to be known."""
Runs = tuple[Readings, ...]
Values = dict[str, FloatArray]
Loop = tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class VirtualTestResult:
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
    # by law, per run the widest cycle, each branch as displacement, shape (n,), and force of the draws, shape (m, n)
    loops: Mapping[str, tuple[Loop, ...]] = field(repr=False, default_factory=dict)
    laws: tuple[str, ...] = ("tested",)  # laws of what was not tested; "tested" alone where all was
    # whether the history is another one than that of its own test, so that the error of the model is carried over
    carried: bool = False
    channels: tuple[MeasuredChannel, ...] = ()  # further channels that its force follows
    laws_apart: float = 1.0  # greatest over least of a bounding force by the laws of what was not tested
    third_mm_s: float = np.nan  # peak speed of the third cycle of the first run, which the nominal force is of
    own: tuple[Readings, ...] = field(repr=False, default=())  # of its own test, run by run, by its best model

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
            name: QuantityLikelihood(
                False, np.log([value]), np.array([self.errors[name]]), np.ones(1), point=float(np.log(value))
            )
            for name, value in self.values.items()
        }
        return DeviceEstimate(self.name, self.set_name, known, tags)


@one_blas_thread
def virtual_tests(
    specimens: Sequence[Specimen], asked: LoadingHistory | None, *, extrapolate: bool = False
) -> tuple[VirtualTestResult, ...]:
    """Put every device through the virtual test: the history asked for, None for the test that each went through.

    `PopulationError` if the history leaves what was tested and is not to be extrapolated, or nothing slides in it.
    """

    def limits() -> str:
        return allowed(specimens, max(map(smallest_stroke, specimens)), 1.0 if asked is None else asked.of_drift)

    cases = [load_cases(asked, s, extrapolate=extrapolate, limits=limits) for s in specimens]
    driven: list[dict[LoadCase, list[Runs]]] = []
    loops: list[dict[str, tuple[Loop, ...]]] = []
    for specimen, of_one in zip(specimens, cases, strict=True):
        read, widest = dict[LoadCase, list[Runs]](), dict[str, tuple[Loop, ...]]()
        for case, runs in of_one.items():
            read[case] = []
            for belief in specimen.beliefs:
                forces = drive(belief.model, belief.theta, runs, specimen.start_force_kN if asked is None else ())
                read[case].append(_read(forces, runs))
                if case.law not in widest:
                    widest[case.law] = tuple(map(_widest, runs, forces))
        driven.append(read)
        loops.append(widest)
    first = [next(iter(read.values()))[0] for read in driven]
    common = max((a for a in map(counted_from, first) if np.isfinite(a)), default=np.inf)
    least = [common if _widest_mm(runs) >= 0.99 * common else counted_from(runs) for runs in first]
    if asked is not None and not np.isfinite(least).all():
        largest = max(map(_widest_mm, first))
        raise PopulationError(
            f"no half-cycle of {asked.words} slides fully in every device, so no sliding force can be read off it: the "
            f"widest from reversal to reversal is {2.0 * largest:.3g} mm, an amplitude of {largest:.3g} mm; {limits()}"
        )
    own, own_least = first, least
    if asked is not None:
        own = [own_readings(s) for s in specimens]
        own_least = [max(map(counted_from, own))] * len(own)
    each = zip(specimens, driven, loops, least, own, own_least, strict=True)
    return tuple(_result(*of_one, carried=asked is not None) for of_one in each)


def own_readings(specimen: Specimen) -> Runs:
    """Read the force that the best model of a device gives in its own test."""
    belief, runs = specimen.beliefs[0], specimen.histories
    return _read(drive(belief.model, belief.theta, runs, specimen.start_force_kN), runs)


def _read(forces: Sequence[FloatArray], runs: Sequence[History], *, measured: bool = False) -> Runs:
    return tuple(read_off(f, h.motion, h.travel_m, measured=measured) for f, h in zip(forces, runs, strict=True))


def _widest_mm(runs: Runs) -> float:
    """Largest amplitude from reversal to reversal, mm."""
    return max(float(r.amplitude_mm[r.complete].max(initial=0.0)) for r in runs)


GROWING = np.linspace(0.02, 1.0, 50)
"""Amplitudes, as shares of the largest tested one, of which the smallest that slides fully is looked for."""


def smallest_stroke(specimen: Specimen) -> float:
    """Smallest amplitude that slides fully by the models of a device, mm; infinity where none does."""
    ends = specimen.ranges
    blocks = tuple(Block(a, ends["speed"] / (2.0 * np.pi * a), 1) for a in ends["position"] * GROWING)
    time, motion = exact_motion(blocks, 40 * max(block.frequency_Hz for block in blocks))
    runs = LoadingHistory(time, motion, "growing strokes").through(specimen)
    found = [_read(drive(belief.model, belief.typical, runs), runs) for belief in specimen.beliefs]
    return max(sliding_from(readings, UNEVEN) for readings in found)


def _widest(history: History, force: FloatArray) -> Loop:
    """Cut the last cycle of the largest amplitude out of a run, whole, with a quarter of the draws."""
    motion = history.motion
    stroke = motion.stroke_mm
    # Of an irregular history the widest half-cycle, with the wider of those beside it.
    holds = np.maximum(stroke[:-1], stroke[1:]) >= 0.99 * stroke.max()
    pair = np.where(holds, stroke[:-1] + stroke[1:], 0.0)
    first = int(np.flatnonzero(pair >= 0.99 * pair.max(initial=0.0))[-1]) if pair.size else 0
    branches = []
    for h in (first, min(first + 1, motion.n_half - 1)):
        part = slice(motion.start[h], motion.start[h + 1])
        branches.append((motion.displacement_mm[part], force[::4, part]))
    up = 0 if motion.direction[first] > 0 else 1
    return branches[up], branches[1 - up]


def _result(
    specimen: Specimen,
    found: Mapping[LoadCase, list[Runs]],
    loops: Mapping[str, tuple[Loop, ...]],
    least: float,
    own: Runs,
    own_least: float,
    *,
    carried: bool,
) -> VirtualTestResult:
    """Hold a driven device against what was measured in its own test, of which its best model gives `own`."""
    by_course = {one: [dict(pooled(_quantities(runs, least))) for runs in models] for one, models in found.items()}
    tables = _quantities(next(iter(found.values()))[0], least)
    seen: list[Values] = [{}] * len(tables)
    gap: dict[str, float] = {}
    cycles, noise = np.empty(0), 0.0
    if specimen.measured_kN:
        measured = _read([force[None] for force in specimen.measured_kN], specimen.histories, measured=True)
        of_test = _quantities(measured, own_least)
        seen = seen if carried else of_test
        predicted = {q: float(np.median(v)) for q, v in pooled(_quantities(own, own_least))}
        gap = {q: float(np.log(v[0] / predicted[q])) for q, v in pooled(of_test) if v[0] > 0 and predicted[q] > 0}
        cycles, noise = _cycle_errors(measured, own, own_least, specimen.beliefs[0])
    n = max(cycles.size, 1)
    values, errors = {}, {}
    laws = tuple(dict.fromkeys(course.law for course in by_course if course.speed_mm_s is None))
    apart = 1.0
    belief = specimen.beliefs[0]
    shares = {"plateau": n, "energy": n, "ratio": n / 2, "third": 2}
    for q in by_course[next(iter(by_course))][0]:
        side = SIDE.get(base_of(q))
        # Bounds hold for all speeds; what is typical is that of the history.
        courses = {course: models for course, models in by_course.items() if side or course.speed_mm_s is None}
        typical = [[_middle_and_sd(model[q]) for model in models] for models in courses.values()]
        best = [models[0] for models in typical]
        # In its own test that is the measured value, of which no model is unsure.
        ours = [1.0 if carried or course.speed_mm_s is not None else 0.0 for course in courses]
        factor = float(np.exp(gap.get(q, 0.0)))
        corrected = [(x * factor, own * sd) for (x, sd), own in zip(best, ours, strict=True)] if q in gap else []
        if q in (LOWEST, HIGHEST):
            ends = [float(np.median(by_course[course][0][q])) for course in courses if course.speed_mm_s is None]
            apart = max(apart, max(ends) / max(min(ends), 1e-9)) if len(laws) > 1 else 1.0
        if side:
            values[q], sd = (min if side == LOW else max)([*(one for models in typical for one in models), *corrected])
        else:
            values[q], sd = (float(x) for x in np.median(corrected or best, axis=0))
        reading = noise / np.sqrt(max(shares.get(base_of(q), 1), 1))
        errors[q] = max(float(np.hypot(sd, reading)), LEAST_ERROR)
    stiffness = np.log(belief.theta[:, belief.model.names.index("K")])
    values["K"], errors["K"] = float(np.exp(np.mean(stiffness))), max(float(np.std(stiffness)), LEAST_ERROR)
    table = tuple(
        {q: (*band_of(run[q]), float(shown[q][0]) if q in shown else np.nan) for q in TABLE}
        for run, shown in zip(tables, seen, strict=True)
    )
    told = (specimen.name, specimen.set_name, table, values, errors, gap, cycles, loops, laws, carried)
    (first, *_) = next(iter(found.values()))[0]
    slides = half_cycles_from(first, least)
    third = float(first.peak_mm_s[slides[min(2 * THIRD, slides.size - 1)]]) if len(laws) == 1 else np.nan
    return VirtualTestResult(*told, measured_channels(specimen), apart, third, own)


STEP = 1.05
"""Greatest over least amplitude of half-cycles that make one point of the curve over amplitude."""


@dataclass(frozen=True)
class CyclePoint:
    """Cycles of one amplitude in the tests of a set, as displacement-based design takes them: 5, 50 and 95 %."""

    set_name: str
    n_devices: int
    run: int  # 1: first event, 2: second event
    amplitude_mm: float
    stiffness_kN_mm: Band  # effective: force at the end of the stroke over the amplitude
    damping: Band  # equivalent viscous: E / (2 pi k A^2), E the energy of a cycle


def over_amplitude(tests: Sequence[VirtualTestResult]) -> tuple[CyclePoint, ...]:
    """Effective stiffness and damping over the amplitude, of the tested devices in their own tests, run by run.

    Points are those amplitudes that every device of a set went through; the band is over devices and what is not known
    of each.
    """
    out = []
    for name in dict.fromkeys(test.set_name for test in tests):
        own = [test.own for test in tests if test.set_name == name]
        for run, readings in enumerate(zip(*own, strict=False), start=1):
            every = np.sort(np.concatenate([one.amplitude_mm[one.complete] for one in readings]))
            while every.size:
                low, high = every[0] * (1.0 - 1e-9), every[0] * STEP
                chosen = [one.complete & (one.amplitude_mm >= low) & (one.amplitude_mm <= high) for one in readings]
                every = every[every > high]
                if all(part.sum() > 1 for part in chosen):  # a push and a pull: strokes from block to block are none
                    found = [_cycle(one, part) for one, part in zip(readings, chosen, strict=True)]
                    amplitudes, *of_draws = zip(*found, strict=True)
                    bands = (band_of(np.concatenate(values)) for values in of_draws)
                    out.append(CyclePoint(name, len(own), run, float(np.mean(amplitudes)), *bands))
    return tuple(out)


def _cycle(readings: Readings, chosen: BoolArray) -> tuple[float, FloatArray, FloatArray]:
    """Amplitude, and effective stiffness and damping, each of shape (m,), of some half-cycles."""
    amplitude = float(readings.amplitude_mm[chosen].mean())
    stiffness = np.maximum(readings.end_kN[:, chosen].mean(axis=1), 1e-9) / amplitude
    energy = 2000.0 * readings.work_kJ[:, chosen].mean(axis=1)
    return amplitude, stiffness, energy / (2.0 * np.pi * stiffness * amplitude**2)


def _middle_and_sd(draws: FloatArray) -> tuple[float, float]:
    """Median, and half the width of the middle 68 % of the logarithm: one wild draw of 64 is no error of the others."""
    low, middle, high = map(Ordered(np.maximum(draws, 1e-9)).quantile, (0.1587, 0.5, 0.8413))
    return middle, 0.5 * float(np.log(high / low))


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
