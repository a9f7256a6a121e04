"""Units as laboratories write them, turned into seconds, millimetres and kilonewtons."""

from __future__ import annotations

import difflib
import re
from functools import cache
from typing import TYPE_CHECKING, Literal

from shj_bayes.errors import RecordingError
from shj_bayes.recording.clock import H_MIN_OR_MIN_S

if TYPE_CHECKING:
    import pint

Role = Literal["time", "displacement", "force"]
ROLES: tuple[Role, ...] = ("time", "displacement", "force")
TARGET: dict[Role, str] = {"time": "s", "displacement": "mm", "force": "kN"}
_EXAMPLES: dict[Role, tuple[str, ...]] = {
    "time": ("s", "ms", "us", "min", "h"),
    "displacement": ("mm", "cm", "m", "um", "in", "ft"),
    "force": ("N", "kN", "MN", "lbf", "kip", "kgf", "tf", "kg", "t"),
}
_ABBREVIATION = 4  # letters of an abbreviated unit at most, in which case matters
_TONNE = "metric_ton * standard_gravity"
_KILOPOND_KN = 9.80665e-3
_POUND_KN = 0.45359237 * _KILOPOND_KN
# What laboratories write -> what pint understands. lb on a force channel is a pound-force.
_ALIASES = {
    word: unit
    for unit, words in {
        "inch": ('"', "''", "in", "in.", "ins", "inches"),
        "lbf": ("lb", "lbs", "lb.", "lb-f", "pound", "pounds"),
        "kip": ("kips", "klbf", "klb", "klbs"),
        "s": ("sec", "secs", "sec."),
        "ms": ("msec",),
        "us": ("usec", "\u00b5s", "\u03bcs"),  # micro sign, Greek mu
        "min": ("mins",),
        "hour": ("hr", "h"),
        "um": ("micron", "microns", "\u00b5m", "\u03bcm"),
        "kgf": ("kgf", "kp"),
        _TONNE: ("tonf", "tf"),
    }.items()
    for word in words
}
# Masses that a force channel is written in: its force is their weight.
_WEIGHTS_KN = {
    **dict.fromkeys(("kg", "kgs", "kilo", "kilogram", "kilograms", "kilogramm"), _KILOPOND_KN),
    **dict.fromkeys(("t", "te", "to", "tonne", "tonnes", "metric ton", "metric tons"), 1e3 * _KILOPOND_KN),
    **dict.fromkeys(("short ton", "short tons", "us ton"), 2000 * _POUND_KN),
    **dict.fromkeys(("long ton", "long tons", "uk ton"), 2240 * _POUND_KN),
}
_TONS = {"ton", "tons"}  # metric, short or long? They differ by 10 and 12 %.
# Case is forgiven where only one reading makes sense; mn is not here (millinewton or meganewton?).
_ANY_CASE = {unit.lower(): unit for unit in ("kN", "N", "mm", "cm", "s", "ms", "kip", "lbf")} | {"in": "inch"}
# Of what pint knows the units that recordings carry: importing it and its list takes longer than reading a recording.
_USUAL_SIZES: dict[Role, dict[str, float]] = {
    "time": {
        **{"s": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6},
        **{"min": 60.0, "hour": 3600.0, "hours": 3600.0},
    },
    "displacement": {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "inch": 25.4, "ft": 304.8},
    "force": {
        **{"N": 1e-3, "kN": 1.0, "MN": 1e3, "mN": 1e-6, "lbf": _POUND_KN, "kip": 1e3 * _POUND_KN},
        **{"kgf": _KILOPOND_KN, _TONNE: 1e3 * _KILOPOND_KN},
    },
}
_USUAL = {name: (role, size) for role, sizes in _USUAL_SIZES.items() for name, size in sizes.items()}
# Units of channels that nobody needs, so that pint is not asked about every one of them.
_OTHERS = {"V", "mV", "bar", "MPa", "degC", "C", "%", "mm/s", "m/s", "in/s"}


def _known(text: str) -> tuple[Role, float] | None:
    """Channel of a unit as laboratories write it, and its factor to the tool's unit; None when it is none of them."""
    # The likeliest first: pint's Ms is a million seconds, and stays so although MS is forgiven for ms.
    for name in (
        _ALIASES.get(text, text),
        _ALIASES.get(text.lower(), text),
        _ANY_CASE.get(text.lower(), text),
        text.lower() if len(text) > _ABBREVIATION else text,  # written out: Millimeters, KILONEWTONS
    ):
        if name in _USUAL:
            return _USUAL[name]
        if name not in _OTHERS and (unit := _parse(name)) is not None:
            for role, target in TARGET.items():  # a dimension can belong to one of them only
                if unit.is_compatible_with(target):
                    return role, float(_registry().Quantity(1.0, unit).to(target).magnitude)
    return None


@cache
def _registry() -> pint.UnitRegistry[float]:
    """Make the one unit registry, on first use: importing pint takes longer than printing a help page."""
    import pint  # noqa: PLC0415

    return pint.UnitRegistry()


@cache
def _parse(text: str) -> pint.Unit | None:
    """Give the unit that pint reads in a text, None when there is none."""
    if not re.fullmatch(r"""[\w."'*/ ^\u00b5\u03bc%-]{1,40}""", text):
        return None
    try:
        return _registry().Unit(text)
    except Exception:  # pint raises tokenizer, attribute and value errors for bad spellings
        return None


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
    known = _known(text) is not None or _parse(_ALIASES.get(text, text)) is not None
    raise RecordingError(_refusal(text, role, known))


def _refusal(text: str, role: Role, known: bool) -> str:
    """One line: what came, what is allowed, what to do."""
    allowed = _EXAMPLES[role]
    near = difflib.get_close_matches(text, [*allowed, *_ALIASES], n=1, cutoff=0.5)
    hint = f"; did you mean {near[0]!r}?" if near and near[0] != text else ""
    if known:  # of another channel: not a slip of the pen but a wrong header, or two columns exchanged
        hint = f"; where the header is wrong, say what the numbers are with --units {role}={TARGET[role]}"
    what = "is a unit, but not of" if known else "is no known unit of"
    if text == H_MIN_OR_MIN_S:
        return (
            "time: cells such as 00:01 may be hours and minutes or minutes and seconds; say which with --units time=h, "
            "where the first are hours, or --units time=min"
        )
    electrical = text.lower() in {"v", "mv", "volt", "volts"}
    advice = (
        "; multiply by the sensor's calibration first, or choose the calibrated column with --columns"
        if electrical
        else hint or f"; state the unit with --units, for example --units {','.join(TARGET.values())}"
    )
    return f"unit {text!r} {what} {role}; allowed are {', '.join(allowed)}{advice}"


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
