"""All file formats: every module of this package that holds ``FORMATS``; the ending of a file tells which reads it."""

from dataclasses import replace
from functools import cache
from pathlib import Path

from shj_bayes._util.files import file_digest, need_files
from shj_bayes._util.imports import constants
from shj_bayes.errors import RecordingError, plain_text
from shj_bayes.recording import formats
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.limits import MAX_BYTES, MAX_COLUMNS, MAX_NAME, MAX_ROWS
from shj_bayes.recording.tables import Column, Table


@cache
def by_ending() -> dict[str, Format]:
    """Format of every ending, those of text first."""
    found = (one for _, own in constants(formats, "FORMATS") for one in own)
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
        table = own.read(path, file_digest(path), *([sheet] if own.sheets else []))
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
    return _checked(table)


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
    for column in table.columns:
        column.values.setflags(write=False)
    return replace(table, columns=tuple(map(_plain, table.columns)))


def _plain(column: Column) -> Column:
    """Column whose name and unit are short and can be shown."""
    name, header = plain_text(column.name[:MAX_NAME]), plain_text(column.header[:MAX_NAME])
    return replace(column, name=name, header=header, unit=None if column.unit is None else plain_text(column.unit))
