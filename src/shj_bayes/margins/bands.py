"""Where a new device will lie: 5, 50 and 95 % of its predictive distribution, as margins."""

import math
from collections.abc import Iterator, Mapping

import numpy as np

from shj_bayes.margins.outermost import DEFAULT, Newcomers, outer, own_devices, priors_that_count
from shj_bayes.margins.row import BANDS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.quantities import quantity as described

SIDES = {LOW: 0.05, MIDDLE: 0.5, HIGH: 0.95}
PURPOSE = {
    LOW: "lower bound: displacement and drift demand, slip at service loads",
    MIDDLE: "best estimate: first analysis",
    HIGH: "upper bound: forces on beam, column, welds and bolts",
}
DEGRADATION = "degradation"
LOSS = {
    LOW: "least loss of sliding force to count on",
    MIDDLE: "best estimate of the loss of sliding force after a first earthquake",
    HIGH: "greatest loss of sliding force to allow for in a second earthquake",
}


def of_set(
    result: PopulationResult, set_name: str, devices: Newcomers, n_devices: Mapping[str, int]
) -> Iterator[Margin]:
    """Bands of a new device of a set: the default prior of the spread, with few devices the outermost of all.

    `n_devices` are those behind each quantity.
    """
    for quantity in (*devices[DEFAULT].draws, DEGRADATION):
        of_ratio = quantity == DEGRADATION
        source = "ratio" if of_ratio else quantity
        if source not in devices[DEFAULT].draws:
            continue
        own = own_devices(result, set_name, (source,))
        count = priors_that_count(tuple(devices), own)
        for side, level in SIDES.items():
            by_prior = {
                label: float(np.quantile(1.0 - device.draws[source] if of_ratio else device.draws[source], level))
                for label, device in devices.items()
            }
            listed = "; ".join(f"{value:.4g} under the prior '{label}'" for label, value in by_prior.items())
            note = f"outermost of {len(count)} priors of the spread: the set has {own} devices of its own"
            head = (set_name, quantity, BANDS, f"new device, {100 * level:.0f} %", side)
            number = (outer(by_prior, side, own), described(source).unit, n_devices.get(source, 0), math.nan)
            origin = (
                "predictive distribution, decision 0004",
                f"{100 * level:.0f} % quantile over draws of set level and spread",
                f"{devices[DEFAULT].draws[source].size} draws; {listed}",
                (LOSS if of_ratio else PURPOSE)[side],
            )
            yield Margin(*head, *number, *origin, note if len(count) > 1 and side != MIDDLE else "")
