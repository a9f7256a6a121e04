"""Column headers taken apart: what is measured, and in which unit."""

from __future__ import annotations

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
_SUFFIXED = re.compile(r"^(?P<name>.+?)\s*[_,/: \-]\s*(?P<unit>[A-Za-z\u00b5\u03bc\"'.]{1,8})$")


def split_header(header: str) -> tuple[str, str | None]:
    """Separate name and unit of a header.

    Parameters
    ----------
    header : str
        For example ``"Displacement (in)"``, ``"Force [kip]"``, ``"time_s"`` or ``"Load / kN"``.

    Returns
    -------
    name : str
    unit : str or None
        As written; a unit in brackets is taken as it is, a suffix only when it is a unit of time, length or force.
    """
    text = header[:MAX_NAME].strip().strip("\"'").strip()
    if (match := _BRACKETED.match(text)) and match["name"].strip():
        return match["name"].strip(), match["unit"].strip()
    if match := _SUFFIXED.match(text):
        unit = match["unit"].strip(".").lower()
        if unit in _SUFFIXES or (unit in _TIME_SUFFIXES and "time" in match["name"].lower()):
            return match["name"].strip(), match["unit"]
    return text, None


def is_unit_cell(cell: str) -> bool:
    """Whether a cell below a header holds a unit, bare or in brackets (or nothing, or a dash)."""
    text = cell.strip().strip("()[]{}<>").strip()
    return text in {"", "-", "--"} or role_of(text) is not None or text.lower() in {"v", "mv", "mpa", "bar", "c", "%"}
