"""Units as laboratories write them, turned into seconds, millimetres and kilonewtons."""

import difflib
import re
from typing import Literal

from shj_bayes.errors import RecordingError
from shj_bayes.recording.clock import H_MIN_OR_MIN_S

Role = Literal["time", "displacement", "force"]
ROLES: tuple[Role, ...] = ("time", "displacement", "force")
TARGET: dict[Role, str] = {"time": "s", "displacement": "mm", "force": "kN"}
_EXAMPLES: dict[Role, tuple[str, ...]] = {
    "time": ("s", "ms", "us", "min", "h"),
    "displacement": ("mm", "cm", "m", "um", "in", "ft"),
    "force": ("N", "kN", "MN", "lbf", "kip", "kgf", "tf", "kg", "t"),
}
_KILOPOND_KN = 9.80665e-3
_POUND_KN = 0.45359237 * _KILOPOND_KN
_PREFIXES = (  # symbol, word and factor
    ("", "", 1.0), ("n", "nano", 1e-9), *((micro, "micro", 1e-6) for micro in ("u", "\u00b5", "\u03bc")),
    ("m", "milli", 1e-3), ("c", "centi", 1e-2), ("d", "deci", 0.1), ("da", "deca", 10.0), ("k", "kilo", 1e3),
    ("M", "mega", 1e6),
)  # fmt: skip
# Units with a prefix or none: their size in s, mm and kN, their symbol, and their words.
_METRIC: tuple[tuple[Role, float, str, tuple[str, ...]], ...] = (
    ("time", 1.0, "s", ("second", "seconds")),
    ("displacement", 1e3, "m", ("meter", "meters", "metre", "metres")),
    ("force", 1e-3, "N", ("newton", "newtons")),
)
# The others, whose case does not matter. lb on a force channel is a pound-force.
_WORDS: tuple[tuple[Role, float, tuple[str, ...]], ...] = (
    ("time", 1.0, ("sec", "secs", "sec.")),
    ("time", 1e-3, ("msec",)),
    ("time", 1e-6, ("usec",)),
    ("time", 60.0, ("min", "mins", "minute", "minutes")),
    ("time", 3600.0, ("h", "hr", "hour", "hours")),
    ("time", 86_400.0, ("day", "days")),
    ("displacement", 1e-3, ("micron", "microns")),
    ("displacement", 0.0254, ("mil", "mils", "thou")),
    ("displacement", 25.4, ('"', "''", "in", "in.", "ins", "inch", "inches")),
    ("displacement", 304.8, ("ft", "foot", "feet")),
    ("displacement", 914.4, ("yd", "yard", "yards")),
    ("force", _POUND_KN, ("lb", "lbs", "lb.", "lb-f", "lbf", "pound", "pounds")),
    ("force", 1e3 * _POUND_KN, ("kip", "kips", "klbf", "klb", "klbs")),
    ("force", _KILOPOND_KN, ("kgf", "kp")),
    ("force", 1e3 * _KILOPOND_KN, ("tf", "tonf")),
)
_SYMBOLS = {p + symbol: (role, size * factor) for role, size, symbol, _ in _METRIC for p, _, factor in _PREFIXES}
_WRITTEN = {p + word: (role, size * f) for role, size, _, words in _METRIC for _, p, f in _PREFIXES for word in words}
_SIZES = _SYMBOLS | _WRITTEN | {word: (role, size) for role, size, words in _WORDS for word in words}
# Case is forgiven where only one reading makes sense; mn is not here (millinewton or meganewton?).
_ANY_CASE = {
    **{word.lower(): word for word in ("kN", "N", "mm", "cm", "s", "ms")},
    **{word: word for _, _, words in _WORDS for word in words if word != "min"},  # MIN is a minimum
    **{word: word for word in _WRITTEN},  # Millimeters, KILONEWTONS
}
# Masses that a force channel is written in: its force is their weight.
_WEIGHTS_KN = {
    **dict.fromkeys(("kg", "kgs", "kilo", "kilogram", "kilograms", "kilogramm"), _KILOPOND_KN),
    **dict.fromkeys(("t", "te", "to", "tonne", "tonnes", "metric ton", "metric tons"), 1e3 * _KILOPOND_KN),
    **dict.fromkeys(("short ton", "short tons", "us ton"), 2000 * _POUND_KN),
    **dict.fromkeys(("long ton", "long tons", "uk ton"), 2240 * _POUND_KN),
}
_TONS = {"ton", "tons"}  # metric, short or long? They differ by 10 and 12 %.
# Units of other quantities, of which a refusal says so.
_OTHERS = re.compile(
    r"[nu\u00b5mkM]?(V|volts?|A|Hz|Pa|bar|W|g)|psi|ksi|deg[CF]?|[\u00b0]?[CFK]|rad|%|kg|1/s|k?N\*?m"
    r"|([mc]?m|in|ft)/s([\^*]*2)?|k?N/(m|mm|s)[2\u00b2]?"
)


def _known(text: str) -> tuple[Role, float] | None:
    """Channel of a unit as laboratories write it, and its factor to the tool's unit; None when it is none of them."""
    # As it is written first: Ms is a million seconds, and stays so although MS is forgiven for ms.
    return _SIZES.get(text) or _SIZES.get(_ANY_CASE.get(text.lower(), ""))


def role_of(text: str) -> Role | None:
    """Channel (time, displacement or force) that a unit such as ``kip`` belongs to; None where it is of none."""
    known = _known(text.strip())
    return None if known is None else known[0]


def is_weight(text: str) -> bool:
    """Whether a unit of a force is that of a mass, such as ``kg``, or a ton-force of which there are several."""
    word = _spaced(text)
    return word in _WEIGHTS_KN or word in _TONS or word == "tonf"


def _spaced(text: str) -> str:
    return " ".join(re.split(r"[\s_-]+", text.strip().lower()))


def multiplier(text: str, role: Role) -> float | None:
    """Give the factor from a unit (``lb`` is a pound-force) to the tool's unit of a channel: s, mm and kN.

    None if it is not a unit of that channel.
    """
    word = _spaced(text)
    if role == "force" and (word in _WEIGHTS_KN or word in _TONS):
        return _WEIGHTS_KN.get(word)
    known = _known(text.strip())
    return known[1] if known and known[0] == role else None


def factor(text: str, role: Role) -> float:
    """Multiplier from a unit to the tool's unit of a channel; `RecordingError` if it is not a unit of that channel."""
    if (found := multiplier(text, role)) is not None:
        return found
    text = text.strip()
    if role == "force" and _spaced(text) in _TONS:
        raise RecordingError(
            f"unit {text!r} of force may be a metric ton (9.807 kN), a short one of 2000 lbf (8.896 kN) or a long one "
            "of 2240 lbf (9.964 kN); say which with --units force=tf, 'force=short ton' or 'force=long ton'"
        )
    if text == H_MIN_OR_MIN_S:
        raise RecordingError(
            "time: cells such as 00:01 may be hours and minutes or minutes and seconds; say which with --units time=h, "
            "where the first are hours, or --units time=min"
        )
    known = _known(text) is not None or _OTHERS.fullmatch(text) is not None
    what = "is a unit, but not of" if known else "is no known unit of"
    near = difflib.get_close_matches(text, [*_EXAMPLES[role], *_ANY_CASE.values()], n=1, cutoff=0.5)
    if text.lower() in {"v", "mv", "volt", "volts"}:
        advice = "multiply by the sensor's calibration first, or choose the calibrated column with --columns"
    elif known:  # of another channel: not a slip of the pen but a wrong header, or two columns exchanged
        advice = f"where the header is wrong, say what the numbers are with --units {role}={TARGET[role]}"
    elif near and near[0] != text:
        advice = f"did you mean {near[0]!r}?"
    else:
        advice = f"state the unit with --units, for example --units {','.join(TARGET.values())}"
    raise RecordingError(f"unit {text!r} {what} {role}; allowed are {', '.join(_EXAMPLES[role])}; {advice}")


def parse_units(option: str | None) -> dict[Role, str]:
    """Read ``--units``: units in any order, or ``role=unit`` pairs; units as written by role, only what was given.

    `RecordingError` for something that is no unit of a channel, or two units of the same one.
    """
    found: dict[Role, str] = {}
    for part in (piece.strip() for piece in (option or "").split(",")):
        if not part:
            continue
        name, _, unit = (piece.strip() for piece in part.rpartition("="))
        role: Role | None = next((r for r in ROLES if r == name.lower()), None)
        if name and role is None:
            raise RecordingError(f"--units: {part!r} names {name!r}; allowed are {', '.join(ROLES)}")
        role = role or role_of(unit) or ("force" if is_weight(unit) else None)
        if role is None:
            near = difflib.get_close_matches(unit, [u for units in _EXAMPLES.values() for u in units], n=1, cutoff=0.4)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise RecordingError(
                f"--units: {unit!r} is no unit of time, length or force{hint} "
                f"Write for example --units mm,kN,s or --units time=ms,displacement=in,force=kip"
            )
        factor(unit, role)
        if role in found:
            raise RecordingError(
                f"--units gives {role} twice: {found[role]!r} and {unit!r}; give one unit for each channel"
            )
        found[role] = unit
    return found
