"""Further channels of a device's tests as coordinates: their values over time, and the range that all runs span."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes._util.arrays import freeze
from shj_bayes.errors import ModelError
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.smoothing import Channel

PREFIX = "measured_"  # before the name of a channel, so that no name is that of another coordinate


@dataclass(frozen=True, eq=False)
class Measured:
    """A further channel in one run."""

    unit: str  # as its header says; empty where none did
    time_s: FloatArray  # shape (n,): time since the first sample of the run, ascending, s
    values: FloatArray  # shape (n,): in its unit, without noise; straight lines lie between them
    # low, high: least and largest value in all runs
    low: float
    high: float
    reference: float  # median over all runs: what the channel is taken to be where nothing is known of it

    def __post_init__(self) -> None:
        """Refuse a channel without a range."""
        freeze(self, "time_s", "values")
        if not (self.time_s.size == self.values.size > 0 and self.low < self.high):
            raise ModelError("a channel needs times, as many values, and a range above zero")

    def at(self, time_s: FloatArray) -> FloatArray:
        """Values at times since the first sample of the run, s."""
        return np.asarray(np.interp(time_s, self.time_s, self.values))

    def held(self, value: float) -> Measured:
        """Give the same channel, on the same scale, at one value all the time."""
        return replace(self, time_s=np.zeros(1), values=np.full(1, value))


def coordinate_of(name: str) -> str:
    """Word of the coordinate that a channel of some name is."""
    return PREFIX + re.sub(r"\W+", "_", name.lower()).strip("_")


def measured_in(runs: Sequence[Sequence[Channel]]) -> tuple[Mapping[str, Measured], ...]:
    """Further channels of each run of a device (the same ones in each), by coordinate.

    Those that have one value throughout are left out.
    """
    out: list[dict[str, Measured]] = [{} for _ in runs]
    for name in [channel.name for channel in runs[0]] if runs else ():
        own = [next(channel for channel in run if channel.name == name) for run in runs]
        every = np.concatenate([channel.values for channel in own])
        low, high, middle = float(every.min()), float(every.max()), float(np.median(every))
        if low < high:
            for run, channel in zip(out, own, strict=True):
                run[coordinate_of(name)] = Measured(channel.unit, channel.time_s, channel.values, low, high, middle)
    return tuple(out)
