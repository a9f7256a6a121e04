"""From a file to a Recording: table, columns, units, checks and repairs, in that order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from shj_bayes.recording.columns import choose
from shj_bayes.recording.plausible import plausibility_findings
from shj_bayes.recording.quality import inspect, repair
from shj_bayes.recording.recording import Recording, Source
from shj_bayes.recording.tables import read_table


def read(
    path: str | Path,
    *,
    columns: str | None = None,
    units: str | None = None,
    rate_Hz: float | None = None,
) -> Recording:
    """Read one recording and check it.

    Parameters
    ----------
    path : str or Path
        CSV, TSV, TXT (also .gz), XLSX, MAT, HDF5 or TDMS.
    columns : str or None
        ``time=...,displacement=...,force=...``; each a column name, a 1-based number, or a formula. Roles that are
        not named are looked for in the header. ``time`` may be a single number: the sampling interval.
    units : str or None
        ``mm,kN,s`` in any order, or ``time=ms,...``; needed where the header does not say.
    rate_Hz : float or None
        Constant sampling rate of a file without time, Hz.

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
    table = read_table(path)
    channels = choose(table, columns, units, rate_Hz)
    time_s, displacement_mm, force_kN, used, findings = repair(
        channels.time_s, channels.displacement_mm, channels.force_kN, table.name
    )
    known = {finding.code for finding in findings}
    unlikely = plausibility_findings(channels, time_s, displacement_mm, force_kN)
    findings += tuple(finding for finding in unlikely if finding.code not in known)
    recording = Recording(
        time_s=time_s,
        displacement_mm=displacement_mm,
        force_kN=force_kN,
        used=used,
        source=Source(table.name, table.sha256, table.format, channels.columns, channels.units),
        findings=(*table.findings, *channels.findings, *findings),
    )
    return replace(recording, findings=(*recording.findings, *inspect(recording)))
