"""Small formulas over columns: ``#7 - 49.087*#6``, ``gtau*vir``.

Python's parser reads them, once names and numbers stand aside; of its tree nothing but + - * and / is gone through, and
nothing is ever evaluated as code.
"""

import ast
import operator
import re
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.errors import RecordingError, did_you_mean
from shj_bayes.recording.recording import FloatArray
from shj_bayes.recording.tables import Column, Table

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


@dataclass(frozen=True, eq=False)
class Value:
    """A formula's value: a column, or a single number when ``values`` has no dimension."""

    values: FloatArray  # numbers, shape (n_rows,) or ()
    columns: tuple[Column, ...] = ()  # columns it was made of; a plain column is one column unchanged
    plain: bool = False  # whether it is one column as it stands, so that the header's unit holds for it


def evaluate(text: str, table: Table) -> Value:
    """Value of a column name, a 1-based column number, or a formula of them and of single numbers.

    `RecordingError` for unknown names, a product of two columns, or anything that is no formula.
    """
    text = text.strip()
    if len(text) > _MAX_LENGTH:  # before int(), which refuses thousands of digits in words of its own
        raise RecordingError(f"--columns: a formula of {len(text)} characters; allowed are {_MAX_LENGTH}")
    if re.fullmatch(r"#?\d+", text):
        return _column(_numbered(int(text.lstrip("#")), table))
    exact = _named(text.strip("\"'"), table)
    if exact is not None:
        return exact
    operands: list[Value] = []

    def aside(match: re.Match[str]) -> str:
        operands.append(_operand(match, text, table))
        return f" {len(operands) - 1} "

    bare = _OPERAND.sub(aside, text)
    try:
        tree = ast.parse(f"({bare})", mode="eval").body if re.fullmatch(r"[\d\s()*/+-]+", bare) else None
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        tree = None
    if tree is None:
        raise RecordingError(f"--columns: cannot read {text!r}; {_HELP}")
    return _value(tree, operands, text)


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
        (lower.replace("/", "."), [c.header.lower().replace("/", ".") for c in table.columns]),  # struct or group
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


def _operand(match: re.Match[str], text: str, table: Table) -> Value:
    """Look up a number, column or named single number."""
    kind, word = str(match.lastgroup), match[str(match.lastgroup)]
    if kind == "number":
        return Value(np.asarray(float(word)))
    if kind == "index":
        return _column(_numbered(int(word), table))
    found = _named(word, table)
    if found is None:
        names = [column.name for column in table.columns]
        hint = did_you_mean(text, names) or did_you_mean(word, names)
        raise RecordingError(
            f"{table.name} has no column named {word!r}{hint}; {table.summary}; quote names with blanks, or use #3"
        )
    return found


def _value(node: ast.expr, operands: list[Value], text: str) -> Value:
    """Value of a part of a formula, whose numbers are places in the list of operands."""
    if isinstance(node, ast.Constant) and isinstance(node.value, int):
        return replace(operands[node.value], plain=False)
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
    return Value(values, left.columns + right.columns)
