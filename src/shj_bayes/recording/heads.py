"""Heads of tables: names and units above the numbers, once or again."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from shj_bayes.errors import RecordingError
from shj_bayes.recording.columns import roles_named
from shj_bayes.recording.dialect import PLAIN, Dialect, is_number
from shj_bayes.recording.limits import MAX_CELL, MAX_NAME
from shj_bayes.recording.stamps import is_stamp
from shj_bayes.recording.units import factor, role_of

_BRACKETED = re.compile(r"^(?P<name>.*?)[\s_,/]*[(\[{<]\s*(?P<unit>[^()\[\]{}<>]{1,24})\s*[)\]}>]\s*$")
# Bare suffixes that are units; single letters that pint knows besides (a, d, h, t ...) are part of a name.
_SUFFIXES = {
    *("s", "sec", "ms", "us", "mm", "cm", "m", "um", "\u00b5m", "\u03bcm", "in", "inch", "ft"),
    *("n", "kn", "mn", "lb", "lbs", "lbf", "kip", "kips", "kgf", "tonf"),
}
_TIME_SUFFIXES = {"min", "mins", "h", "hr"}  # behind "time" only: elsewhere min is a minimum
_WEIGHT_SUFFIXES = {"t", "ton", "tons", "tonne", "tonnes", "kg", "tf"}  # behind a force only: t is a time, too
_FORCES = ("force", "load", "kraft", "last")
_OTHER_UNITS = {"v", "mv", "volt", "volts", "mpa", "bar", "c", "%", *_WEIGHT_SUFFIXES}
# degC, V, %, bar, 1/s, m/s^2, N/mm2, \u00b0C ...: a letter or sign and little behind it
_UNIT_LIKE = re.compile(r"(1/)?[^\W\d_%]{0,10}[%\u00b0\u2126\u2030]?[^\W\d_]{0,4}([ */.\u00b7^-]{0,2}[^\W_]{1,6}){0,3}")
_SUFFIXED = re.compile(r"^(?P<name>.+?)\s*[_,/: \-]\s*(?P<unit>[A-Za-z\u00b5\u03bc\"'.]{1,8})$")


def split_header(header: str) -> tuple[str, str | None]:
    """Separate name and unit of a header: ``Displacement (in)``, ``Force [kip]``, ``time_s``, ``Load / kN`` ...

    A unit in brackets is taken as it is, a suffix only when it is a unit of time, length or force; else it is None.
    """
    text = header[:MAX_NAME].strip().strip("\"'").strip()
    if (match := _BRACKETED.match(text)) and match["name"].strip():
        return match["name"].strip(), match["unit"].strip()
    if match := _SUFFIXED.match(text):
        unit = match["unit"].strip(".").lower()
        name = match["name"].lower()
        timed = unit in _TIME_SUFFIXES and "time" in name
        if unit in _SUFFIXES or timed or (unit in _WEIGHT_SUFFIXES and name.endswith(_FORCES)):
            return match["name"].strip(), match["unit"]
    return text, None


def bare_unit(cell: str) -> str:
    """Give the unit of a cell below a header, without its brackets."""
    return cell.strip().strip("()[]{}<>").strip()


def is_unit_row(cells: list[str]) -> bool:
    """Whether a row below the names holds units, bare or in brackets.

    True where every cell is empty, a dash or a usual unit, or, where units of two of these are among them,
    anything that may be a unit of another quantity: a file has channels that nobody needs.
    """
    texts = [bare_unit(cell) for cell in cells]
    filled = [text for text in texts if text not in {"", "-", "--"}]
    roles = {text: role_of(text) for text in filled}
    if filled and all(role or text.lower() in _OTHER_UNITS for text, role in roles.items()):
        return True
    return len({role for role in roles.values() if role}) > 1 and all(map(_UNIT_LIKE.fullmatch, filled))


# First cells of rows of names and of units; where a time has no name of its own they stand above its column.
_NAME_LABELS = {"channel name", "channel names", "signal name", "kanalname", "name"}
_UNIT_LABELS = {"unit", "units", "einheit", "einheiten", "y unit label", "unité", "unités"}
_SHORTEST_NAME = 3  # letters of words that may be names of columns and not marks of lost readings
_LABVIEW = ("LabVIEW Measurement", "***End_of_Header")


@dataclass(frozen=True)
class Wave:
    """Times of a channel as LabVIEW writes them."""

    started: str  # date and time
    first_s: float  # after the start
    step_s: float  # 0 where it is not written


@dataclass(frozen=True)
class Head:
    """What stands above rows of numbers."""

    names: list[str]  # "" where a column has none
    units: list[str | None]
    written: list[str]  # names and units together, as in the file
    line: int = 0  # of the names or units, counted from 1
    waves: list[Wave] = field(default_factory=list)  # of a LabVIEW file, of all columns but the first


def head_of(above: list[str], dialect: Dialect, line: int = 0) -> Head:
    """Names and units from the lines above the numbers, whichever of them they stand in.

    Names are the row in which most channels are recognised, the lowest of these; units the lowest row of units.
    """
    width = dialect.width
    rows = [cells for cells in (_cells(text, dialect)[:width] for text in above) if len(cells) > 1]
    while rows and len(rows[-1]) == width and _damaged(rows, dialect.decimal):
        rows.pop()
    whole = [len(cells) == width for cells in rows]
    rows = [cells + [""] * (width - len(cells)) for cells in rows]
    is_units = [is_unit_row(_unlabelled(cells)) for cells in rows]
    names = _row_of_names(rows, whole, is_units, dialect.decimal)
    labels = [""] * width if names is None else rows[names]
    unit_rows = [i for i, found in enumerate(is_units) if found and (whole[i] or _n_roles(rows[i]) > 1) and i != names]
    below: list[str | None] = [None] * width
    if unit_rows:
        below = [bare_unit(cell) or None for cell in _unlabelled(rows[unit_rows[-1]])]
    labels = ["Time" if cell.lower() in _NAME_LABELS else cell for cell in labels]
    pairs = [split_header(cell) for cell in labels]
    units = [own or unit for (_, own), unit in zip(pairs, below, strict=True)]
    written = [
        f"{cell} ({unit})" if cell and unit and own is None else cell or "(no name)"
        for cell, (_, own), unit in zip(labels, pairs, units, strict=True)
    ]
    head = Head([name for name, _ in pairs], units, written, line)
    return _with_waves(head, above, dialect) if any(text.startswith(_LABVIEW) for text in above) else head


def _cells(line: str, dialect: Dialect) -> list[str]:
    """Cells of a line; where blanks separate, names of several words may stand further apart, or between tabs."""
    cells = dialect.cells(line)
    if dialect.separator == " " and len(cells) > dialect.width:
        wider = [part.strip().strip('"') for part in re.split(r"\t|\s{2,}", line.strip())]
        return wider if len(wider) == dialect.width else cells
    return cells


def _unlabelled(cells: list[str]) -> list[str]:
    """Cells without words such as Unit before them."""
    return ["" if " ".join(cell.lower().replace("_", " ").split()) in _UNIT_LABELS else cell for cell in cells]


def _n_roles(cells: list[str]) -> int:
    """Count the channels to which the units of a row belong."""
    return len({role_of(bare_unit(cell)) for cell in cells if cell} - {None})


def _row_of_names(rows: list[list[str]], whole: list[bool], is_units: list[bool], decimal: str) -> int | None:
    """Which row holds the names; None where none does."""
    best, most = None, 0
    for i, cells in enumerate(rows):
        if is_units[i] or not whole[i] or any(is_number(cell, decimal) or is_stamp(cell) for cell in cells):
            continue
        roles = [roles_named(split_header(cell)[0]) for cell in cells]
        found = len(set().union(*roles))
        if found >= max(most, 1):
            best, most = i, found
    if best is not None:
        return best
    full = [i for i, row in enumerate(rows) if whole[i]]
    if len(full) > 1 and is_units[full[-1]]:
        full.pop()
    return full[-1] if full else None


def _damaged(rows: list[list[str]], decimal: str) -> bool:
    """Whether the last row is no header but the first sample with its readings lost: a number under names, or alone."""
    numbers = [any(is_number(cell, decimal) for cell in cells) for cells in rows]
    alone = all(cell == "" or is_number(cell, decimal) for cell in rows[-1])
    return numbers[-1] and (alone or (len(rows) > 1 and not numbers[-2]))


def _with_waves(head: Head, above: list[str], dialect: Dialect) -> Head:
    """Head of a LabVIEW file: ``X_Value`` is a time; beside it stand start and interval of each channel."""
    fields: dict[str, list[str]] = {}
    for text in above:  # what stands last holds for what follows
        cells = dialect.cells(text)
        fields[cells[0].lower()] = [*cells[1:], *[""] * dialect.width][: dialect.width - 1]
    timed = fields.get("x_dimension", ["Time"])[0].lower() in ("", "time")
    units = [
        "s" if timed and name.lower() == "x_value" else unit for name, unit in zip(head.names, head.units, strict=True)
    ]
    empty = [""] * (dialect.width - 1)
    columns = zip(*(fields.get(key, empty) for key in ("date", "time", "x0", "delta_x")), strict=True)
    waves = [
        Wave(f"{day} {time}".strip(), _number(x0, dialect), _number(step, dialect)) for day, time, x0, step in columns
    ]
    return replace(head, units=units, waves=waves)


def _number(cell: str, dialect: Dialect) -> float:
    """Give the number of a cell, 0 where there is none."""
    return float(cell.replace(dialect.decimal, ".")) if PLAIN[dialect.decimal].fullmatch(cell[:MAX_CELL]) else 0.0


def is_head(group: Sequence[str], first: Head, dialect: Dialect) -> bool:
    """Whether lines of words between rows of numbers are a head, and not a remark or a lost reading."""
    known = {name.lower() for name in first.names if name}
    for line in group:
        cells = _cells(line, dialect)
        if len(cells) != dialect.width:
            continue
        names = [split_header(cell)[0] for cell in cells]
        if is_unit_row(_unlabelled(cells)) or any(roles_named(name) or name.lower() in known for name in names):
            return True
        unlike = len(set(cells)) == len(cells) and min(map(len, cells)) >= _SHORTEST_NAME
        if unlike and dialect.separator != " ":
            return True
    return False


def brought(first: Head, own: Head, file: str) -> list[tuple[int, float]]:
    """Where the columns of the first head stand below a later one, -1 where it lacks one, and the factor of its unit.

    `RecordingError` with the line where a channel is missing or its unit cannot be brought to that of the first head.
    """
    names, units = own.names, own.units
    if is_unit_row(_unlabelled(names)) and not any(map(roles_named, names)):  # units alone come again
        names, units = first.names, [bare_unit(name) or None for name in names]
    where = f"{file}: the head in line {own.line}"
    apart = "give what follows it as a file of its own"
    if not any(first.names):
        raise RecordingError(f"{where} names columns, of which those above it have no names; write it above them, too")
    left = [(name.lower(), i) for i, name in enumerate(names)]
    places = []
    for name, unit in zip(first.names, first.units, strict=True):
        found = next(((other, i) for other, i in left if other == name.lower()), None)
        if found is None:
            if name and (roles_named(name) or (unit and role_of(unit))):
                raise RecordingError(f"{where} lacks {name!r}, its columns are {', '.join(names)[:200]}; {apart}")
            places.append((-1, 1.0))
            continue
        left.remove(found)
        places.append((found[1], _scale(unit, units[found[1]], f"{where} states {name!r}", apart)))
    return places


def _scale(first: str | None, own: str | None, where: str, apart: str) -> float:
    """Give the factor from the unit of a later head to that of the first, of which it is where it states none."""
    if own is None or own == first:
        return 1.0
    if first is None:
        raise RecordingError(f"{where} in {own}, the first head no unit; write the unit into the first head, too")
    role = role_of(own)
    if role is None or role_of(first) != role:
        raise RecordingError(f"{where} in {own}, the first head in {first}; {apart}")
    return factor(own, role) / factor(first, role)
