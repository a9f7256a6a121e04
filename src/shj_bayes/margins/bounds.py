"""Lower, middle and upper bound of a connection for structural analysis: stiffness, force, sharpness."""

import math
from dataclasses import dataclass

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins import row
from shj_bayes.margins.delivered import delivered
from shj_bayes.margins.outermost import DEFAULT, newcomers, outer, own_devices
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import sets_suffice
from shj_bayes.population.quantities import HIGHEST, LOWEST

LOWER, MIDDLE, UPPER = "lower", "middle", "upper"


@dataclass(frozen=True)
class Bound:
    """One rate-free definition of a connection."""

    set_name: str  # the set, or "(any set)"
    bound: str  # "lower", "middle", "upper": which of the three analyses it is for
    # K_kN_mm to beta: stiffness, sliding force, sharpness of the knee of Eq. (1).
    K_kN_mm: float
    force_kN: float
    beta: float
    # stiffness_kN_mm, damping: effective stiffness and damping of the amplitude stated
    stiffness_kN_mm: float
    damping: float
    n_devices: int  # tested devices

    def __post_init__(self) -> None:
        """Refuse what no analysis can take."""
        numbers = (self.K_kN_mm, self.force_kN, self.beta)
        if not (np.isfinite(numbers).all() and min(numbers) > 0):
            raise PopulationError(
                f"{self.set_name}, {self.bound}: stiffness {self.K_kN_mm:g} kN/mm, force {self.force_kN:g} kN and "
                f"sharpness {self.beta:g} must be above zero; test more devices of this set, or leave it out"
            )


def bounds(design: PopulationResult, parameters: PopulationResult, amplitude_mm: float) -> tuple[Bound, ...]:
    """Draw up three bounds of every set, from its pooled design quantities and parameters (for the sharpness).

    Lower: 5 % of the smallest plateau of all runs. Middle: 50 % of the mean plateau of the first run. Upper: 95 % of
    the largest force of all runs. Stiffness 5, 50 and 95 %; sharpness its middle. Effective stiffness and damping are
    those of an elastic-plastic loop of the amplitude: F / A and (2/pi)(1 - F / (K A)).
    """
    out = []
    # No material of a set never tested where its band would be all assumption: an analysis would take it for a result.
    untested = (ANY_SET,) if sets_suffice(len(design.sets)) else ()
    for name in (*design.set_names, *untested):
        devices = newcomers(design, name)
        own = own_devices(design, name, (LOWEST, HIGHEST, "K"))
        force = delivered(devices, own)
        middle = float(np.median(devices[DEFAULT].draws["plateau"]))
        bands = {label: device.band("K") for label, device in devices.items()}
        fit = parameters.fit("beta")
        level = fit.hyper[:, 0] if name == ANY_SET else fit.mu[:, parameters.index(name)]
        beta = float(np.clip(np.exp(np.median(level)), *BETA_RANGE))
        for i, (bound, side, value) in enumerate(
            ((LOWER, row.LOW, force.low), (MIDDLE, row.MIDDLE, middle), (UPPER, row.HIGH, force.high))
        ):
            stiffness = outer({label: band[i] for label, band in bands.items()}, side, own)
            slip = min(value / (stiffness * amplitude_mm), 1.0)
            damping = (2.0 / math.pi) * (1.0 - slip)
            n = devices[DEFAULT].n_devices
            out.append(Bound(name, bound, stiffness, value, beta, value / amplitude_mm, damping, n))
    return tuple(out)
