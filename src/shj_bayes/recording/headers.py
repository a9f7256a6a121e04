"""Column headers taken apart: what is measured, and in which unit."""

import re

from shj_bayes.recording.limits import MAX_NAME
from shj_bayes.recording.units import role_of

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
