"""Loading histories: what is asked of the margins, and the channels that a history follows."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import PopulationError, plain_text
from shj_bayes.margins.specimen import Belief, Specimen, drive, largest_ranges
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.model.curve import curve_named
from shj_bayes.model.history import History, histories, on_scales_of
from shj_bayes.options import MarginOptions
from shj_bayes.recording.columns import choose_history
from shj_bayes.recording.motion import Block, Motion, alternating, exact_motion, hysteresis
from shj_bayes.recording.reader import read_table

PLACES = 41


@dataclass(frozen=True)
class MeasuredChannel:
    """A channel that the force of a device follows."""

    coordinate: str
    unit: str
    # low to high: least, median and largest value in the device's test
    low: float
    reference: float
    high: float
    # weakest, strongest: where the curve of the typical device is lowest and highest
    weakest: float
    strongest: float


def measured_channels(specimen: Specimen) -> tuple[MeasuredChannel, ...]:
    """Find the channels that the models of a device follow."""
    history, share = specimen.histories[0], np.linspace(0.0, 1.0, PLACES)
    out = {}
    for belief in specimen.beliefs:
        typical = belief.typical[0]
        for effect in belief.model.effects:
            curve = curve_named(effect.id)
            if curve is None or not curve.over.measured:
                continue
            own = [typical[belief.model.names.index(f"{effect.id}.{name}")] for name in effect.names]
            factor = curve.rows(share, np.ones(PLACES)) @ np.array(own)
            ends = curve.over.value_of(share[[np.argmin(factor), np.argmax(factor)]], history).tolist()
            one = history.measured[curve.coordinate]
            found = (curve.coordinate, one.unit, one.low, one.reference, one.high)
            out[curve.coordinate] = MeasuredChannel(*found, *ends)
    return tuple(out.values())


def values_to_try(specimen: Specimen) -> tuple[Mapping[str, float], ...]:
    """Values of the channels, by coordinate, at which a device is driven through a history that does not give them.

    Medians first; then, of a device that follows some, all where its force is lowest and all where it is highest: each
    multiplies the sliding force, so together they reach farthest.
    """
    found = measured_channels(specimen)
    places = ("reference", "weakest", "strongest") if found else ("reference",)
    return tuple({one.coordinate: getattr(one, place) for one in found} for place in places)


def channel_words(by_device: Sequence[tuple[MeasuredChannel, ...]], *, own_test: bool) -> tuple[str, ...]:
    """Say what forces follow, at which values they were taken, and what the designer has to see to.

    `own_test` is whether devices are taken through their own tests, of which the channels are known.
    """
    out = []
    for own, title, span in _by_channel(by_device):
        middle = float(np.median([one.reference for one in own]))
        how = (
            f"its values are those of the tests, {span}"
            if own_test
            else f"it is taken at the median of each test (typically {middle:.4g}), and limits are the outermost over "
            f"what was recorded, {span}"
        )
        out.append(
            f"The sliding force of {len(own)} of {len(by_device)} devices follows {title}: {how}. Outside that range "
            "nothing is known: keep the connection within it, or test where it will serve."
        )
    return tuple(out)


def left_out_words(by_device: Sequence[tuple[MeasuredChannel, ...]]) -> tuple[str, ...]:
    """Say what a material for structural analysis does not carry of that."""
    return tuple(
        f"Not carried, that the force follows {title}. The bounds are those of tests at {span}."
        for _, title, span in _by_channel(by_device)
    )


def _by_channel(by_device: Sequence[tuple[MeasuredChannel, ...]]) -> Iterator[tuple[list[MeasuredChannel], str, str]]:
    """Each channel: of the devices that follow it, its title, and the range that was recorded, in words."""
    for name in dict.fromkeys(one.coordinate for found in by_device for one in found):
        own = [one for found in by_device for one in found if one.coordinate == name]
        low, high = min(one.low for one in own), max(one.high for one in own)
        unit = f" {own[0].unit}" if own[0].unit else ""
        yield own, coordinate_named(name).title, f"{low:.4g} to {high:.4g}{unit}"


PUBLISHED_DEP = (30.0, -30.0)
LEEWAY = 1.02
"""Share by which noise may carry a coordinate beyond what was tested."""
CHANGE = 1e-6
"""Share of the largest force by which it must change for the model to depend on a coordinate."""
STEP_MM = 0.5
SAMPLES = 400
Stretch = Callable[[FloatArray], FloatArray]
LAWS: dict[str, Stretch] = {
    "held": lambda r: 1.0 + 1e-6 * (r - 1.0),
    "saturating": lambda r: 2.0 - np.exp(-(r - 1.0)),
    "logarithmic": lambda r: 1.0 + np.log(r),
}
"""Value of a coordinate that a model is given in place of one beyond the tested end, both as shares of that end: no
further change, a change that ends at twice the tested one, and one that slows down for ever."""


@dataclass(frozen=True, eq=False)
class LoadingHistory:
    """A displacement history."""

    time_s: FloatArray  # shape (n_samples,): sampling times
    motion: Motion  # displacement from the middle of the stroke, speed and half-cycles
    words: str  # what it is
    found: tuple[str, ...] = ()  # what was found or assumed in reading it
    of_drift: float = 1.0  # slip over the drift of the storey that it was made of; 1 for a slip

    def through(self, specimen: Specimen) -> tuple[History, ...]:
        """Histories of the same motion run after run, with the middle and the scales of the device's own test."""
        last, n_runs = specimen.histories[-1], len(specimen.histories)
        if n_runs not in self._runs:
            self._runs[n_runs] = histories([self.time_s] * n_runs, [self.motion] * n_runs)
        return tuple(on_scales_of(run, last, self.motion.displacement_mm) for run in self._runs[n_runs])

    @cached_property
    def _runs(self) -> dict[int, tuple[History, ...]]:
        return {}


@dataclass(frozen=True)
class LoadCase:
    """One way in which a device is driven through a history."""

    law: str  # "tested", or one of `LAWS` for what was not
    # further channels, by coordinate, and the values that they stand at; none where they are those of the test
    channels: tuple[tuple[str, float], ...] = ()
    speed_mm_s: float | None = None  # peak speed of every stroke; None where it is that of the history


def loading_history(request: MarginOptions, specimens: Sequence[Specimen]) -> LoadingHistory | None:
    """Give the history that is asked for; None for the test that each device went through.

    The largest common amplitude and speed of the tested devices stand in for what was not stated.
    """
    path = request.slip or request.history or request.drift
    if path is not None:
        return from_file(path, *request.slip_of_drift)
    if (request.amplitude_mm, request.speed_mm_s, request.cycles) == (None, None, None):
        return None
    ranges = largest_ranges(specimens)
    amplitude = ranges["position"] if request.amplitude_mm is None else request.amplitude_mm
    speed = ranges["speed"] if request.speed_mm_s is None else request.speed_mm_s
    return sine(amplitude, speed, 3 if request.cycles is None else request.cycles)


def sine(amplitude_mm: float, speed_mm_s: float, cycles: int) -> LoadingHistory:
    """So many full cycles of one amplitude and peak speed, with the quarters that lead in and out."""
    frequency = speed_mm_s / (2.0 * math.pi * amplitude_mm)
    time, motion = exact_motion((Block(amplitude_mm, frequency, cycles + 1),), SAMPLES * frequency)
    words = f"{cycles} cycles of {amplitude_mm:.3g} mm at a peak speed of {speed_mm_s:.3g} mm/s"
    return LoadingHistory(time, motion, words)


def from_file(path: Path, of_drift: float = 1.0, how: str = "") -> LoadingHistory:
    """Read a slip (mm) over time (s) as recordings are read; further columns are not.

    Of a drift so much (`of_drift`) is slip; `how` says how that was worked out.
    `RecordingError` where the file cannot be read as such, `PopulationError` where nothing moves or time does not grow.
    """
    time, x, findings = choose_history(read_table(path))
    if np.any(np.diff(time) <= 0) or not np.ptp(x) > 0:
        raise PopulationError(
            f"{path.name}: a history needs time (s) that grows from row to row and displacement (mm) that changes; "
            f"read were {time.size} rows"
        )
    x = of_drift * x
    curve = PchipInterpolator(time, x)
    n = int(min(max(np.abs(np.diff(x)).sum() / STEP_MM, 2000, time.size), 200_000))
    fine = np.unique(np.concatenate([time, np.linspace(time[0], time[-1], n)]))
    moved, speed = curve(fine), np.abs(curve.derivative()(fine))
    turns = hysteresis(moved, 1e-3 * float(np.ptp(x)))
    start = np.array([0, *(t for t in turns if 0 < t < fine.size - 1), fine.size])
    direction = alternating(start.size - 1, 1 if moved[start[1] - 1] > moved[0] else -1)
    motion = Motion(moved, speed, start, moved[start[:-1]], direction)
    found = tuple(f"{path.name}: {finding.message}" for finding in findings)
    head, tail = ("drift", f"{how}; ") if how else ("slip", "")
    largest = f"slip up to {np.abs(moved).max():.3g} mm at up to {speed.max():.3g} mm/s"
    words = f"the {head} of {plain_text(path.name)} ({tail}{largest})"
    return LoadingHistory(fine - fine[0], motion, words, found, of_drift)


def allowed(specimens: Sequence[Specimen], smallest_mm: float, of_drift: float) -> str:
    """Say what strokes and speeds all devices allow; `smallest_mm` is the least that slides fully."""
    ends = largest_ranges(specimens)
    kinds = (("slip", 1.0), ("drift", of_drift))[: 1 + (of_drift != 1.0)]
    return "these devices allow " + ", that is ".join(
        f"a {what} of {min(smallest_mm, ends['position']) / share:.3g} to {ends['position'] / share:.3g} mm at up to "
        f"{ends['speed'] / share:.3g} mm/s"
        for what, share in kinds
    )


SPEEDS = (1e-3, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Peak speeds of all strokes that bounds are taken over, as shares of the largest tested one: from standstill on."""
ALIKE_SPEED = 0.9
"""Share of that speed from which on a stroke counts as made at it."""


Cases = dict[LoadCase, tuple[History, ...]]


def at_other_speeds(cases: Cases, specimen: Specimen, *, beyond: Mapping[str, float]) -> Cases:
    """Give the same histories with every stroke at one peak speed; position, travel and time stay as they are.

    Where no model has more than the law's straight line over speed its ends do.
    """
    if not any(depends(belief, specimen.histories[-1], "speed") for belief in specimen.beliefs):
        return {}
    effects = [effect for belief in specimen.beliefs for effect in belief.model.effects]
    over = [{c.coordinate} if (c := curve_named(e.id)) else {name for _, name in e.acts} for e in effects]
    largest = specimen.ranges["speed"]
    laws = {case.law for case in cases} if set(beyond) - {"speed"} else {next(iter(cases)).law}
    out = {}
    for case, runs in cases.items():
        at_largest = all(run.motion.peak_mm_s[1:-1].min(initial=np.inf) >= ALIKE_SPEED * largest for run in runs)
        shares = SPEEDS if any("speed" in names for names in over) else (SPEEDS[0], SPEEDS[-1])
        for speed in largest * np.array(shares[:-1] if at_largest and not beyond else shares):
            if case.law in laws:
                out[replace(case, speed_mm_s=float(speed))] = tuple(_at_speed(run, speed) for run in runs)
    return out


def _at_speed(history: History, speed_mm_s: float) -> History:
    motion, peaks = history.motion, history.motion.peak_mm_s
    factor = speed_mm_s / np.maximum(peaks, 1e-6 * peaks.max())  # of a half-cycle that is none
    return replace(history, motion=replace(motion, speed_mm_s=motion.speed_mm_s * factor[motion.half_cycle]))


def load_cases(
    asked: LoadingHistory | None, specimen: Specimen, *, extrapolate: bool, limits: Callable[[], str] = str
) -> Cases:
    """Histories to drive a device through, for each law of what was not tested and each value of what is not known.

    Without `asked` the device's own test. The typical one comes first, those at other speeds last. `PopulationError`,
    which ends with what the devices allow (`limits`), if the history leaves what was tested and extrapolation was not
    asked for.
    """
    if asked is None:
        own = {LoadCase("tested"): specimen.histories}
        return own | at_other_speeds(own, specimen, beyond={})
    runs = asked.through(specimen)
    beyond, values = _beyond(runs, specimen), values_to_try(specimen)
    name = f"{specimen.set_name}, {specimen.name}"
    if "position" in beyond:
        raise PopulationError(
            f"{asked.words} reaches a position of {beyond['position']:.4g} mm, which was not tested; {name} was tested "
            f"up to {specimen.ranges['position']:.4g} mm. Nothing is said outside: the bolt may meet the slot. "
            f"{limits().capitalize()}"
        )
    counts = {k: v for k, v in beyond.items() if any(depends(b, specimen.histories[-1], k) for b in specimen.beliefs)}
    if counts and not extrapolate:
        coordinate, reached = next(iter(counts.items()))
        unit, tested = coordinate_named(coordinate).unit, specimen.ranges[coordinate]
        extra = f" {published_factors(reached)}" if coordinate == "speed" else ""
        raise PopulationError(
            f"{asked.words} reaches a {coordinate} of {reached:.4g} {unit}, which was not tested: {name} was tested up "
            f"to {tested:.4g} {unit}, and its force depends on it.{extra} With --extrapolate the spread of bounded "
            f"laws is given instead; {limits()}"
        )
    shapes = LAWS if counts else {"tested": None}
    cases = {
        LoadCase(law, tuple(at.items())): tuple(_stretched(run.held(at), specimen, counts, shape) for run in runs)
        for law, shape in shapes.items()
        for at in values
    }
    return cases | at_other_speeds(cases, specimen, beyond=beyond)


def _beyond(runs: Sequence[History], specimen: Specimen) -> dict[str, float]:
    """Coordinates that leave the tested range, with the largest value reached."""
    last = runs[-1]
    reached = {
        "position": float(np.abs(last.position_mm).max()),
        "speed": float(last.speed_mm_s.max()),
        "travel": float(last.travel_m[-1]),
        "time": float(last.begun_s + last.time_s[-1]),
    }
    return {name: value for name, value in reached.items() if value > LEEWAY * specimen.ranges[name]}


def untested(asked: LoadingHistory, specimens: Sequence[Specimen]) -> dict[str, float]:
    """Coordinates in which a history leaves the test of a device and its force depends on them: largest value."""
    out: dict[str, float] = {}
    for one in specimens:
        for name, value in _beyond(asked.through(one), one).items():
            if name == "position" or any(depends(belief, one.histories[-1], name) for belief in one.beliefs):
                out[name] = max(value, out.get(name, 0.0))
    return out


def depends(belief: Belief, history: History, coordinate: str) -> bool:
    """Whether the force of a model changes with a coordinate and nothing else."""
    motion = history.motion
    other = {
        "speed": lambda: replace(history, motion=replace(motion, speed_mm_s=1.5 * motion.speed_mm_s)),
        "travel": lambda: replace(history, travel_m=0.5 + 1.5 * history.travel_m),
        "time": lambda: replace(history, time_s=1.5 * history.time_s, begun_s=100.0 + 1.5 * history.begun_s),
    }[coordinate]()
    (before,), (after,) = (drive(belief.model, belief.typical, [h]) for h in (history, other))
    return bool(np.abs(after - before).max() > CHANGE * np.abs(before).max())


def _stretched(history: History, specimen: Specimen, beyond: dict[str, float], shape: Stretch | None) -> History:
    """History in which coordinates beyond the tested end are those of a bounded law; the same where there are none."""
    if shape is None:
        return history

    def bounded(values: FloatArray, name: str) -> FloatArray:
        if name not in beyond:
            return values
        share = values / specimen.ranges[name]
        return np.asarray(np.where(share > 1.0, shape(np.maximum(share, 1.0)), share) * specimen.ranges[name])

    total = bounded(history.begun_s + history.time_s, "time")
    return replace(
        history,
        motion=replace(history.motion, speed_mm_s=bounded(history.speed_mm_s, "speed")),
        travel_m=bounded(history.travel_m, "travel"),
        time_s=total - total[0],
        begun_s=float(total[0]),
    )


def published_factors(speed_mm_s: float) -> str:
    """Say what the published law does at a speed, and why that is meaningless when it is far from the tests.

    Eq. (2) multiplies the force by 1 + v/dep; fitted at one peak speed that is a tangent, not a law.
    """
    up, down = (1.0 + speed_mm_s / dep for dep in PUBLISHED_DEP)
    tangent = (
        ": a friction force that pushes the way it moves, and feeds energy in. That is the tangent of a curve "
        "at one speed, drawn on as a line, and means nothing there."
    )
    return (
        f"At {speed_mm_s:.4g} mm/s the published law multiplies the sliding force by {up:.3g} for dep = +30 mm/s and "
        f"by {down:.3g} for dep = -30 mm/s{tangent if down < 0 else '.'}"
    )
