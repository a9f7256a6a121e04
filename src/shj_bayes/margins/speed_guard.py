"""The range of speeds that may be spoken of, and what bounded laws make of the rest when that is asked for.

Eq. (2) multiplies the force by 1 + v/dep. Fitted at one peak speed that is a tangent, not a law: for the published dep
of +30 and -30 mm/s it gives factors of 11 and -9 at 300 mm/s, and a force below zero pushes in the direction of motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.population.quantities import FloatArray
from shj_bayes.population.tested import RangeTested

PUBLISHED_DEP = (30.0, -30.0)
Shape = Callable[[float, float], float]
LAWS: dict[str, Shape] = {
    "held": lambda v, v0: 1.0,
    "saturating": lambda v, v0: (1.0 - math.exp(-v / v0)) / (1.0 - math.exp(-1.0)),
    "logarithmic": lambda v, v0: math.log1p(10.0 * v / v0) / math.log1p(10.0),
}
"""Share of the change at the tested speed v0 that each law has at v: all are 1 at v0 and agree with what was tested.
Held: no further change. Saturating: 1 - exp(-v/v0), the form of velocity-dependent friction in OpenSees. Logarithmic:
ln(1 + 10 v/v0), the slow growth of rate-and-state friction. One tested speed cannot tell them apart (DOMAIN E13)."""


@dataclass(frozen=True)
class Guard:
    """Speeds that were tested, and the speed asked for.

    Parameters
    ----------
    tested : RangeTested
        What the devices went through.
    speed_mm_s : float
        Asked for.
    extrapolate : bool
        The user has asked, in words, for what was not tested.
    """

    tested: RangeTested
    speed_mm_s: float
    extrapolate: bool = False

    def __post_init__(self) -> None:
        """Refuse a speed that was not tested, unless extrapolation was asked for.

        Raises
        ------
        PopulationError
            With the tested range, and why.
        """
        if not (math.isfinite(self.speed_mm_s) and self.speed_mm_s > 0):
            raise PopulationError(f"a speed must be above zero; got {self.speed_mm_s:g} mm/s")
        if self.beyond and not self.extrapolate:
            raise PopulationError(
                f"{self.speed_mm_s:g} mm/s was not tested: the largest tested speed is {self.tested.fastest_mm_s:.3g} "
                f"mm/s. {published_factors(self.speed_mm_s)} With --extrapolate the spread of bounded laws is given "
                "instead"
            )

    @property
    def beyond(self) -> bool:
        """Whether the speed asked for lies outside the tested range."""
        return not self.tested.holds_speed(self.speed_mm_s)

    def gammas(self, gamma: FloatArray) -> dict[str, FloatArray]:
        """Speed coefficients to run the law with, by law; the linear law alone inside the tested range.

        Beyond it each bounded law is replaced by the straight line that gives its force at mid-stroke, s/mm; no law
        takes the force below zero.
        """
        if not self.beyond:
            return {"linear": gamma}
        v, v0 = self.speed_mm_s, self.tested.fastest_mm_s
        change = np.maximum(gamma * v0, -1.0)
        return {name: np.maximum(shape(v, v0) * change, -1.0) / v for name, shape in LAWS.items()}


def published_factors(speed_mm_s: float) -> str:
    """Say what the published law does at a speed, and why that is meaningless when it is far from the tests."""
    up, down = (1.0 + speed_mm_s / dep for dep in PUBLISHED_DEP)
    return (
        f"At {speed_mm_s:g} mm/s the published law multiplies the sliding force by {up:.3g} for dep = +30 mm/s and by "
        f"{down:.3g} for dep = -30 mm/s"
        + (
            ": a friction force that pushes the way it moves, and feeds energy in. That is the tangent of a curve "
            "at one speed, drawn on as a line, and means nothing there."
            if down < 0
            else "."
        )
    )
