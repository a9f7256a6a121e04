"""What a simulator is, and the list of all: every module of this package that holds a ``SIMULATORS``."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.proof import simulators
from shj_bayes.proof.device import Device
from shj_bayes.proof.simulators.rig import Acts, Drive

Shape = Mapping[str, float]
BASE = ("K", "Fy", "beta", "gamma", "ratio")


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
        Name in keys and tables; that of the catalogue's effect where there is one.
    inside : bool
        Whether the catalogue holds an effect for it.
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
    """

    id: str
    inside: bool
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


@cache
def simulators_by_id() -> dict[str, Simulator]:
    """All simulators in alphabetical order."""
    found = {}
    for module in pkgutil.iter_modules(simulators.__path__):
        for one in getattr(importlib.import_module(f"{simulators.__name__}.{module.name}"), "SIMULATORS", ()):
            found[one.id] = one
    return dict(sorted(found.items()))


def along(drives: Sequence[Drive], rates: Sequence[FloatArray], start: float = 0.0) -> list[FloatArray]:
    """Integrate a rate per second through all runs, going on from run to run (trapezoid rule)."""
    out, before = [], start
    for drive, rate in zip(drives, rates, strict=True):
        steps = np.concatenate([[0.0], (rate[1:] + rate[:-1]) / 2 * drive.dt])
        total = before + np.cumsum(steps)
        before = float(total[-1])
        out.append(total)
    return out
