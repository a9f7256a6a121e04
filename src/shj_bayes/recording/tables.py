"""A file from the laboratory as named columns of numbers, whatever its format; its groups; formulas over columns."""

import ast
import operator
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import RecordingError, did_you_mean
from shj_bayes.recording import limits
from shj_bayes.recording.recording import Column, Finding
from shj_bayes.recording.units import multiplier


@dataclass(frozen=True, eq=False)
class Table:
    """What a file holds, before anything is chosen or converted."""

    name: str  # file name without folders
    columns: tuple[Column, ...]  # in the order of the file
    has_header: bool = True  # whether the columns have names of their own
    # single numbers stored beside the columns (MAT variables, HDF5 and TDMS attributes)
    scalars: dict[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()  # what was met while reading
    # format, sha256: filled in by the reader: id of the format, ``csv``, ``xlsx`` ..., and digest of the file
    format: str = "dataframe"
    sha256: str = ""

    @property
    def summary(self) -> str:
        """Columns and the first row of numbers in words, for error messages."""
        shown = [f"{i}: {c.label}" for i, c in enumerate(self.columns[:12], start=1)]
        more = f" and {len(self.columns) - 12} more" if len(self.columns) > 12 else ""
        extra = f"; single numbers: {', '.join(list(self.scalars)[:12])}" if self.scalars else ""
        firsts = [f"{c.values[0]:.6g}" for c in self.columns[:12] if c.values.size]
        return f"columns are {', '.join(shown)}{more}; the first row is {', '.join(firsts)}{extra}"


def bounded_columns(names: list[str], name: str) -> list[str]:
    """Refuse more columns than any recording has, before their cells are laid out."""
    if len(names) > limits.MAX_COLUMNS:
        raise RecordingError(f"{name}: {len(names)} columns; allowed are {limits.MAX_COLUMNS}; export fewer")
    return names


def refuse_large(total: int, name: str) -> None:
    """Refuse before reading what would not fit; `total` in bytes."""
    if total > limits.MAX_BYTES:
        raise RecordingError(
            f"{name} holds {total / 1024**2:.0f} MiB of numbers; "
            f"allowed are {limits.MAX_BYTES // 1024**2} MiB; export fewer channels"
        )


def left_out(names: list[str]) -> tuple[Finding, ...]:
    """Say which parts of a file hold no columns of numbers."""
    message = f"left out, not columns of numbers: {', '.join(names[:8])}"
    return (Finding("not-numbers", "note", message, len(names)),) if names else ()


def as_floats(values: object) -> FloatArray:
    """Copy to float64; infinities and absurd sizes become NaN, since no sensor measures them and sums overflow."""
    array = np.array(values, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        array[~(np.abs(array) <= limits.MAX_VALUE)] = np.nan
    return array


class Format(NamedTuple):
    """A file format."""

    id: str  # word in files and messages
    endings: tuple[str, ...]  # of file names, in lower case with the dot
    # ``read(path)`` gives the table; it imports its library itself. With sheets, ``read(path, sheet)``
    read: Callable[..., Table]
    gzipped: bool = False  # whether it may be compressed, with ``.gz`` behind the ending
    sheets: bool = False  # whether a file may hold several tables, of which ``--sheet`` names one


_OPERAND = re.compile(
    r"""(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?) | \#(?P<index>\d+)
    | "(?P<double>[^"]+)" | '(?P<single>[^']+)' | (?P<name>[^\W\d][\w.\[\]]*)""",
    re.VERBOSE,
)
_MAX_LENGTH = 400
_SIGNS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv}
_HELP = (
    "allowed are column names, numbers of columns as #3, constants, brackets, + - * and / by a constant, as in "
    "#7 - 49.087*#6"
)


def evaluate(text: str, table: Table) -> Column:
    """Value of a column name, a 1-based column number, or a formula of them and of single numbers.

    Python's parser reads ``#7 - 49.087*#6`` once names and numbers stand aside; of its tree nothing but + - * and / is
    gone through, and nothing is ever evaluated as code.

    `RecordingError` for unknown names, a product of two columns, or anything that is no formula.
    """
    text = text.strip()
    if len(text) > _MAX_LENGTH:  # before int(), which refuses thousands of digits in words of its own
        raise RecordingError(f"--columns: a formula of {len(text)} characters; allowed are {_MAX_LENGTH}")
    if re.fullmatch(r"#?\d+", text):
        return _numbered(int(text.lstrip("#")), table)
    exact = _named(text.strip("\"'"), table)
    if exact is not None:
        return exact
    operands: list[Column] = []

    def aside(match: re.Match[str]) -> str:
        kind, word = match.lastgroup, str(match[match.lastgroup or 0])
        if kind == "number":
            found: Column | None = Column(word, np.asarray(float(word)))
        else:
            found = _numbered(int(word), table) if kind == "index" else _named(word, table)
        if found is None:
            names = [column.name for column in table.columns]
            hint = did_you_mean(text, names) or did_you_mean(word, names)
            raise RecordingError(
                f"{table.name} has no column named {word!r}{hint}; {table.summary}; quote names with blanks, or use #3"
            )
        operands.append(found)
        return f" {len(operands) - 1} "

    bare = _OPERAND.sub(aside, text)
    try:
        tree = ast.parse(f"({bare})", mode="eval").body if re.fullmatch(r"[\d\s()*/+-]+", bare) else None
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        tree = None
    if tree is None:
        raise RecordingError(f"--columns: cannot read {text!r}; {_HELP}")
    return _value(tree, operands, text)


def _numbered(index: int, table: Table) -> Column:
    """Column by its 1-based number."""
    if not 1 <= index <= len(table.columns):
        raise RecordingError(
            f"{table.name} has no column {index}; allowed are 1 to {len(table.columns)}: {table.summary}"
        )
    return table.columns[index - 1]


def _named(name: str, table: Table) -> Column | None:
    """Column or single number by its name as written, else by its name without the unit or the case."""
    headers, names, lower = [c.header for c in table.columns], [c.name for c in table.columns], name.lower()
    for wanted, keys in (
        (name, headers),
        (name, names),
        (lower, [header.lower() for header in headers]),
        (lower, [own.lower() for own in names]),
        (lower.replace("/", "."), [header.lower().replace("/", ".") for header in headers]),  # struct or group
    ):
        found = [column for column, key in zip(table.columns, keys, strict=True) if key == wanted]
        if len(found) > 1:
            raise RecordingError(
                f"{table.name} has {len(found)} columns named {name!r}; choose one by its number: {table.summary}"
            )
        if found:
            return found[0]
    return Column(name, np.asarray(table.scalars[name])) if name in table.scalars else None


def _value(node: ast.expr, operands: list[Column], text: str) -> Column:
    """Value of a part of a formula, whose numbers are places in the list of operands; it has no unit."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int):
        operand = operands[node.value]
        return Column("", operand.values, parts=operand.made_of)
    if isinstance(node, ast.UnaryOp):
        inner = _value(node.operand, operands, text)
        return inner if isinstance(node.op, ast.UAdd) else replace(inner, values=np.asarray(-inner.values))
    if not isinstance(node, ast.BinOp) or type(node.op) not in _SIGNS:
        raise RecordingError(f"--columns: cannot read {text!r}; {_HELP}")
    left, right = (_value(side, operands, text) for side in (node.left, node.right))
    both = left.values.ndim and right.values.ndim
    if isinstance(node.op, ast.Add | ast.Sub):
        if both and left.values.size != right.values.size:
            raise RecordingError(
                f"--columns: {text!r} adds columns of {left.values.size} and {right.values.size} rows; they must be "
                "equal"
            )
    elif both or (isinstance(node.op, ast.Div) and right.values.ndim):
        raise RecordingError(
            f"--columns: {text!r} multiplies or divides two columns; only one factor may be a column; {_HELP}"
        )
    elif isinstance(node.op, ast.Div) and float(right.values) == 0.0:
        raise RecordingError(f"--columns: {text!r} divides by zero")
    values = np.asarray(_SIGNS[type(node.op)](left.values, right.values), dtype=np.float64)
    return Column("", values, parts=left.made_of + right.made_of)


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
        known = list(dict.fromkeys(column.group for column in columns if column.group))
        columns = [c for c in columns if f"{c.group}{mark}".lower().startswith(f"{sheet.strip()}{mark}".lower())]
        if not columns:
            what = f"its groups are {listed(known)}{did_you_mean(sheet, known)}" if known else "the file has no groups"
            raise RecordingError(f"{name}: --sheet {sheet!r} is no group of it; {what}")
    clocked = _clocked(columns, mark)
    runs = _runs(clocked)
    if not runs:
        return _titled(clocked, mark), ()
    names = list(runs)
    rest = [c for c in clocked if c.group not in runs]
    joined = [_joined(list(parts)) for parts in zip(*runs.values(), strict=True)]
    number = np.repeat(np.arange(1.0, len(runs) + 1), [own[-1].values.size for own in runs.values()])
    run = Column("Run", number, None, "Run", clock_s=joined[-1].clock_s)
    words = (
        f"groups {listed(names)} hold the same channels: they are taken for runs of one device, in this order; "
        f"--sheet {names[0]!r} takes one alone"
    )
    return (*joined, run, *_titled(rest, mark)), (Finding("groups", "assumed", words, len(runs)),)


def _clocked(columns: Sequence[Column], mark: str) -> list[Column]:
    """Columns with the times of their group, or of one that holds it, where a file has times in several places."""
    times = [column for column in columns if _is_time(column)]
    if len(times) < 2 and not any(column.clock_s is not None for column in columns):
        return list(columns)
    groups = [column.group for column in times]
    by_group = {c.group: (seconds_of(c), bool(c.unit)) for c in times if groups.count(c.group) == 1}
    out = []
    for column in columns:
        group = column.group
        while group and group not in by_group:
            group = group.rpartition(mark)[0]
        clock, told = by_group.get(group, (None, True))
        fits = column.clock_s is None and clock is not None and clock.size == column.values.size
        out.append(replace(column, clock_s=clock, clock_told=told) if fits else column)
    return out


def seconds_of(column: Column) -> FloatArray | None:
    """Give the times of a column in s; None where its unit is none of time."""
    scale = multiplier(column.unit or "s", "time")
    return None if scale is None else column.values if scale == 1.0 else column.values * scale


def _is_time(column: Column) -> bool:
    return re.sub(r"[\s_]+", " ", column.name.strip().lower()) in _TIME


def _runs(columns: Sequence[Column]) -> dict[str, list[Column]]:
    """Find the groups that are runs, in order; none where no two groups hold the same channels."""
    groups: dict[str, list[Column]] = {}
    for column in columns:
        groups.setdefault(column.group, []).append(column)
    families: dict[tuple[tuple[str, str], ...], list[str]] = {}
    for group, own in groups.items():
        if group and len({c.name for c in own if not _is_time(c)}) >= 2:
            families.setdefault(tuple(sorted((c.name, c.unit or "") for c in own)), []).append(group)
    largest = max(families.values(), key=len, default=[])
    skeletons = {re.sub(r"\d+", "#", group) for group in largest}
    lengths = [len(column.values) for group in largest for column in groups[group]]
    if len(largest) < 2 or len(skeletons) > 1 or _NOT_RUNS.search(largest[0]) or min(lengths) < limits.MIN_SAMPLES:
        return {}
    largest.sort(key=lambda group: [int(digits) for digits in re.findall(r"\d+", group)])
    first = [column.name for column in groups[largest[0]]]
    return {group: sorted(groups[group], key=lambda c: first.index(c.name)) for group in largest}


def _joined(parts: list[Column]) -> Column:
    """Columns of the runs, one behind the other; times of their own follow those of the run before."""
    own = [part.clock_s for part in parts if part.clock_s is not None and part.clock_s.size > 1]
    clocks: list[FloatArray] = []
    for clock in own if len(own) == len(parts) else ():
        late = bool(clocks) and not clock[0] > clocks[-1][-1]
        after = clocks[-1][-1] - clock[0] + limits.RESTART_GAP_STEPS * usual_step(clock) if late else 0.0
        clocks.append(clock + after)
    values = np.concatenate([part.values for part in parts])
    header = parts[0].name if parts[0].unit is None else f"{parts[0].name} ({parts[0].unit})"
    return replace(parts[0], values=values, header=header, group="", clock_s=np.concatenate(clocks) if clocks else None)


def _titled(columns: Sequence[Column], mark: str) -> tuple[Column, ...]:
    """Columns by their own names, with the group before it where a name comes twice."""
    names, titled = [column.name for column in columns], list[Column]()
    for column in columns:
        path = f"{column.group}{mark}" if column.group and names.count(column.name) > 1 else ""
        header = column.header if column.header.startswith(path) else f"{path}{column.header}"
        titled.append(replace(column, name=f"{path}{column.name}", header=header))
    return tuple(titled)


def listed(names: Sequence[str]) -> str:
    """Say the first of some names, and how many more there are."""
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
    clocks = [(column.label, column.clock_s) for column in columns]
    if not clocks or any(clock is None for _, clock in clocks):
        return None
    first, clock = clocks[0]
    for other, its in clocks[1:]:
        if not same_clock(clock, its):
            raise RecordingError(f"--columns: {first!r} and {other!r} have different times; no formula can hold both")
    return clock


def same_clock(left: FloatArray | None, right: FloatArray | None) -> bool:
    """Whether two channels were read at the same instants."""
    if left is None or right is None or left is right:
        return left is right
    if left.size != right.size:
        return False
    near = limits.SAME_INSTANT * float(np.nan_to_num(abs(usual_step(left))))
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
    near = limits.SAME_INSTANT * min(x_step, f_step)
    axis = f_s[(f_s >= x_s[0] - near) & (f_s <= x_s[-1] + near)]
    if f_step < 0.99 * x_step and axis.size > 1:
        before, behind = beside(axis, x_s).T
        nearest = np.where(x_s - axis[before] < axis[behind] - x_s, before, behind)
        axis = axis[np.unique(nearest[np.abs(axis[nearest] - x_s) <= 0.5 * f_step + near])]
    left, right = beside(x_s, axis).T
    whole = (x_s[right] - x_s[left] <= limits.GAP_STEPS * x_step) | (np.abs(axis - x_s[left]) <= near)
    axis = np.asarray(axis[whole | (np.abs(x_s[right] - axis) <= near)], dtype=np.float64)
    if axis.size < limits.MIN_SAMPLES:
        raise RecordingError(
            f"{name}: displacement has {described(x_s)}, force {described(f_s)}: {axis.size} readings are of the same "
            f"time, needed are {limits.MIN_SAMPLES}; export both with one time"
        )
    return axis


def beside(times: FloatArray, at: FloatArray) -> np.ndarray[tuple[int, int], np.dtype[np.int64]]:
    """Places of the times before and behind each instant, shape (n, 2)."""
    right = np.clip(np.searchsorted(times, at), 1, times.size - 1)
    return np.column_stack([right - 1, right])
