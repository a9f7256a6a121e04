"""Test protocols: blocks, what a rig allows of them, and the candidates that are compared."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import read_toml
from shj_bayes.errors import PlanError, did_you_mean, shown
from shj_bayes.recording.motion import Motion, alternating, table_1

SHARPNESS = 0.98  # of the triangle: 1 has corners, which no actuator follows; the peak speed is held over most of it
LEAST_SAMPLES = 8  # in the shortest cycle
EASE = 1.5  # radians of phase over which a block speeds up from rest: no faster than a sine does at its ends
MOST_SAMPLES = 2_000_000


class Waveform(StrEnum):
    """How a block moves between its turning points."""

    SINE = "sine"
    TRIANGLE = "triangle"


@dataclass(frozen=True)
class ProtocolBlock:
    """Consecutive cycles of one amplitude and peak speed, from rest in the middle of the stroke back to it."""

    amplitude_mm: float  # largest displacement to either side of the middle
    speed_mm_s: float  # peak speed
    cycles: int  # full ones
    waveform: Waveform = Waveform.SINE  # sine, or triangle with rounded corners
    rest_s: float = 0.0  # pause at the first positive end of the stroke

    def __post_init__(self) -> None:
        """Refuse blocks that hold no motion."""
        object.__setattr__(self, "waveform", Waveform(self.waveform))
        sizes = (self.amplitude_mm, self.speed_mm_s)
        if not (all(math.isfinite(v) and v > 0 for v in sizes) and self.cycles >= 1 and 0 <= self.rest_s < math.inf):
            raise PlanError(
                f"a block of {self.amplitude_mm:g} mm at {self.speed_mm_s:g} mm/s with {self.cycles} cycles and a rest "
                f"of {self.rest_s:g} s cannot be run; amplitude, speed and cycles must be above 0, the rest 0 or more"
            )

    @property
    def omega(self) -> float:
        """Phase speed, rad/s."""
        straight = 1.0 if self.waveform is Waveform.SINE else math.asin(SHARPNESS) / SHARPNESS
        return self.speed_mm_s / self.amplitude_mm * straight

    @property
    def duration_s(self) -> float:
        """Duration with its rest, s."""
        return (2.0 * math.pi * self.cycles + EASE) / self.omega + self.rest_s

    @property
    def travel_m(self) -> float:
        """Distance moved, m."""
        return 4e-3 * self.amplitude_mm * self.cycles

    def course(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Displacement (mm) and velocity (mm/s) at times from the block's beginning."""
        ease, moving = EASE / self.omega, self.duration_s - self.rest_s
        first = (math.pi / 2.0 + EASE / 2.0) / self.omega  # the first positive end of the stroke
        t = np.where(time_s <= first, time_s, np.maximum(first, time_s - self.rest_s))
        a, b = np.clip(t / ease, 0.0, 1.0), np.clip((moving - t) / ease, 0.0, 1.0)
        up = EASE * (a**3 - a**4 / 2.0) + self.omega * np.maximum(t - ease, 0.0)
        over = np.maximum(t - (moving - ease), 0.0)
        u = np.clip(over / ease, 0.0, 1.0)
        phase = up - self.omega * over + EASE * (u - u**3 + u**4 / 2.0)
        rate = self.omega * (3 * a**2 - 2 * a**3) * (3 * b**2 - 2 * b**3)
        rate = np.where((time_s > first) & (time_s < first + self.rest_s), 0.0, rate)
        if self.waveform is Waveform.SINE:
            return self.amplitude_mm * np.sin(phase), self.amplitude_mm * np.cos(phase) * rate
        scale, s = self.amplitude_mm / math.asin(SHARPNESS), SHARPNESS * np.sin(phase)
        return scale * np.arcsin(s), scale * SHARPNESS * np.cos(phase) * rate / np.sqrt(1.0 - s**2)


@dataclass(frozen=True, eq=False)
class Protocol:
    """A displacement history that a rig could run: a pattern of blocks and how often it comes, or samples of a file."""

    name: str  # what it is, in a few words
    blocks: tuple[ProtocolBlock, ...] = ()  # the pattern; empty where samples are given
    times: int = 1  # how often it comes
    samples: tuple[FloatArray, Motion] | None = None  # times (s) from 0, and motion about the middle of the stroke

    duration_s: float = field(init=False)
    largest_mm: float = field(init=False)  # displacement to either side of the middle
    fastest_mm_s: float = field(init=False)
    travel_m: float = field(init=False)  # distance moved

    def __post_init__(self) -> None:
        """Sum up what it does."""
        if self.samples:
            time, motion = self.samples
            largest, fastest = np.abs(motion.displacement_mm).max(), motion.speed_mm_s.max()
            said = {"duration_s": time[-1], "travel_m": motion.travel_mm[-1] / 1000.0}
        else:
            largest, fastest = (max(getattr(b, name) for b in self.blocks) for name in ("amplitude_mm", "speed_mm_s"))
            said = {
                name: self.times * sum(getattr(b, name) for b in self.blocks) for name in ("duration_s", "travel_m")
            }
        for name, value in (said | {"largest_mm": largest, "fastest_mm_s": fastest}).items():
            object.__setattr__(self, name, float(value))

    def sampled(self, rate_Hz: float) -> tuple[FloatArray, Motion]:
        """Give times (s) and exact motion at a sampling rate.

        `PlanError` if the rate is too low for the shortest cycle, or makes a file too long to write.
        """
        n = math.floor(self.duration_s * rate_Hz) + 1
        shortest = min((2.0 * math.pi / block.omega for block in self.blocks), default=math.inf)
        if not shortest * rate_Hz >= LEAST_SAMPLES or n > MOST_SAMPLES:
            raise PlanError(
                f"{self.name}: {rate_Hz:g} Hz is too slow for a cycle of {shortest:.3g} s (at least {LEAST_SAMPLES} "
                f"samples) or too fast for {self.duration_s:.0f} s (at most {MOST_SAMPLES} samples); change --rate"
            )
        time = np.arange(n) / rate_Hz
        if self.samples is not None:
            at, motion = self.samples
            start = np.concatenate([[0], np.searchsorted(time, at[motion.start[1:-1]]), [n]])
            if np.any(np.diff(start) <= 0):
                raise PlanError("a half-cycle of the file is shorter than the sampling interval; raise --rate")
            x, v = (np.interp(time, at, values) for values in (motion.displacement_mm, motion.speed_mm_s))
            return time, Motion(x, v, start, motion.turning_mm, motion.direction)
        blocks = self.blocks * self.times
        begin = np.concatenate([[0.0], np.cumsum([block.duration_s for block in blocks])])
        x, v, turns, turning = np.empty(n), np.empty(n), [], []
        edges = np.searchsorted(time, begin[:-1])
        for block, t0, a, b in zip(blocks, begin, edges, [*edges[1:], n], strict=False):
            x[a:b], v[a:b] = block.course(time[a:b] - t0)
            phase = math.pi * (0.5 + np.arange(2 * block.cycles)) + EASE / 2.0
            turns.append(t0 + phase / block.omega + block.rest_s)
            turning.append(block.amplitude_mm * (-1.0) ** np.arange(2 * block.cycles))
        start = np.concatenate([[0], np.searchsorted(time, np.concatenate(turns)), [n]])
        direction = alternating(start.size - 1)
        return time, Motion(x, np.abs(v), start, np.concatenate([[0.0], *turning]), direction)


def table_1_protocol(stroke_mm: float = math.inf, speed_mm_s: float = math.inf) -> Protocol:
    """Table 1 of the paper with smooth starts, its amplitudes and speeds brought down to what a rig allows."""
    share = min(1.0, stroke_mm / max(b.amplitude_mm for b in table_1()))
    blocks = []
    for b in table_1():
        amplitude = share * b.amplitude_mm
        speed = min(2.0 * math.pi * b.frequency_Hz * amplitude, speed_mm_s)
        blocks.append(ProtocolBlock(amplitude, speed, b.n_cycles))
    return Protocol("Table 1", tuple(blocks))


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
LIMITS = tuple(BOUNDS)


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
        _refuse_beyond(asdict(self), "rig")

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


def read_rig(path: Path) -> dict[str, float]:
    """Limits of a ``rig.toml``, as far as it states them; `PlanError` with the key at fault."""
    table = read_toml(path, SCHEMA, MAX_TOML, PlanError)[0]
    stated = {key: value for key, value in table.items() if key not in ("schema", "name")}
    _refuse_beyond(stated, path.name)
    return {key: float(value) for key, value in stated.items()}


def _refuse_beyond(limits: Mapping[str, Any], where: str) -> None:
    for name, value in limits.items():
        if name not in BOUNDS:
            near = did_you_mean(name, LIMITS)
            raise PlanError(f"{where}: '{shown(name)}' is no limit; known are {', '.join(LIMITS)}{near}")
        (least, most), number = BOUNDS[name], isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and least <= value <= most):
            raise PlanError(f"{where}: {name} = {shown(value)}; allowed is a number from {least:g} to {most:g}")


MOST_TIMES = 200  # that a pattern comes, however long the rig may run
SAMPLES = 36.0  # of a cycle, at least: reversals between few samples are not found again
Block = tuple[float, float, int] | tuple[float, float, int, Waveform, float]
# Share of the stroke, share of the speed, cycles; waveform and rest in s: one coordinate changes while others stand
# still.
PATTERNS: dict[str, tuple[Block, ...]] = {
    "one amplitude at several speeds": ((0.5, 1.0, 2), (0.5, 0.1, 1), (0.5, 0.3, 2), (0.5, 1.0, 2)),
    "large and small in turn": ((1.0, 1.0, 1), (0.15, 0.5, 2), (1.0, 1.0, 1), (0.15, 0.5, 2), (0.5, 1.0, 2)),
    "the same before and after a rest": ((0.5, 1.0, 4), (0.5, 1.0, 4, Waveform.SINE, 180.0)),
    "constant speed, full stroke": ((1.0, 1.0, 2, Waveform.TRIANGLE, 0.0), (1.0, 0.2, 1, Waveform.TRIANGLE, 0.0)),
    "small, worn in, small again": (
        *((0.25, 0.5, 3), (1.0, 1.0, 3)),
        *((0.25, 0.5, 3, Waveform.SINE, 60.0), (0.25, 0.1, 1)),
    ),
    "falling amplitudes": ((1.0, 1.0, 2), (0.75, 1.0, 2), (0.5, 1.0, 2), (0.25, 1.0, 2), (0.1, 1.0, 2)),
    "rising and falling, slow and fast": (
        *((0.08, 0.25, 3), (0.25, 0.25, 3), (0.5, 1.0, 2), (1.0, 1.0, 2), (1.0, 0.25, 1), (0.5, 0.25, 1)),
        *((0.25, 1.0, 3), (0.08, 0.25, 3), (0.25, 0.06, 1), (1.0, 0.5, 2, Waveform.SINE, 60.0), (0.25, 0.25, 3)),
    ),
}


def proposals(rig: Rig) -> tuple[Protocol, ...]:
    """Propose Table 1 again, and each pattern once and as often as the time allows.

    Table 1 comes first, whether the rig's time allows it or not: it is what the others are compared with. A pattern
    that takes longer than the time loses cycles.
    """
    out = [table_1_protocol(rig.max_stroke_mm, rig.max_speed_mm_s)]
    for name, rows in PATTERNS.items():
        blocks = [ProtocolBlock(a * rig.max_stroke_mm, v * rig.max_speed_mm_s, *more) for a, v, *more in rows]
        if once := within(blocks, rig):
            one = Protocol(name, once)
            out.append(one)
            times = min(MOST_TIMES, math.floor(60.0 * rig.max_minutes / one.duration_s))
            out += [replace(one, name=f"{name}, {times} times", times=times)] if times > 1 else []
    return tuple(out)


def within(blocks: list[ProtocolBlock], rig: Rig) -> tuple[ProtocolBlock, ...]:
    """Blocks in their order, as fast as the rate resolves, with fewer cycles or left out where the time is short."""
    left, out = 60.0 * rig.max_minutes, []
    for given in blocks:
        resolved = 2.0 * math.pi * given.amplitude_mm * rig.rate_Hz / SAMPLES  # a faster cycle has too few samples
        b = replace(given, speed_mm_s=min(given.speed_mm_s, resolved))
        for cycles in range(b.cycles, 0, -1):
            fewer = replace(b, cycles=cycles)
            if fewer.duration_s <= left:
                out.append(fewer)
                left -= fewer.duration_s
                break
    return tuple(out)
