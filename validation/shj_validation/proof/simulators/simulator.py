"""What a simulator is, and the list of all: every module of this package that holds a ``SIMULATORS``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError
from shj_validation.proof import simulators
from shj_validation.proof.device import Device
from shj_validation.proof.simulators.rig import RULES, Acts, Drive

Shape = Mapping[str, float]
BASE = ("K", "Fy", "beta", "gamma", "ratio")
# What a force can depend on, and how it does; a diagnosis uses the same words.
ACTIONS = ("capacity", "added", "motion", "noise")
COORDINATES = (
    "position",
    "distance",
    "travel",
    "time",
    "heat",
    "amplitude",
    "slip",
    "speed",
    "speed_by_travel",
    "rest",
    "acceleration",
    "direction",
    "constant",
    "load",
    "passes",
    "slack",
    "second surface",
    "compliance",
    "delay",
    "reversal",
    "stick-slip",
)


def _plain(_: np.random.Generator) -> dict[str, float]:
    return {}


def _unmapped(size: float, shape: Shape, device: Device) -> dict[str, float]:
    return {}


@dataclass(frozen=True, eq=False)
class Simulator:
    """Physics that the base law leaves out.

    Parameters
    ----------
    id : str
        Name in keys and tables.
    counts_as : str or None
        The catalogue's effect whose name is right for it, whichever form that effect has there; None where the
        catalogue holds none.
    coordinates : tuple of (str, str)
        What the force depends on, as (action, coordinate) of `ACTIONS` and `COORDINATES`. With several, each is true.
    unit : str
        Unit of the size.
    sizes : tuple of float
        Sizes are drawn log-uniformly between these two, across the limit of detection.
    act : callable
        ``act(drives, size, shape, device)`` gives the `Acts` of every run.
    physics : str
        One sentence: which equations are integrated.
    draw : callable
        Draws what else the physics needs, by name.
    truth : callable
        ``truth(size, shape, device)`` gives parameters of the catalogue's effect that have an exact counterpart.
    base : tuple of str
        Base parameters that keep their meaning beside this physics.
    fast : bool
        Whether it must be integrated at a thousand steps a second.
    signed : bool
        Whether the size is given a random sign.
    protocols : tuple of str
        Tests in which it can show at all.
    holds : tuple of str
        Other effects of the catalogue that this physics holds, and that are as true an answer.
    may_be_unknown : bool
        Whether the verdict ``unknown`` beside a right coordinate is as right as the name.
    rules : tuple of str
        Reversal rules under which the rig can be built with it.
    """

    id: str
    counts_as: str | None
    coordinates: tuple[tuple[str, str], ...]
    unit: str
    sizes: tuple[float, float]
    act: Callable[[Sequence[Drive], float, Shape, Device], list[Acts]]
    physics: str
    draw: Callable[[np.random.Generator], dict[str, float]] = _plain
    truth: Callable[[float, Shape, Device], dict[str, float]] = _unmapped
    base: tuple[str, ...] = BASE
    fast: bool = False
    signed: bool = False
    protocols: tuple[str, ...] = ("paper", "improved")
    holds: tuple[str, ...] = ()
    may_be_unknown: bool = False
    rules: tuple[str, ...] = RULES

    def __post_init__(self) -> None:
        """Refuse words that no diagnosis could use."""
        if unknown := [pair for pair in self.coordinates if pair[0] not in ACTIONS or pair[1] not in COORDINATES]:
            raise ModelError(f"{self.id}: {unknown} are no pairs of action and coordinate")

    @property
    def inside(self) -> bool:
        """Whether the catalogue holds an effect for it."""
        return self.counts_as is not None

    @property
    def effect(self) -> str:
        """Group in which it is dealt and counted: the catalogue's effect, or its own id outside the catalogue."""
        return self.counts_as or self.id

    @property
    def names(self) -> frozenset[str]:
        """Effects of the catalogue that are right answers."""
        return frozenset(self.holds) | ({self.counts_as} if self.counts_as else set())


@cache
def simulators_by_id() -> dict[str, Simulator]:
    """All simulators in alphabetical order."""
    return {one.id: one for one in sorted(discovered(simulators, "SIMULATORS"), key=lambda one: one.id)}


def along(drives: Sequence[Drive], rates: Sequence[FloatArray], start: float = 0.0) -> list[FloatArray]:
    """Integrate a rate per second through all runs, going on from run to run (trapezoid rule)."""
    out, before = [], start
    for drive, rate in zip(drives, rates, strict=True):
        steps = np.concatenate([[0.0], (rate[1:] + rate[:-1]) / 2 * drive.dt])
        total = before + np.cumsum(steps)
        before = float(total[-1])
        out.append(total)
    return out
