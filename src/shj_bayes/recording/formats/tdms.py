"""TDMS files as LabVIEW writes them."""

import logging
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import RecordingError
from shj_bayes.recording.limits import MAX_PARTS
from shj_bayes.recording.recording import Column, Finding
from shj_bayes.recording.rows import split_header
from shj_bayes.recording.tables import Format, Table, as_floats, grouped, left_out, refuse_large, same_clock

_MARK = "/"  # between group and channel


def read_tdms(path: Path, sheet: str | None) -> Table:
    """Read the numeric channels and time stamps of a TDMS file, each with the times that its waveform states.

    One interval for all is the single number ``wf_increment`` (s). `sheet` is one of the groups.
    """
    with path.open("rb") as stream:
        if stream.read(4) != b"TDSm":
            raise RecordingError(f"{path.name} is not a TDMS file although its ending says so; export it again")
    from nptdms import TdmsFile  # noqa: PLC0415
    from nptdms.log import log_manager  # noqa: PLC0415

    log_manager.set_level(logging.CRITICAL)  # it writes to the terminal; what matters of it is a finding
    with TdmsFile.open(path) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        channels = [c for c in channels if c.dtype is not None and len(c)]
        if len(channels) > MAX_PARTS:
            raise RecordingError(f"{path.name} has {len(channels)} channels; allowed are {MAX_PARTS}; export fewer")
        skipped = [str(c.name) for c in channels if c.dtype.kind not in "fiuM"]
        channels = [c for c in channels if c.dtype.kind in "fiuM"]
        refuse_large(sum(8 * len(channel) for channel in channels), path.name)
        clocks, words = _clocks([channel for channel in channels if channel.dtype.kind != "M"])
        stamps = {c.path: np.asarray(c[:]).astype("datetime64[us]") for c in channels if c.dtype.kind == "M"}
        first_stamp = min((values.min() for values in stamps.values()), default=None)
        columns = []
        for of in channels:  # time stamps as seconds since the first one of the file
            moments = stamps.get(of.path)
            values = of[:] if moments is None else (moments - first_stamp) / np.timedelta64(1, "s")
            plain, own = split_header(str(of.name))
            unit = str(of.properties.get("unit_string") or of.properties.get("NI_UnitDescription") or "").strip()
            stated = "s" if of.dtype.kind == "M" else unit or own
            clock = clocks.get(of.path)
            columns.append(Column(plain, as_floats(values), stated, str(of.name), 0, str(of.group_name), clock))
        cut = file.file_status.incomplete_final_segment
        steps = {float(c.properties["wf_increment"]) for c in channels if "wf_increment" in c.properties}
    found, told = grouped(columns, path.name, _MARK, sheet)
    told += left_out(skipped)
    if cut:
        early = "the file ends early, in the midst of what was written last; what was there is read"
        told += (Finding("cut-short", "warning", early),)
    if words and any(c.clock_s is not None for c in found):
        told += (Finding("start-unknown", "assumed", words),)
    first = next((column.clock_s for column in found if column.clock_s is not None), None)
    one = len(steps) == 1 and not any(c.name == "Run" for c in found)
    one = one and all(column.clock_s is None or same_clock(column.clock_s, first) for column in found)
    scalars = {"wf_increment": steps.pop()} if one else {}
    return Table(path.name, found, scalars=scalars, findings=told)


def _clocks(channels: list[Any]) -> tuple[dict[str, FloatArray], str]:
    """Give the times of channels that state an interval, s from the first start in the file, and what was assumed."""
    stated = {c.path: c for c in channels if 0 < _number(c, "wf_increment") < np.inf}
    starts = {path: _start(c) for path, c in stated.items()}
    known = [start for start in starts.values() if start is not None]
    first = min(known, default=np.datetime64(0, "us"))
    made: dict[tuple[float, ...], FloatArray] = {}  # one array for all channels of the same times
    out: dict[str, FloatArray] = {}
    for path, channel in stated.items():
        begin, step, n = starts[path], _number(channel, "wf_increment"), len(channel)
        late = 0.0 if begin is None else float((begin - first) / np.timedelta64(1, "us")) * 1e-6
        late += _number(channel, "wf_start_offset")
        if np.isfinite(late):
            times = np.asarray(late + step * np.arange(n), dtype=np.float64)
            out[path] = made.setdefault((late, step, n), times)
    unknown = [channel.name for path, channel in stated.items() if starts[path] is None]
    words = f"no start is stated for {', '.join(unknown[:8])}; the earliest of the others is taken for it"
    return out, words if known and unknown else ""


def _number(channel: Any, key: str) -> float:
    """Property of a channel as a number; 0 where there is none."""
    try:
        return float(channel.properties.get(key, 0.0))
    except (TypeError, ValueError):
        return 0.0


def _start(channel: Any) -> np.datetime64 | None:
    """Start of a waveform; None where none is stated."""
    begin = channel.properties.get("wf_start_time")
    begin = begin.as_datetime64("us") if hasattr(begin, "as_datetime64") else begin
    return begin.astype("datetime64[us]") if isinstance(begin, np.datetime64) and not np.isnat(begin) else None


FORMATS = (Format("tdms", (".tdms",), read_tdms, sheets=True),)
