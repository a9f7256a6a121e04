"""What a design code is, and all of them: those in the ``CODES`` of every module of this package."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache

from shj_bayes._util.imports import discovered
from shj_bayes.margins import codes
from shj_bayes.margins.basis import RANK, DesignBasis
from shj_bayes.margins.spread import FACTORS, Margin, Origin, Sample, Spread, known, limit, remarks
from shj_bayes.model.parameters import base_of
from shj_bayes.options import MarginOptions
from shj_bayes.population.hierarchy import ANY_SET
from shj_bayes.population.quantities import LOWEST
from shj_bayes.population.quantities import quantity as described


@dataclass(frozen=True)
class Given:
    """What a code is given of one set."""

    set_name: str  # the set, or "(any set)"
    # point values by quantity: of the devices, or of the sets for a set never tested
    samples: Mapping[str, Sample] = field(repr=False)
    spreads: Mapping[str, tuple[Spread, ...]] = field(repr=False)  # ways to come by the spread of each quantity
    devices: Mapping[str, int]  # tested devices behind each quantity
    basis: DesignBasis  # nominal force, bounds of the sliding force, ageing
    request: MarginOptions  # choices of the user

    def ways(self, quantity: str) -> tuple[Spread, ...]:
        """Ways to come by the spread of a quantity; first what the user states of the sliding force, of every run."""
        stated, own = self.request.v_known, self.spreads[quantity]
        if stated is None or base_of(quantity) not in RANK or self.set_name == ANY_SET:
            return own  # how much sets differ is not stated
        return (known(self.samples[quantity], stated, self.request.v_reason), *own)

    def of_force(self, kind: str, side: str, value: float, unit: str, origin: Origin, method: str = FACTORS) -> Margin:
        """Margin of the force, by factors or by another method."""
        n = self.devices.get(LOWEST, 0)
        error = abs(value) * self.basis.errors.get(side, 0.0)
        number = (value, unit, n, math.nan)
        return Margin(self.set_name, "force", method, kind, side, *number, *origin, monte_carlo_error=error)

    def limit(
        self,
        quantity: str,
        method: str,
        kind: str,
        way: Spread,
        factor: float,
        law: str,
        side: str,
        *,
        clause: str,
        purpose: str,
        missing: str = "",
    ) -> Margin:
        """Margin of a quantity by a factor on a spread, under a law; `missing` says why there is no value."""
        value, formula, inputs = limit(self.samples[quantity], way, factor, law, side)
        number = (math.nan if missing else value, described(quantity).unit, self.devices[quantity], way.degrees)
        note = missing or remarks(way, value)
        origin = Origin(clause, formula, f"{inputs}; spread: {way.origin}", purpose, note, way.warning)
        return Margin(self.set_name, quantity, method, kind, side, *number, *origin)


@dataclass(frozen=True)
class Code:
    """A design code."""

    id: str
    rows: Callable[[Given], Iterator[Margin]]  # from what is given of a set to its margins
    place: int  # order on the sheet


@cache
def catalogue() -> tuple[Code, ...]:
    """Every design code, in the order of its ``place`` on the sheet, then by id."""
    return tuple(sorted(discovered(codes, "CODES"), key=lambda code: (code.place, code.id)))
