"""Where a new device will lie: 5, 50 and 95 % of its predictive distribution, as margins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from shj_bayes.margins.outermost import DEFAULT, Newcomers, outer, own_devices, priors_that_count
from shj_bayes.margins.row import BANDS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sample import LAW, SAMPLED, UNITS, Motion, predicted
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.predict import RUN_FORCES

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
BASIS: dict[str, tuple[str, ...]] = {force: ("Fy", ratio) for force, ratio in RUN_FORCES.items()}
BASIS |= {DEGRADATION: ("ratio",), "energy": LAW, "force": LAW}
"""Pooled quantities that a derived one rests on."""


def of_set(
    result: PopulationResult,
    set_name: str,
    devices: Newcomers,
    n_devices: Mapping[str, int],
    motion: Motion | None,
) -> Iterator[Margin]:
    """Bands of a new device of a set: the default prior of the spread, with few devices the outermost of all.

    Parameters
    ----------
    result : PopulationResult
        A fitted population.
    set_name : str
        The set, or ``ANY_SET``.
    devices : mapping of str to NewDevice
        By prior of the spread.
    n_devices : mapping of str to int
        Devices behind each quantity.
    motion : Motion or None
        Cycle for energy and force; without it they are left out.

    Yields
    ------
    Margin
    """
    drawn = {label: predicted(device, motion) for label, device in devices.items()}
    for quantity in (*SAMPLED, DEGRADATION):
        if quantity not in drawn[DEFAULT]:
            continue
        own = own_devices(result, set_name, BASIS.get(quantity, (quantity,)))
        count = priors_that_count(tuple(drawn), own)
        for side, level in SIDES.items():
            by_law = {label: _quantiles(found[quantity], level) for label, found in drawn.items()}
            by_prior = {label: _outer_law(laws, side) for label, laws in by_law.items()}
            listed = "; ".join(f"{value:.4g} under the prior '{label}'" for label, value in by_prior.items())
            notes = [_laws(by_law[DEFAULT])]
            if len(count) > 1 and side != MIDDLE:
                notes.append(f"outermost of {len(count)} priors of the spread: the set has {own} devices of its own")
            yield Margin(
                set_name,
                quantity,
                BANDS,
                f"new device, {100 * level:.0f} %",
                side,
                outer(by_prior, side, own),
                UNITS[quantity],
                n_devices.get("ratio" if quantity == DEGRADATION else quantity, 0),
                math.nan,
                "predictive distribution, decision 0004",
                f"{100 * level:.0f} % quantile over draws of set level and spread",
                f"{next(iter(drawn[DEFAULT][quantity].values())).size} draws; {listed}",
                (LOSS if quantity == DEGRADATION else PURPOSE)[side],
                "; ".join(filter(None, notes)),
            )


def _quantiles(draws: Mapping[str, np.ndarray], level: float) -> dict[str, float]:
    return {law: float(np.quantile(values, level)) for law, values in draws.items()}


def _outer_law(by_law: Mapping[str, float], side: str) -> float:
    """Least favourable of the laws of speed; their middle for the middle."""
    values = list(by_law.values())
    return {LOW: min(values), MIDDLE: float(np.median(values)), HIGH: max(values)}[side]


def _laws(by_law: Mapping[str, float]) -> str:
    """Say what each law of speed gives where more than one was used."""
    if len(by_law) == 1:
        return ""
    listed = ", ".join(f"{name} {value:.4g}" for name, value in by_law.items())
    return f"EXTRAPOLATED beyond the tested speed; by law: {listed}"
