"""The force that a new device delivers: both runs, from standstill to the tested speed, first cycle and later ones."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shj_bayes.margins.outermost import DEFAULT, Newcomers, outer
from shj_bayes.margins.pair import NONE, Bounds
from shj_bayes.margins.row import HIGH, LOW
from shj_bayes.margins.sample import Motion
from shj_bayes.population.predict import RUN_FORCES, SECOND_RUN, NewDevice
from shj_bayes.population.quantities import FloatArray

SLOWEST = 0.01
"""Least factor that the speed may put on the force: a tail of gamma must not turn friction round."""

FirstCycles = Mapping[str, Bounds]
"""First over third cycle by set, as measured."""


@dataclass(frozen=True)
class Delivered:
    """Force of a new device of one set, kN.

    Parameters
    ----------
    low_rest, middle, high_rest : float
        5, 50 and 95 % of the first run at standstill: the law's Fy, which it holds from cycle to cycle.
    first_low : float
        5 % of the first run at the least favourable speed from 0 to the tested one.
    second_low : float or None
        The same of the second run.
    low, high : float
        5 % of the smaller and 95 % of the larger of both runs, likewise.
    typical : Bounds
        Smallest and largest force of a typical device over its force in the first run at standstill.
    ratio : float or None
        Second run over first of a typical device.
    speeds : tuple of float
        Factor of the speed on a typical device, by law of speed; empty where the speed is not known.
    first_cycle : Bounds
        First over third cycle, as measured; 1 and 1 where it was not.
    """

    low_rest: float
    middle: float
    high_rest: float
    first_low: float
    second_low: float | None
    low: float
    high: float
    typical: Bounds
    ratio: float | None
    speeds: tuple[float, ...]
    first_cycle: Bounds = NONE


def force_draws(device: NewDevice, motion: Motion | None) -> list[dict[str, FloatArray]]:
    """Draws of the least and the greatest force, by law of speed.

    Parameters
    ----------
    device : NewDevice
        Draws of Fy, and of ratio and gamma where they are known.
    motion : Motion or None
        Its speed bounds the range from standstill; None: standstill alone.

    Returns
    -------
    list of dict
        Per law of speed: ``first`` and ``second`` least force of the first run and of the later ones, ``least`` and
        ``most`` of all, kN.
    """
    first = device.draws["Fy"]
    later = [device.draws[force] for force in RUN_FORCES if force in device.draws]
    second = np.min(later, axis=0) if later else first
    largest = np.max([first, *later], axis=0)
    factors = [np.ones_like(first)]
    if motion is not None and "gamma" in device.draws:
        v = motion.guard.speed_mm_s
        factors = [np.maximum(1.0 + g * v, SLOWEST) for g in motion.guard.gammas(device.draws["gamma"]).values()]
    return [
        {
            "first": first * np.minimum(1.0, moving),
            "second": second * np.minimum(1.0, moving),
            "least": np.minimum(first, second) * np.minimum(1.0, moving),
            "most": largest * np.maximum(1.0, moving),
        }
        for moving in factors
    ]


def delivered(devices: Newcomers, own: int, motion: Motion | None, first_cycle: Bounds = NONE) -> Delivered:
    """Bound the force of a new device.

    Parameters
    ----------
    devices : mapping of str to NewDevice
        By prior of the spread.
    own : int
        Tested devices of the set; where few, the outermost prior counts.
    motion : Motion or None
        Cycle.
    first_cycle : Bounds
        First over third cycle, as measured.
    """
    draws = {label: force_draws(device, motion) for label, device in devices.items()}

    def bound(part: str, side: str) -> float:
        level, pick = (0.05, min) if side == LOW else (0.95, max)
        by_prior = {label: pick(float(np.quantile(x[part], level)) for x in laws) for label, laws in draws.items()}
        return outer(by_prior, side, own)

    def rest(side: str, level: int) -> float:
        return outer({label: device.band("Fy")[level] for label, device in devices.items()}, side, own)

    main = devices[DEFAULT]
    moved = [np.quantile(x[part] / main.draws["Fy"], 0.5) for x in draws[DEFAULT] for part in ("least", "most")]
    speeds: tuple[float, ...] = ()
    if motion is not None and "gamma" in main.draws:
        gammas = motion.guard.gammas(np.array([main.band("gamma")[1]])).values()
        speeds = tuple(max(float(1.0 + g[0] * motion.guard.speed_mm_s), SLOWEST) for g in gammas)
    two_runs = SECOND_RUN in main.draws
    return Delivered(
        low_rest=rest(LOW, 0),
        middle=main.band("Fy")[1],
        high_rest=rest(HIGH, 2),
        first_low=bound("first", LOW) * first_cycle.low,
        second_low=bound("second", LOW) * first_cycle.low if two_runs else None,
        low=bound("least", LOW) * first_cycle.low,
        high=bound("most", HIGH) * first_cycle.high,
        typical=Bounds.around(*(float(m) for m in moved)),
        ratio=main.band("ratio")[1] if "ratio" in main.draws else None,
        speeds=speeds,
        first_cycle=first_cycle,
    )


def words(force: Delivered, motion: Motion | None) -> str:
    """Say what the delivered force is made of, in numbers."""
    cycle = force.first_cycle
    said = [
        "first cycle / third not measured: the law holds the force within a run"
        if cycle == NONE
        else f"first cycle / third {cycle.low:.3f} to {cycle.high:.3f} as measured",
        "no second run" if force.ratio is None else f"second run / first {force.ratio:.3f}",
        "speed not known"
        if motion is None or not force.speeds
        else f"speed 0 to {motion.guard.speed_mm_s:.3g} mm/s: factor 1 to "
        + " or ".join(f"{factor:.3f}" for factor in force.speeds),
    ]
    return "; ".join(said)
