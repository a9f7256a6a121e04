"""From a file to a Recording: table, columns, units, checks and repairs, in that order."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shj_bayes._util.files import file_digest, need_files
from shj_bayes._util.imports import discovered
from shj_bayes.errors import RecordingError, plain_text
from shj_bayes.recording import formats
from shj_bayes.recording.checks import inspect, plausibility_findings, repair, with_exchange
from shj_bayes.recording.clock import one_clock
from shj_bayes.recording.columns import choose
from shj_bayes.recording.limits import MAX_BYTES, MAX_COLUMNS, MAX_NAME, MAX_ROWS
from shj_bayes.recording.recording import Column, Recording, Source
from shj_bayes.recording.rows import split_header
from shj_bayes.recording.smoothing import at_samples
from shj_bayes.recording.tables import Format, Table, as_floats

if TYPE_CHECKING:
    import pandas as pd


@cache
def by_ending() -> dict[str, Format]:
    """Format of every ending, those of text first."""
    found = discovered(formats, "FORMATS")
    return {ending: one for one in sorted(found, key=lambda f: (not f.gzipped, f.id)) for ending in one.endings}


def read_table(path: str | Path, sheet: str | None = None) -> Table:
    """Read a file of any supported format into columns of numbers; the ending tells which it is.

    `sheet` names the sheet of a workbook, or a group of a file that has groups. `RecordingError` if there is no
    such file, or it is empty, too large, or not what its ending says.
    """
    path = Path(path)
    own = _format(path)
    if sheet is not None and not own.sheets:
        raise RecordingError(f"{path.name}: a {own.id} file has no sheets or groups; leave --sheet out")
    try:
        table = own.read(path, sheet) if own.sheets else own.read(path)
        return _checked(replace(table, format=own.id, sha256=file_digest(path)))
    except RecordingError:
        raise
    except MemoryError as error:
        raise RecordingError(f"{path.name}: not enough memory to read it; export fewer channels or rows") from error
    except Exception as error:
        # The parsers of the formats raise dozens of kinds of errors for damaged files; all mean the same to the user.
        reason = (str(error).splitlines() or [""])[0].replace(str(path), path.name)
        raise RecordingError(
            f"{path.name}: cannot be read as {own.id} ({type(error).__name__}: {reason[:160]}); "
            f"check that the file is complete and that its ending is right"
        ) from error


def _format(path: Path) -> Format:
    """Format by the ending, after the checks that need no reading."""
    try:
        path.stat()
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as error:  # a ring of links, a folder that may not be entered, a NUL in the name
        raise RecordingError(f"{path.name}: {_reason(error)}; check the name and the folder") from error
    if path.is_dir():
        raise RecordingError(f"{path.name or path} is a folder; name one recording in it")
    need_files([path], RecordingError)
    if not path.is_file():
        raise RecordingError(f"{path.name} is not an ordinary file; a recording must be a file on the disk")
    try:
        size = path.stat().st_size
        path.open("rb").close()
    except OSError as error:
        raise RecordingError(f"{path.name} cannot be opened: {_reason(error)}; check the rights") from error
    if size == 0:
        raise RecordingError(f"{path.name} is empty (0 bytes); export it again")
    if size > MAX_BYTES:
        raise RecordingError(
            f"{path.name} has {size / 1024**2:.0f} MiB; allowed are {MAX_BYTES // 1024**2} MiB; export fewer channels"
        )
    ending = Path(path.stem).suffix if path.suffix.lower() == ".gz" else path.suffix
    known = by_ending()
    own = known.get(ending.lower())
    if own is None or (path.suffix.lower() == ".gz" and not own.gzipped):
        raise RecordingError(
            f"{path.name}: ending {''.join(path.suffixes[-2:]) or '(none)'!r} is not supported; allowed are "
            f"{', '.join(known)}, and .gz after the text formats; export it as one of these"
        )
    return own


def _reason(error: OSError | ValueError) -> str:
    """Say what the system says."""
    return (getattr(error, "strerror", None) or str(error)).lower()


def _checked(table: Table) -> Table:
    """Refuse tables without numbers or beyond the bounds."""
    n_rows = max((c.values.size for c in table.columns), default=0)
    if n_rows < 2:
        raise RecordingError(f"{table.name}: no column of numbers found; it must hold at least 2 rows of numbers")
    if n_rows > MAX_ROWS or len(table.columns) > MAX_COLUMNS:
        raise RecordingError(
            f"{table.name}: {n_rows} rows and {len(table.columns)} columns; allowed are {MAX_ROWS} rows and "
            f"{MAX_COLUMNS} columns; export fewer"
        )
    columns = []
    for column in table.columns:  # with names and units that are short and can be shown
        column.values.setflags(write=False)
        name, header = plain_text(column.name[:MAX_NAME]), plain_text(column.header[:MAX_NAME])
        unit = None if column.unit is None else plain_text(column.unit)
        columns.append(replace(column, name=name, header=header, unit=unit))
    return replace(table, columns=tuple(columns))


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


def recording_of(table: Table, columns: str | None, units: str | None, rate_Hz: float | None) -> Recording:
    """Make a recording of a table and check it; arguments as for `read`."""
    channels = choose(table, columns, units, rate_Hz)
    clock_s, begins, told = one_clock(channels.time_s, channels.displacement_mm, channels.force_kN, channels.run_rows)
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
        run_starts={at: shift for at, shift in samples.items() if 0 < at < time_s.size},
        extras=tuple(replace(e, values=at_samples(clock_s, e.values, time_s)) for e in channels.extras),
    )
    return recording.with_findings(*inspect(recording))


def read_frame(
    frame: pd.DataFrame,
    name: str = "data frame",
    *,
    columns: str | None = None,
    units: str | None = None,
    rate_Hz: float | None = None,
) -> Recording:
    """Read a recording out of a data frame and check it; columns that hold no numbers are not used.

    `columns`, `units`, `rate_Hz` and errors are those of `shj_bayes.recording.reader.read`.
    """
    found = []
    for label, series in frame.items():
        try:
            values = as_floats(np.asarray(series.to_numpy(dtype=np.float64, na_value=np.nan)))
        except (TypeError, ValueError):
            continue
        title, unit = split_header(str(label))
        found.append(Column(title, values, unit, str(label)))
    if not found:
        raise RecordingError(f"{name}: no column holds numbers; give time, displacement and force as columns")
    return recording_of(Table(name, tuple(found)), columns, units, rate_Hz)
