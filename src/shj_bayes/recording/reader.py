"""From a file to a Recording: table, columns, units, checks and repairs, in that order."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from shj_bayes.recording.clock import follow_on, going_on, restarts
from shj_bayes.recording.columns import RawChannels, choose, choose_history
from shj_bayes.recording.formats.catalogue import read_table
from shj_bayes.recording.further import at_samples
from shj_bayes.recording.plausible import plausibility_findings, with_exchange
from shj_bayes.recording.quality import inspect, repair
from shj_bayes.recording.recording import Extra, Finding, FloatArray, Recording, RunStart, Source
from shj_bayes.recording.tables import Table

_HOLLOW = {"text-cells", "empty-cells", "jumps"}  # findings of channels of which too much is missing or wrong


def read(
    path: str | Path,
    *,
    columns: str | None = None,
    units: str | None = None,
    rate_Hz: float | None = None,
    sheet: str | None = None,
) -> Recording:
    """Read one recording and check it.

    Parameters
    ----------
    path : str or Path
        A file of a supported format, by its ending (``docs/recordings.md``).
    columns : str or None
        ``time=...,displacement=...,force=...``; each a column name, a 1-based number, or a formula. Roles that are
        not named are looked for in the header. ``time`` may be a single number: the sampling interval. Further
        channels have names of your own, such as ``tension=...,temperature=...``.
    units : str or None
        ``mm,kN,s`` in any order, or ``time=ms,...``; needed where the header does not say.
    rate_Hz : float or None
        Constant sampling rate of a file without time, Hz.
    sheet : str or None
        Sheet of a workbook, or group of a file that has groups (TDMS, HDF5, MAT), that holds the recording.

    Returns
    -------
    Recording
        In s, mm and kN, with everything that was found, assumed and repaired. A recording that can be read but
        must not be fitted carries a finding with severity ``"unusable"``.

    Raises
    ------
    RecordingError
        If the file cannot be read, or a channel is missing, ambiguous or not convertible.
    """
    return recording_of(read_table(path, sheet), columns, units, rate_Hz)


def read_history(path: Path) -> tuple[FloatArray, FloatArray, tuple[Finding, ...]]:
    """Read a displacement history that nobody has run yet: times (s), displacement (mm), and what was found.

    The same readers and bounds as for a recording; errors as for `read`.
    """
    return choose_history(read_table(path))


def recording_of(table: Table, columns: str | None, units: str | None, rate_Hz: float | None) -> Recording:
    """Make a recording of a table and check it; arguments as for `read`."""
    channels = choose(table, columns, units, rate_Hz)
    clock_s, begins, told = _placed_runs(channels)
    time_s, displacement_mm, force_kN, used, findings = repair(
        clock_s, channels.displacement_mm, channels.force_kN, table.name
    )
    if any(finding.code in _HOLLOW and finding.severity == "unusable" for finding in (*channels.findings, *findings)):
        # What is left of a channel has another size and shape: it says nothing of units, signs and order.
        findings = tuple(finding for finding in findings if finding.code != "swapped-columns")
    else:
        known = {finding.code for finding in findings}
        unlikely = plausibility_findings(channels, time_s, displacement_mm, force_kN)
        findings += tuple(finding for finding in unlikely if finding.code not in known)
    findings = tuple(with_exchange(finding, channels) for finding in findings)
    samples = {int(np.searchsorted(time_s, first)): shift for first, shift in begins}
    recording = Recording(
        time_s=time_s,
        displacement_mm=displacement_mm,
        force_kN=force_kN,
        used=used,
        source=Source(table.name, table.sha256, table.format, channels.columns, channels.units),
        findings=(*table.findings, *channels.findings, *told, *findings),
        run_starts=tuple(RunStart(at, shift) for at, shift in samples.items() if 0 < at < time_s.size),
        extras=tuple(_at_samples(extra, clock_s, time_s) for extra in channels.extras),
    )
    return recording.with_findings(*inspect(recording))


def _at_samples(extra: Extra, clock_s: FloatArray, time_s: FloatArray) -> Extra:
    """Further channel at the samples that were kept, of which some may have been filled in."""
    known = np.flatnonzero(np.isfinite(clock_s) & np.isfinite(extra.values))
    order = known[np.argsort(clock_s[known], kind="stable")]
    return replace(extra, values=at_samples(clock_s[order], extra.values[order], time_s))


def _within_runs(channels: RawChannels) -> tuple[FloatArray, list[int]]:
    """Let the clock go on over the cycles of each run, but not over the beginning of a run that the file tells."""
    time_s, found = channels.time_s.copy(), list[int]()
    for a, b in pairwise([0, *channels.run_rows, time_s.size]):
        time_s[a:b], cycles = going_on(time_s[a:b], channels.displacement_mm[a:b], channels.force_kN[a:b])
        found += [a + row for row in cycles]
    return time_s, found


def _placed_runs(channels: RawChannels) -> tuple[FloatArray, list[tuple[float, float]], list[Finding]]:
    """Put all rows on one clock; give the first time of each further run, what was added to it, and what to say."""
    time_s, cycles = _within_runs(channels)
    again = restarts(time_s, channels.displacement_mm, channels.force_kN)
    rows = sorted({*again, *channels.run_rows})
    clock_s, shifts = follow_on(time_s, rows)
    timed = np.flatnonzero(np.isfinite(clock_s))
    firsts = [float(clock_s[timed[np.searchsorted(timed, row)]]) for row in rows]
    begins = list(zip(firsts, shifts, strict=True))
    said: list[Finding] = []
    if cycles:
        message = (
            f"time begins again {len(cycles)} times, first at row {cycles[0] + 1}, while the device moves on: read as "
            "one run, with the usual step between"
        )
        said.append(Finding("time-cycles", "assumed", message, len(cycles)))
    if not again:
        return clock_s, begins, said
    where = f"at row {again[0] + 1}" if len(again) == 1 else f"{len(again)} times, first at row {again[0] + 1}"
    message = f"time begins again {where}: {len(rows) + 1} runs, put one behind the other"
    return clock_s, begins, [*said, Finding("time-restarts", "assumed", message, len(again))]
