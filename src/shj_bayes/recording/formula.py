"""Small formulas over columns: ``#7 - 49.087*#6``, ``gtau*vir``. Parsed by hand; nothing is ever evaluated as code."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from shj_bayes._util.did_you_mean import did_you_mean
from shj_bayes.errors import RecordingError
from shj_bayes.recording.recording import FloatArray
from shj_bayes.recording.tables import Column, Table

_TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)
    | \#(?P<index>\d+)
    | "(?P<double>[^"]+)" | '(?P<single>[^']+)'
    | (?P<name>[^\W\d][\w.\[\]]*)
    | (?P<sign>[-+*/])
    )""",
    re.VERBOSE,
)
_MAX_LENGTH = 400
_HELP = "allowed are column names, numbers of columns as #3, constants, + - * and / by a constant, as in #7 - 49.087*#6"


@dataclass(frozen=True, eq=False)
class Value:
    """A formula's value: a column, or a single number when ``values`` has no dimension.

    Parameters
    ----------
    values : array
        Numbers, shape (n_rows,) or ().
    columns : tuple of Column
        Columns it was made of; a plain column is one column unchanged.
    plain : bool
        Whether it is one column as it stands, so that the header's unit holds for it.
    """

    values: FloatArray
    columns: tuple[Column, ...] = ()
    plain: bool = False


def evaluate(text: str, table: Table) -> Value:
    """Value of a column name, a 1-based column number, or a formula of columns and single numbers.

    Parameters
    ----------
    text : str
        What stood behind the equals sign of ``--columns``.
    table : Table
        Where names and numbers are looked up.

    Raises
    ------
    RecordingError
        For unknown names, a product of two columns, or anything that is no formula.
    """
    text = text.strip()
    if len(text) > _MAX_LENGTH:  # before int(), which refuses thousands of digits in words of its own
        raise RecordingError(f"--columns: a formula of {len(text)} characters; allowed are {_MAX_LENGTH}")
    if re.fullmatch(r"#?\d+", text):
        return _column(_numbered(int(text.lstrip("#")), table))
    exact = _named(text.strip("\"'"), table)
    if exact is not None:
        return exact
    return _sum(_tokens(text), text, table)


def _column(column: Column) -> Value:
    return Value(column.values, (column,), plain=True)


def _numbered(index: int, table: Table) -> Column:
    """Column by its 1-based number."""
    if not 1 <= index <= len(table.columns):
        raise RecordingError(
            f"{table.name} has no column {index}; allowed are 1 to {len(table.columns)}: {table.summary}"
        )
    return table.columns[index - 1]


def _named(name: str, table: Table) -> Value | None:
    """Column or single number by its name as written, else by its name without the unit or the case."""
    lower = name.lower()
    for wanted, keys in (
        (name, [c.header for c in table.columns]),
        (name, [c.name for c in table.columns]),
        (lower, [c.header.lower() for c in table.columns]),
        (lower, [c.name.lower() for c in table.columns]),
    ):
        found = [column for column, key in zip(table.columns, keys, strict=True) if key == wanted]
        if len(found) == 1:
            return _column(found[0])
        if len(found) > 1:
            raise RecordingError(
                f"{table.name} has {len(found)} columns named {name!r}; choose one by its number: {table.summary}"
            )
    if name in table.scalars:
        return Value(np.asarray(table.scalars[name]))
    return None


def _tokens(text: str) -> list[tuple[str, str]]:
    """Split a formula into (kind, text)."""
    tokens: list[tuple[str, str]] = []
    position = 0
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None or match.end() == position:
            if text[position:].strip() == "":
                break
            raise RecordingError(f"--columns: cannot read {text!r} from {text[position:].strip()[:12]!r} on; {_HELP}")
        kind = str(match.lastgroup)
        tokens.append(("name" if kind in {"double", "single"} else kind, match[kind]))
        position = match.end()
    return tokens


def _sum(tokens: list[tuple[str, str]], text: str, table: Table) -> Value:
    """Terms joined by plus and minus."""
    total: FloatArray = np.asarray(0.0)
    columns: tuple[Column, ...] = ()
    position = 0
    while position < len(tokens) or position == 0:
        sign = 1.0
        while position < len(tokens) and tokens[position][1] in {"+", "-"} and tokens[position][0] == "sign":
            sign = -sign if tokens[position][1] == "-" else sign
            position += 1
        term, position = _product(tokens, position, text, table)
        total = _combined(total, sign * term.values, text)
        columns += term.columns
        if position < len(tokens) and tokens[position][1] not in {"+", "-"}:
            raise RecordingError(f"--columns: expected + or - before {tokens[position][1]!r} in {text!r}; {_HELP}")
    return Value(total, columns)


def _product(tokens: list[tuple[str, str]], position: int, text: str, table: Table) -> tuple[Value, int]:
    """Factors joined by times and divide; at most one of them is a column, and nothing is divided by a column."""
    value, position = _factor(tokens, position, text, table)
    while position < len(tokens) and tokens[position] in {("sign", "*"), ("sign", "/")}:
        operator = tokens[position][1]
        other, position = _factor(tokens, position + 1, text, table)
        if other.values.ndim and (value.values.ndim or operator == "/"):
            raise RecordingError(
                f"--columns: {text!r} multiplies or divides two columns; only one factor may be a column; {_HELP}"
            )
        if operator == "/" and float(other.values) == 0.0:
            raise RecordingError(f"--columns: {text!r} divides by zero")
        product = value.values * other.values if operator == "*" else value.values / other.values
        value = Value(product, value.columns + other.columns)
    return value, position


def _factor(tokens: list[tuple[str, str]], position: int, text: str, table: Table) -> tuple[Value, int]:
    """One number, column or named single number."""
    if position >= len(tokens):
        raise RecordingError(f"--columns: {text!r} ends too early; {_HELP}")
    kind, word = tokens[position]
    if kind == "sign":
        raise RecordingError(f"--columns: {word!r} stands at the wrong place in {text!r}; {_HELP}")
    if kind == "number":
        return Value(np.asarray(float(word))), position + 1
    if kind == "index":
        return _column(_numbered(int(word), table)), position + 1
    found = _named(word, table)
    if found is None:
        names = [column.name for column in table.columns]
        hint = did_you_mean(text.strip(), names) or did_you_mean(word, names)
        raise RecordingError(
            f"{table.name} has no column named {word!r}{hint}; {table.summary}; quote names with blanks, or use #3"
        )
    return found, position + 1


def _combined(left: FloatArray, right: FloatArray, text: str) -> FloatArray:
    """Sum, if the lengths allow it."""
    if left.ndim and right.ndim and left.size != right.size:
        raise RecordingError(
            f"--columns: {text!r} adds columns of {left.size} and {right.size} rows; they must be equal"
        )
    return np.asarray(left + right, dtype=np.float64)
