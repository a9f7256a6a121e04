"""Columns of a text table with their times: time stamps, intervals of LabVIEW, pairs of time and channel."""

from dataclasses import replace

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.columns import roles_named
from shj_bayes.recording.heads import Head, Wave
from shj_bayes.recording.numerals import Numbers
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.stamps import Stamps
from shj_bayes.recording.tables import Column
from shj_bayes.recording.units import factor


def timed(read: Numbers, head: Head, name: str) -> tuple[tuple[Column, ...], list[Finding]]:
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
    columns = _with_waves(columns, head, read.heads, name, findings)
    return tuple(_one_time(columns, read.stamps, name, findings)), findings


def _with_waves(
    columns: list[Column], head: Head, again: list[tuple[int, Head]], name: str, findings: list[Finding]
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
    shown = ", ".join(
        f"{column.name} from {clock[0] - first:g} s every {wave.step_s:g} s"
        for column, clock, wave in zip(columns[1:], clocks, head.waves, strict=True)
    )
    if any(not np.allclose(clock, clocks[0], rtol=0, atol=1e-9) for clock in clocks):
        raise RecordingError(
            f"{name}: the channels have times of their own ({shown}); export them at one rate, from one start"
        )
    findings.append(Finding("time-from-step", "assumed", f"time is made from the constant interval of {shown}"))
    return [replace(columns[0], name="X_Value", values=clocks[0] - first, unit="s"), *columns[1:]]


def _one_time(columns: list[Column], stamps: list[Stamps | None], name: str, findings: list[Finding]) -> list[Column]:
    """Columns without the times that say the same as another one, as beside each channel of a data logger."""
    times = [
        i for i, column in enumerate(columns) if "time" in roles_named(column.name) and _seconds(column) is not None
    ]
    if len(times) < 2:
        return columns
    # numbers rather than stamps, and of these the finer
    best = min(times, key=lambda i: (stamps[i] is not None, -np.unique(columns[i].values).size))
    same = [i for i in times if i != best and _agree(columns[best], columns[i], stamps[i] is not None)]
    if same:
        shown = ", ".join(columns[i].header or columns[i].name for i in same)
        message = f"{shown}: the same times as {columns[best].header or columns[best].name}, which is read"
        findings.append(Finding("times-agree", "note", message, len(same)))
    elif times[0] == 0 and times[-1] < len(columns) - 1 and np.all(np.diff(times) > 1):
        shown = ", ".join(f"{columns[i + 1].name} {_described(columns[i])}" for i in times)
        raise RecordingError(
            f"{name}: the channels have times of their own ({shown}); export them at one rate, from one start"
        )
    return [column for i, column in enumerate(columns) if i not in same]


def _agree(one: Column, other: Column, stamped: bool) -> bool:
    """Whether two times are the same; of time stamps, to their last digit and from their first on."""
    a, b = _seconds(one), _seconds(other)
    if a is None or b is None:
        return False
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) < max(2, 0.99 * np.count_nonzero(np.isfinite(a) | np.isfinite(b))):
        return False
    a, b = a[both], b[both]
    steps = [float(np.median(moves[moves > 0])) if np.any(moves > 0) else 0.0 for moves in (np.diff(a), np.diff(b))]
    if stamped:
        return bool(np.max(np.abs(a - a[0] - b + b[0])) <= 1.01 * max(steps))
    return bool(np.max(np.abs(a - b)) <= 0.05 * steps[0])


def _described(column: Column) -> str:
    """Start and step of a time in words."""
    seconds = _seconds(column)
    known = np.zeros(1) if seconds is None else seconds[np.isfinite(seconds)]
    step = float(np.median(np.diff(known))) if known.size > 1 else 0.0
    return f"from {known[0] if known.size else 0:g} s every {step:g} s"


def _seconds(column: Column) -> FloatArray | None:
    """Give the times of a column in s; None where its unit is none of time."""
    try:
        return column.values * factor(column.unit or "s", "time")
    except RecordingError:
        return None
