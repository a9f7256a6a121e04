"""What a design code is: a name, and a function from what is known of a set to margins."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from shj_bayes.margins.row import FACTORS, Margin
from shj_bayes.margins.spread import DesignBasis, Sample, Spread
from shj_bayes.options import MarginOptions
from shj_bayes.population.quantities import LOWEST


@dataclass(frozen=True)
class Given:
    """What a code is given of one set."""

    set_name: str  # the set, or "(any set)"
    # point values by quantity: of the devices, or of the sets for a set never tested
    samples: Mapping[str, Sample] = field(repr=False)
    spreads: Mapping[str, tuple[Spread, ...]] = field(repr=False)  # ways to come by the spread of each quantity
    devices: Mapping[str, int]  # tested devices behind each quantity
    parts: DesignBasis  # nominal and delivered forces, ageing
    request: MarginOptions  # choices of the user

    def of_force(self, kind: str, side: str, value: float, unit: str, origin: tuple[str, ...]) -> Margin:
        """Margin of the force by factors; `origin` is clause, formula, inputs and purpose, then note and warning."""
        n = self.devices.get(LOWEST, 0)
        return Margin(self.set_name, "force", FACTORS, kind, side, value, unit, n, math.nan, *origin)


@dataclass(frozen=True)
class Code:
    """A design code."""

    id: str  # name of its file
    rows: Callable[[Given], Iterator[Margin]]  # from what is given of a set to its margins
    place: int  # order on the sheet
