"""A file from the laboratory as named columns of numbers, whatever its format."""

from dataclasses import dataclass, field

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.limits import MAX_BYTES, MAX_COLUMNS, MAX_VALUE
from shj_bayes.recording.recording import Finding, FloatArray


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a file."""

    name: str  # name in the file, without the unit where the unit could be told apart; ``"#3"`` without a header
    values: FloatArray  # shape (n_rows,): numbers; NaN where the cell was empty or held no number
    unit: str | None = None  # unit as written in the file
    header: str = ""  # header as written, name and unit together
    n_words: int = 0  # cells that hold text and no number
    group: str = ""  # group, struct or the like of the file that holds it
    clock_s: FloatArray | None = None  # times of its values where it has its own, shape (n_rows,), s
    clock_told: bool = True  # whether the file says that these are seconds


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds, before anything is chosen or converted."""

    name: str  # file name without folders
    format: str  # id of the format: ``csv``, ``xlsx``, ``mat`` ...
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
