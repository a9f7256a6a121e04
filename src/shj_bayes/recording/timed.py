"""Columns of a text table with their times: time stamps, intervals of LabVIEW, pairs of time and channel."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.columns import roles_named
from shj_bayes.recording.heads import Head, Wave
from shj_bayes.recording.limits import SAME_INSTANT
from shj_bayes.recording.numerals import TableNumbers
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.stamps import Stamps
from shj_bayes.recording.tables import Column
from shj_bayes.recording.units import factor


def timed(read: TableNumbers, head: Head, name: str) -> tuple[tuple[Column, ...], list[Finding]]:
    """Columns of what was read, with one time where all channels have the same, and what to say."""
    findings: list[Finding] = []
    values, units = list(read.values), list(head.units)
    dates = [stamps for stamps in read.stamps if stamps is not None and not stamps.n_clocks]
    for i, stamps in enumerate(read.stamps):
        if stamps is not None:
            label = head.names[i] or f"#{i + 1}"
            beside = dates[0] if len(dates) == 1 and not stamps.known else None
            values[i], units[i], said = stamps.joined(label, head.written[i], beside)
            findings += said if stamps.n_clocks else []
    columns = [
        Column(label or f"#{i + 1}", values[i], units[i], head.written[i], read.n_words[i])
        for i, label in enumerate(head.names)
    ]
    columns = _with_waves(columns, head, read.heads, findings)
    if len(columns) < len(read.values):  # each channel has its own
        return tuple(columns), findings
    return tuple(_one_time(columns, read.stamps, name, findings)), findings


def _with_waves(
    columns: list[Column], head: Head, again: list[tuple[int, Head]], findings: list[Finding]
) -> list[Column]:
    """Columns of a LabVIEW file whose ``X_Value`` is empty, with the times that start and interval give."""
    if not any(wave.step_s > 0 for wave in head.waves) or np.isfinite(columns[0].values).any():
        return columns
    n_rows = columns[0].values.size
    edges = [0, *(row for row, _ in again), n_rows]
    heads = [head, *(one for _, one in again)]
    clocks = []
    for i in range(len(columns) - 1):
        waves = [one.waves[i] if i < len(one.waves) else Wave("", 0.0, 0.0) for one in heads]
        starts = Stamps()
        starts.add(wave.started for wave in waves)
        at = np.nan_to_num(starts.absolute())
        pieces = [
            start + wave.first_s + wave.step_s * np.arange(b - a)
            for start, wave, a, b in zip(at, waves, edges[:-1], edges[1:], strict=True)
        ]
        clocks.append(np.concatenate(pieces))
    first = min(float(clock[0]) for clock in clocks)
    if any(not np.allclose(clock, clocks[0], rtol=0, atol=1e-9) for clock in clocks):
        return [replace(column, clock_s=clock - first) for column, clock in zip(columns[1:], clocks, strict=True)]
    shown = f"{columns[0].header or columns[0].name}: {head.waves[0].step_s:g} s"
    findings.append(Finding("time-from-step", "assumed", f"time is made from the constant interval of {shown}"))
    return [replace(columns[0], name="X_Value", values=clocks[0] - first, unit="s"), *columns[1:]]


def _one_time(columns: list[Column], stamps: list[Stamps | None], name: str, findings: list[Finding]) -> list[Column]:
    """Columns without the times that say the same as another one, as beside each channel of a data logger.

    Where times beside the channels differ, each channel keeps its own.
    """
    times = [
        i for i, column in enumerate(columns) if "time" in roles_named(column.name) and _seconds(column) is not None
    ]
    if len(times) < 2:
        return columns
    # numbers rather than stamps, and of these the finer
    best = min(times, key=lambda i: (stamps[i] is not None, -np.unique(columns[i].values).size))
    same = [i for i in times if i != best and _agree(columns, stamps, best, i)]
    paired = times[0] == 0 and times[-1] < len(columns) - 1 and bool(np.all(np.diff(times) > 1))
    if paired and len(same) < len(times) - 1:
        if any(stamps[i] is not None for i in times):
            shown = ", ".join(f"{columns[i].header or columns[i].name} for {columns[i + 1].name}" for i in times)
            raise RecordingError(f"{name}: the channels have time stamps of their own ({shown}); export one for all")
        return [
            _with_clock(columns[j], columns[i])
            for i, end in pairwise([*times, len(columns)])
            for j in range(i + 1, end)
        ]
    if same:
        shown = ", ".join(columns[i].header or columns[i].name for i in same)
        message = f"{shown}: the same times as {columns[best].header or columns[best].name}, which is read"
        findings.append(Finding("times-agree", "note", message, len(same)))
    return [column for i, column in enumerate(columns) if i not in same]


def _with_clock(column: Column, time: Column) -> Column:
    """Give a column the times beside it, as far as these go."""
    clock = _seconds(time)
    known = np.isfinite(time.values)
    return column if clock is None else replace(column, values=column.values[known], clock_s=clock[known])


def _agree(columns: list[Column], stamps: list[Stamps | None], one: int, other: int) -> bool:
    """Whether two times are the same; seconds and time stamps to the last digit of the coarser, from their first on."""
    first, second = stamps[one], stamps[other]
    if first is not None and second is not None:
        if next(iter(first.known), "") != next(iter(second.known), ""):
            return False
        a, b = first.absolute(), second.absolute()
    else:
        a, b = columns[one].values * _scale(columns[one]), columns[other].values * _scale(columns[other])
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) < max(2, 0.99 * np.count_nonzero(np.isfinite(a) | np.isfinite(b))):
        return False
    a, b = a[both], b[both]
    steps = [float(np.median(moves[moves > 0])) if np.any(moves > 0) else 0.0 for moves in (np.diff(a), np.diff(b))]
    if (first is None) != (second is None):
        return bool(np.max(np.abs(a - a[0] - b + b[0])) <= 1.01 * max(steps))
    return bool(np.max(np.abs(a - b)) <= SAME_INSTANT * steps[0])


def _seconds(column: Column) -> FloatArray | None:
    """Give the times of a column in s; None where its unit is none of time."""
    try:
        return column.values * _scale(column)
    except RecordingError:
        return None


def _scale(column: Column) -> float:
    return factor(column.unit or "s", "time")
