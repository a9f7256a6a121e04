"""A file from the laboratory as named columns of numbers, whatever its format."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from shj_bayes._util.files import file_digest, need_files
from shj_bayes.errors import RecordingError, plain_text
from shj_bayes.recording.limits import MAX_BYTES, MAX_COLUMNS, MAX_NAME, MAX_ROWS, MAX_VALUE
from shj_bayes.recording.recording import Finding, FloatArray

FORMATS = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".asc"), "csv"),
    **{".xlsx": "xlsx", ".json": "json", ".mat": "mat", ".h5": "hdf5", ".hdf5": "hdf5", ".tdms": "tdms"},
}


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file."""

    name: str  # name in the file, without the unit where the unit could be told apart; ``"#3"`` without a header
    values: FloatArray  # shape (n_rows,): numbers; NaN where the cell was empty or held no number
    unit: str | None = None  # unit as written in the file
    header: str = ""  # header as written, name and unit together
    n_words: int = 0  # cells that hold text and no number


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds, before anything is chosen or converted."""

    name: str  # file name without folders
    format: str  # ``csv``, ``xlsx``, ``json``, ``mat``, ``hdf5`` or ``tdms``
    sha256: str  # digest of the file as it lies on the disk
    columns: tuple[Column, ...]  # in the order of the file
    has_header: bool = True  # whether the columns have names of their own
    # single numbers stored beside the columns (MAT variables, HDF5 and TDMS attributes)
    scalars: dict[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()  # what was met while reading

    @property
    def summary(self) -> str:
        """Columns and the first row of numbers in words, for error messages."""
        shown = [f"{i}: {c.header or c.name}" for i, c in enumerate(self.columns[:12], start=1)]
        more = f" and {len(self.columns) - 12} more" if len(self.columns) > 12 else ""
        extra = f"; single numbers: {', '.join(list(self.scalars)[:12])}" if self.scalars else ""
        firsts = [f"{c.values[0]:.6g}" for c in self.columns[:12] if c.values.size]
        return f"columns are {', '.join(shown)}{more}; the first row is {', '.join(firsts)}{extra}"


def read_table(path: str | Path) -> Table:
    """Read a file of any supported format into columns of numbers; the ending tells which it is.

    `RecordingError` if there is no such file, or it is empty, too large, or not what its ending says.
    """
    path = Path(path)
    kind = _kind(path)
    try:
        table = _parse(path, kind)
    except RecordingError:
        raise
    except MemoryError as error:
        raise RecordingError(f"{path.name}: not enough memory to read it; export fewer channels or rows") from error
    except Exception as error:
        # The parsers of seven formats raise dozens of kinds of errors for damaged files; all mean the same to the user.
        reason = (str(error).splitlines() or [""])[0].replace(str(path), path.name)
        raise RecordingError(
            f"{path.name}: cannot be read as {kind} ({type(error).__name__}: {reason[:160]}); "
            f"check that the file is complete and that its ending is right"
        ) from error
    return _checked(table)


def _kind(path: Path) -> str:
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
    kind = FORMATS.get(ending.lower())
    if kind is None or (path.suffix.lower() == ".gz" and kind != "csv"):
        raise RecordingError(
            f"{path.name}: ending {''.join(path.suffixes[-2:]) or '(none)'!r} is not supported; allowed are "
            f"{', '.join(FORMATS)}, and .gz after the text formats; export it as one of these"
        )
    return kind


def _reason(error: OSError | ValueError) -> str:
    """Say what the system says."""
    return (getattr(error, "strerror", None) or str(error)).lower()


def _parse(path: Path, kind: str) -> Table:
    """Hand over to the reader of the format; each imports its library only when it is needed."""
    if kind == "csv":
        from shj_bayes.recording.text import read_text as reader  # noqa: PLC0415
    elif kind == "xlsx":
        from shj_bayes.recording.excel import read_excel as reader  # noqa: PLC0415
    elif kind == "json":
        from shj_bayes.recording.records import read_records as reader  # noqa: PLC0415
    elif kind == "tdms":
        from shj_bayes.recording.tdms import read_tdms as reader  # noqa: PLC0415
    else:
        from shj_bayes.recording.binary import read_binary as reader  # noqa: PLC0415
    return reader(path, file_digest(path))


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


def bounded_columns(names: list[str], name: str) -> list[str]:
    """Refuse more columns than any recording has, before their cells are laid out."""
    if len(names) > MAX_COLUMNS:
        raise RecordingError(f"{name}: {len(names)} columns; allowed are {MAX_COLUMNS}; export fewer")
    return names


def refuse_large(total: int, name: str) -> None:
    """Refuse before reading what would not fit; `total` in bytes."""
    if total > MAX_BYTES:
        raise RecordingError(
            f"{name} holds {total / 1024**2:.0f} MiB of numbers; "
            f"allowed are {MAX_BYTES // 1024**2} MiB; export fewer channels"
        )


def left_out(names: list[str]) -> tuple[Finding, ...]:
    """Say which parts of a file hold no columns of numbers."""
    message = f"left out, not columns of numbers: {', '.join(names[:8])}"
    return (Finding("not-numbers", "note", message, len(names)),) if names else ()


def as_floats(values: object) -> FloatArray:
    """Copy to float64; infinities and absurd sizes become NaN, since no sensor measures them and sums overflow."""
    array = np.array(values, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        array[~(np.abs(array) <= MAX_VALUE)] = np.nan
    return array
