"""Displacement protocols made of blocks: smooth, exact in their turning points, sampled at the rig's rate."""

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from shj_bayes.errors import PlanError
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion, alternating
from shj_bayes.recording.protocol import table_1

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

    def turns_s(self) -> FloatArray:
        """Give the times from the block's beginning at which it turns, shape (2 cycles,)."""
        phase = math.pi * (0.5 + np.arange(2 * self.cycles))
        return np.asarray((phase + EASE / 2.0) / self.omega + self.rest_s)

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
    """A displacement history that a rig could run: blocks one after the other, or the samples of a file."""

    name: str  # what it is, in a few words
    blocks: tuple[ProtocolBlock, ...] = ()  # empty where samples are given
    samples: tuple[FloatArray, Motion] | None = None  # times (s) from 0, and motion about the middle of the stroke

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        if self.samples is not None:
            return float(self.samples[0][-1])
        return sum(block.duration_s for block in self.blocks)

    @property
    def largest_mm(self) -> float:
        """Largest displacement to either side of the middle, mm."""
        if self.samples is not None:
            return float(np.abs(self.samples[1].displacement_mm).max())
        return max(block.amplitude_mm for block in self.blocks)

    @property
    def fastest_mm_s(self) -> float:
        """Largest speed, mm/s."""
        if self.samples is not None:
            return float(self.samples[1].speed_mm_s.max())
        return max(block.speed_mm_s for block in self.blocks)

    @property
    def travel_m(self) -> float:
        """Distance moved, m."""
        if self.samples is not None:
            return float(self.samples[1].travel_mm[-1]) / 1000.0
        return sum(block.travel_m for block in self.blocks)

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
            return time, _resampled(*self.samples, time)
        begin = np.concatenate([[0.0], np.cumsum([block.duration_s for block in self.blocks])])
        x, v, turns, turning = np.empty(n), np.empty(n), [], []
        edges = np.searchsorted(time, begin[:-1])
        for block, t0, a, b in zip(self.blocks, begin, edges, [*edges[1:], n], strict=False):
            x[a:b], v[a:b] = block.course(time[a:b] - t0)
            turns.append(t0 + block.turns_s())
            turning.append(block.amplitude_mm * (-1.0) ** np.arange(2 * block.cycles))
        start = np.concatenate([[0], np.searchsorted(time, np.concatenate(turns)), [n]])
        direction = alternating(start.size - 1)
        return time, Motion(x, np.abs(v), start, np.concatenate([[0.0], *turning]), direction)


def table_1_protocol(stroke_mm: float = math.inf, speed_mm_s: float = math.inf) -> Protocol:
    """Table 1 of the paper with smooth starts, its amplitudes and speeds brought down to what a rig allows."""
    share = min(1.0, stroke_mm / max(b.amplitude_mm for b in table_1()))
    blocks = (
        ProtocolBlock(
            share * b.amplitude_mm, min(2.0 * math.pi * b.frequency_Hz * share * b.amplitude_mm, speed_mm_s), b.n_cycles
        )
        for b in table_1()
    )
    return Protocol("Table 1", tuple(blocks))


def _resampled(at: FloatArray, motion: Motion, time: FloatArray) -> Motion:
    """Motion of a file at other times; half-cycles keep their turning points."""
    turns = at[motion.start[1:-1]]
    start = np.concatenate([[0], np.searchsorted(time, turns), [time.size]])
    if np.any(np.diff(start) <= 0):
        raise PlanError("a half-cycle of the file is shorter than the sampling interval; raise --rate")
    x, speed = (np.interp(time, at, v) for v in (motion.displacement_mm, motion.speed_mm_s))
    return Motion(x, speed, start, motion.turning_mm, motion.direction)
