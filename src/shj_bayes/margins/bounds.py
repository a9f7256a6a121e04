"""Lower, middle and upper bound of a connection for structural analysis: stiffness, force, sharpness."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins import row
from shj_bayes.margins.cycle import steady_cycle
from shj_bayes.margins.delivered import SLOWEST, delivered
from shj_bayes.margins.outermost import DEFAULT, Newcomers, newcomers, outer, own_devices
from shj_bayes.margins.sample import Motion
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import sets_suffice

LOWER, MIDDLE, UPPER = "lower", "middle", "upper"
NEEDED = ("K", "Fy", "beta", "gamma")


@dataclass(frozen=True)
class Bound:
    """One rate-free definition of a connection.

    Parameters
    ----------
    set_name : str
        The set, or "(any set)".
    bound : {"lower", "middle", "upper"}
        Which of the three analyses it is for.
    K_kN_mm, force_kN, beta : float
        Stiffness, sliding force, sharpness of the knee of Eq. (1).
    stiffness_kN_mm, damping : float
        Effective stiffness and damping of the cycle stated.
    n_devices : int
        Tested devices.
    """

    set_name: str
    bound: str
    K_kN_mm: float
    force_kN: float
    beta: float
    stiffness_kN_mm: float
    damping: float
    n_devices: int

    def __post_init__(self) -> None:
        """Refuse what no analysis can take."""
        numbers = (self.K_kN_mm, self.force_kN, self.beta)
        if not (np.isfinite(numbers).all() and min(numbers) > 0):
            raise PopulationError(
                f"{self.set_name}, {self.bound}: stiffness {self.K_kN_mm:g} kN/mm, force {self.force_kN:g} kN and "
                f"sharpness {self.beta:g} must be above zero; test more devices of this set, or leave it out"
            )


def bounds(models: Sequence[PopulationResult], motion: Motion) -> tuple[Bound, ...]:
    """Draw up three bounds of every set.

    Parameters
    ----------
    models : sequence of PopulationResult
        One, or several where a diagnosis leaves the physics open: the outermost then counts.
    motion : Motion
        Cycle for the middle force, and range of speeds.

    Returns
    -------
    tuple of Bound
        Lower: 5 % of the smaller of both runs at the least favourable speed from 0 to that of the cycle. Middle: 50 %
        of the first run, scaled to the energy that the law dissipates in the cycle (a sine: 1 + pi/4 gamma v). Upper:
        95 % of the larger of both runs at the least favourable speed. Stiffness 5, 50 and 95 %; sharpness its middle.
    """
    if motion.guard.beyond:
        raise PopulationError(
            f"materials are given for tested speeds only (up to {motion.guard.tested.fastest_mm_s:.3g} mm/s)"
        )
    out = []
    # No material of a set never tested where its band would be all assumption: an analysis would take it for a result.
    untested = (ANY_SET,) if sets_suffice(len(models[0].sets)) else ()
    for name in (*models[0].set_names, *untested):
        found = [
            three
            for model in models
            if (three := _of_set(newcomers(model, name), own_devices(model, name, (*NEEDED, "ratio")), motion))
        ]
        if found:
            out += [_outermost(same) for same in zip(*found, strict=True)]
    if not out:
        raise PopulationError(f"no set gives all of {', '.join(NEEDED)}, which a material needs")
    return tuple(out)


def _of_set(devices: Newcomers, own: int, motion: Motion) -> tuple[Bound, ...]:
    device = devices[DEFAULT]
    if any(q not in device.draws for q in NEEDED):
        return ()
    v = motion.guard.speed_mm_s
    energy = np.maximum(1.0 + math.pi / 4.0 * device.draws["gamma"] * v, SLOWEST)
    force = delivered(devices, own, motion)
    forces = force.low, float(np.quantile(device.draws["Fy"] * energy, 0.5)), force.high
    bands = {label: other.band("K") for label, other in devices.items()}
    stiffness = [
        outer({label: band[i] for label, band in bands.items()}, side, own)
        for i, side in enumerate((row.LOW, row.MIDDLE, row.HIGH))
    ]
    beta = float(np.clip(np.median(device.draws["beta"]), *BETA_RANGE))
    laws = np.column_stack([stiffness, forces, [beta] * 3, [0.0] * 3])
    cycle = steady_cycle(laws, motion.amplitude_mm, v, motion.guard.tested.variant)
    return tuple(
        Bound(
            device.set_name,
            bound,
            stiffness[i],
            forces[i],
            beta,
            float(cycle.stiffness_kN_mm[i]),
            float(cycle.damping[i]),
            device.n_devices,
        )
        for i, bound in enumerate((LOWER, MIDDLE, UPPER))
    )


def _outermost(same: Sequence[Bound]) -> Bound:
    """Lowest of the lower, highest of the upper, mean of the middle."""
    first = same[0]
    if len(same) == 1 or first.bound == MIDDLE:
        return replace(first, force_kN=float(np.mean([b.force_kN for b in same])))
    pick = min if first.bound == LOWER else max
    return pick(same, key=lambda b: b.force_kN)
