"""Groups of a file: runs, one behind the other, or channels with times of their own, which are laid on one axis."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from shj_bayes.errors import RecordingError, did_you_mean
from shj_bayes.recording.limits import GAP_STEPS, MIN_SAMPLES, RESTART_GAP_STEPS, SAME_INSTANT
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.tables import Column
from shj_bayes.recording.units import factor

_TIME = {"time", "t", "times", "timestamp", "elapsed time", "test time", "zeit"}
# Groups of these names, told apart by a number, are different things and not runs of one device.
_NOT_RUNS = re.compile(r"specimen|device|damper|sample|sensor|card|daq|module|probe|channel|cell", re.IGNORECASE)


def grouped(
    columns: Sequence[Column], name: str, mark: str, sheet: str | None = None
) -> tuple[tuple[Column, ...], tuple[Finding, ...]]:
    """Columns of a file whose groups are told apart by `mark`, as columns of one table.

    Groups of the same channels whose names differ in a number are runs, one behind the other, with a column ``Run``.
    Elsewhere a time belongs to the channels beside it. `sheet` takes one group alone; `RecordingError` if there is none
    of that name.
    """
    if sheet is not None:
        columns = _chosen(columns, name, mark, sheet)
    clocked = _clocked(columns, mark)
    runs = _runs(clocked)
    if len(runs) < 2:
        return _named(clocked, mark), ()
    names = [group for group, _ in runs]
    rest = [c for c in clocked if c.group not in names]
    number = np.concatenate([np.full(own[-1].values.size, i, dtype=np.float64) for i, (_, own) in enumerate(runs, 1)])
    joined = [_joined([own[i] for _, own in runs]) for i in range(len(runs[0][1]))]
    run = Column("Run", number, None, "Run", clock_s=joined[-1].clock_s)
    words = (
        f"groups {_list(names)} hold the same channels: they are taken for runs of one device, in this order; "
        f"--sheet {names[0]!r} takes one alone"
    )
    return (*joined, run, *_named(rest, mark)), (Finding("groups", "assumed", words, len(runs)),)


def _chosen(columns: Sequence[Column], name: str, mark: str, sheet: str) -> list[Column]:
    """Columns of one group and of those in it."""
    known = list(dict.fromkeys(column.group for column in columns if column.group))
    inside = [c for c in columns if f"{c.group}{mark}".lower().startswith(f"{sheet.strip()}{mark}".lower())]
    if not inside:
        what = f"its groups are {_list(known)}{did_you_mean(sheet, known)}" if known else "the file has no groups"
        raise RecordingError(f"{name}: --sheet {sheet!r} is no group of it; {what}")
    return inside


def _clocked(columns: Sequence[Column], mark: str) -> list[Column]:
    """Columns with the times of their group, or of one that holds it, where a file has times in several places."""
    times = [column for column in columns if _is_time(column)]
    if len(times) < 2 and not any(column.clock_s is not None for column in columns):
        return list(columns)
    groups = [column.group for column in times]
    by_group = {c.group: (_seconds(c), bool(c.unit)) for c in times if groups.count(c.group) == 1}
    out = []
    for column in columns:
        group = column.group
        while group and group not in by_group:
            group = group.rpartition(mark)[0]
        clock, told = by_group.get(group, (None, True))
        fits = column.clock_s is None and clock is not None and clock.size == column.values.size
        out.append(replace(column, clock_s=clock, clock_told=told) if fits else column)
    return out


def _seconds(column: Column) -> FloatArray | None:
    """Give the times of a column in s; None where its unit is none of time."""
    try:
        scale = factor(column.unit or "s", "time")
    except RecordingError:
        return None
    return column.values if scale == 1.0 else column.values * scale


def _is_time(column: Column) -> bool:
    return re.sub(r"[\s_]+", " ", column.name.strip().lower()) in _TIME


def _runs(columns: Sequence[Column]) -> list[tuple[str, list[Column]]]:
    """Find the groups that are runs, in order; none where no two groups hold the same channels."""
    groups: dict[str, list[Column]] = {}
    for column in columns:
        groups.setdefault(column.group, []).append(column)
    families: dict[tuple[tuple[str, str | None], ...], list[str]] = {}
    for group, own in groups.items():
        if group and len({c.name for c in own if not _is_time(c)}) >= 2:
            families.setdefault(tuple(sorted((c.name, c.unit or "") for c in own)), []).append(group)
    largest = max(families.values(), key=len, default=[])
    if len(largest) < 2:
        return []
    skeletons = {re.sub(r"\d+", "#", group) for group in largest}
    lengths = [len(column.values) for group in largest for column in groups[group]]
    if len(skeletons) > 1 or _NOT_RUNS.search(largest[0]) or min(lengths) < MIN_SAMPLES:
        return []
    largest.sort(key=lambda group: [int(digits) for digits in re.findall(r"\d+", group)])
    first = [column.name for column in groups[largest[0]]]
    return [(group, sorted(groups[group], key=lambda c: first.index(c.name))) for group in largest]


def _joined(parts: list[Column]) -> Column:
    """Columns of the runs, one behind the other; times of their own follow those of the run before."""
    clocks: list[FloatArray] = []
    for part in parts:
        if part.clock_s is None or part.clock_s.size < 2:
            clocks = []
            break
        clock = part.clock_s
        if clocks and not clock[0] > clocks[-1][-1]:
            clock = clock + (clocks[-1][-1] - clock[0] + RESTART_GAP_STEPS * usual_step(clock))
        clocks.append(clock)
    values = np.concatenate([part.values for part in parts])
    header = parts[0].name if parts[0].unit is None else f"{parts[0].name} ({parts[0].unit})"
    return replace(parts[0], values=values, header=header, group="", clock_s=np.concatenate(clocks) if clocks else None)


def _named(columns: Sequence[Column], mark: str) -> tuple[Column, ...]:
    """Columns by their own names, with the group before it where a name comes twice."""
    names = [column.name for column in columns]
    return tuple(_full(c, mark) if names.count(c.name) > 1 and c.group else c for c in columns)


def _full(column: Column, mark: str) -> Column:
    """Column with its group in the name."""
    path = f"{column.group}{mark}"
    header = column.header if column.header.startswith(path) else f"{path}{column.header}"
    return replace(column, name=f"{path}{column.name}", header=header)


def _list(names: Sequence[str]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return f"{', '.join(names[:8])}{more}"


def usual_step(clock_s: FloatArray) -> float:
    """Median step of times, s; NaN where there are no two."""
    steps = np.diff(clock_s)
    steps = steps[np.isfinite(steps)]
    return float(np.median(steps)) if steps.size else float("nan")


def clock_of(columns: Iterable[Column]) -> FloatArray | None:
    """Give the times that all of some columns have, s; None where one has none of its own.

    `RecordingError` where they differ: then no formula may hold both.
    """
    clocks = [(column.header or column.name, column.clock_s) for column in columns]
    if not clocks or any(clock is None for _, clock in clocks):
        return None
    first, clock = clocks[0]
    for other, its in clocks[1:]:
        if not same_clock(clock, its):
            raise RecordingError(f"--columns: {first!r} and {other!r} have different times; no formula can hold both")
    return clock


def same_clock(left: FloatArray | None, right: FloatArray | None) -> bool:
    """Whether two channels were read at the same instants."""
    if left is None or right is None:
        return left is right
    if left is right:
        return True
    if left.size != right.size:
        return False
    near = SAME_INSTANT * float(np.nan_to_num(abs(usual_step(left))))
    return bool(np.allclose(left, right, rtol=0.0, atol=near, equal_nan=True))


def described(clock_s: FloatArray) -> str:
    """Say rate, first and last time."""
    step = usual_step(clock_s)
    rate = f"{1.0 / step:.4g} Hz" if step > 0 else "times"
    return f"{rate} from {clock_s[0]:.6g} to {clock_s[-1]:.6g} s"


def one_axis(x_s: FloatArray, f_s: FloatArray, name: str) -> FloatArray:
    """Instants, s, at which displacement and force are both known, of the times of their readings, s.

    They are instants at which the force was read, at most one for each reading of the displacement: so no force is ever
    made up, and the displacement is looked up between two readings that stand beside it. Instants in gaps of the
    displacement are none of them. `RecordingError` where the two hardly overlap, or times do not increase.
    """
    for what, clock in (("displacement", x_s), ("force", f_s)):
        if clock.size < 2 or not np.all(np.diff(clock) > 0):
            raise RecordingError(
                f"{name}: displacement and force have times of their own, and those of the {what} do not always "
                "increase; export both with one time"
            )
    x_step, f_step = usual_step(x_s), usual_step(f_s)
    near = SAME_INSTANT * min(x_step, f_step)
    axis = f_s[(f_s >= x_s[0] - near) & (f_s <= x_s[-1] + near)]
    if f_step < 0.99 * x_step and axis.size > 1:
        before, behind = beside(axis, x_s).T
        nearest = np.where(x_s - axis[before] < axis[behind] - x_s, before, behind)
        axis = axis[np.unique(nearest[np.abs(axis[nearest] - x_s) <= 0.5 * f_step + near])]
    left, right = beside(x_s, axis).T
    whole = (x_s[right] - x_s[left] <= GAP_STEPS * x_step) | (np.abs(axis - x_s[left]) <= near)
    axis = np.asarray(axis[whole | (np.abs(x_s[right] - axis) <= near)], dtype=np.float64)
    if axis.size < MIN_SAMPLES:
        raise RecordingError(
            f"{name}: displacement has {described(x_s)}, force {described(f_s)}: {axis.size} readings are of the same "
            f"time, needed are {MIN_SAMPLES}; export both with one time"
        )
    return axis


def beside(times: FloatArray, at: FloatArray) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Places of the times before and behind each instant, shape (n, 2)."""
    right = np.clip(np.searchsorted(times, at), 1, times.size - 1)
    return np.column_stack([right - 1, right])
