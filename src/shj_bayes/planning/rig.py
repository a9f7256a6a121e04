"""What a rig can do: limits in ``rig.toml`` or in options, and whether a protocol keeps to them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from shj_bayes._util.did_you_mean import did_you_mean
from shj_bayes._util.files import read_toml
from shj_bayes.errors import PlanError, shown
from shj_bayes.planning.protocol import Protocol

SCHEMA = "shj-bayes/rig/1"
MAX_TOML = 100_000  # bytes
LEEWAY = 1.001  # of a limit, for rounding
BOUNDS = {  # of the limits of any rig: from a small specimen to the largest shake table, and a test of a week
    "max_stroke_mm": (0.01, 1e4),
    "max_speed_mm_s": (1e-3, 1e5),
    "max_force_kN": (1e-3, 1e6),
    "max_minutes": (1e-3, 1e4),
    "rate_Hz": (1e-3, 1e6),
}


@dataclass(frozen=True)
class Rig:
    """Limits of a rig."""

    max_stroke_mm: float  # largest displacement to either side of the middle of the stroke
    max_speed_mm_s: float
    max_force_kN: float
    max_minutes: float
    rate_Hz: float  # at which the rig takes and records displacement

    def __post_init__(self) -> None:
        """Refuse limits that no rig has."""
        for name, value in asdict(self).items():
            _refuse_beyond(name, value)

    def broken_by(self, protocol: Protocol) -> tuple[str, ...]:
        """Limits that a protocol does not keep, in words; its force is judged by whoever predicts it."""
        pairs = (
            ("displacement", protocol.largest_mm, self.max_stroke_mm, "mm"),
            ("speed", protocol.fastest_mm_s, self.max_speed_mm_s, "mm/s"),
            ("time", protocol.duration_s / 60.0, self.max_minutes, "min"),
        )
        return tuple(
            f"{what} {value:.4g} {unit}, allowed {limit:.4g}"
            for what, value, limit, unit in pairs
            if value > LEEWAY * limit
        )


LIMITS = tuple(field.name for field in fields(Rig))


def stated_limits(path: Path | None, given: Mapping[str, float | None]) -> dict[str, float]:
    """Limits of a ``rig.toml``, where there is one, with those given over them; `PlanError` with the one at fault."""
    for name in given:
        if name not in LIMITS:
            raise PlanError(f"'{name}' is no limit; known are {', '.join(LIMITS)}{did_you_mean(name, LIMITS)}")
    stated = {} if path is None else read_rig(path)
    return stated | {name: value for name, value in given.items() if value is not None}


def read_rig(path: Path) -> dict[str, float]:
    """Limits of a ``rig.toml``, as far as it states them; `PlanError` with the key at fault."""
    table: dict[str, Any] = read_toml(path, SCHEMA, MAX_TOML, PlanError)[0]
    out = {}
    for key, value in table.items():
        if key in ("schema", "name"):
            continue
        if key not in LIMITS:
            raise PlanError(
                f"{path.name}: '{shown(key)}' is not a limit; known are {', '.join(LIMITS)}{did_you_mean(key, LIMITS)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PlanError(f"{path.name}: {key} = {shown(value)}; a number is needed")
        _refuse_beyond(key, value)
        out[key] = float(value)
    return out


def _refuse_beyond(name: str, value: float) -> None:
    least, most = BOUNDS[name]
    if not least <= value <= most:
        raise PlanError(f"rig: {name} = {shown(value)}; allowed is a number from {least:g} to {most:g}; state another")
