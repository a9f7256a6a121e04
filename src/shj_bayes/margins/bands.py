"""Where a new device will lie: 5, 50 and 95 % of its predictive distribution, as margins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from shj_bayes.margins.row import BANDS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sample import SAMPLED, UNITS, Motion, predicted
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.predict import new_device
from shj_bayes.population.quantities import FloatArray

SIDES = {LOW: 0.05, MIDDLE: 0.5, HIGH: 0.95}
PURPOSE = {
    LOW: "lower bound: displacement and drift demand, slip at service loads",
    MIDDLE: "best estimate: first analysis",
    HIGH: "upper bound: forces on beam, column, welds and bolts",
}


def of_set(
    result: PopulationResult, set_name: str, n_devices: Mapping[str, int], motion: Motion | None
) -> Iterator[Margin]:
    """Bands of a new device of a set; the same under other priors of the spread stands in the note.

    Parameters
    ----------
    result : PopulationResult
        A fitted population.
    set_name : str
        The set, or ``ANY_SET``.
    n_devices : mapping of str to int
        Devices behind each quantity.
    motion : Motion or None
        Cycle for energy and force; without it they are left out.

    Yields
    ------
    Margin
    """
    main = predicted(new_device(result, set_name), motion)
    others = {label: predicted(new_device(result, set_name, label), motion) for label in result.other_priors}
    for quantity in SAMPLED:
        if quantity not in main:
            continue
        for side, level in SIDES.items():
            by_law = {law: float(np.quantile(draws, level)) for law, draws in main[quantity].items()}
            yield Margin(
                set_name,
                quantity,
                BANDS,
                f"new device, {100 * level:.0f} %",
                side,
                _outer(by_law, side),
                UNITS[quantity],
                n_devices.get(quantity, 0),
                math.nan,
                "predictive distribution, decision 0004",
                f"{100 * level:.0f} % quantile over draws of set level and spread",
                f"{next(iter(main[quantity].values())).size} draws; {_priors(others, quantity, level)}",
                PURPOSE[side],
                _laws(by_law),
            )


def _outer(by_law: Mapping[str, float], side: str) -> float:
    """Least favourable of the laws of speed; their middle for the middle."""
    values = list(by_law.values())
    return {LOW: min(values), MIDDLE: float(np.median(values)), HIGH: max(values)}[side]


def _laws(by_law: Mapping[str, float]) -> str:
    """Say what each law of speed gives where more than one was used."""
    if len(by_law) == 1:
        return ""
    listed = ", ".join(f"{name} {value:.4g}" for name, value in by_law.items())
    return f"EXTRAPOLATED beyond the tested speed; by law: {listed}"


def _priors(others: Mapping[str, Mapping[str, Mapping[str, FloatArray]]], quantity: str, level: float) -> str:
    values = {
        label: float(np.quantile(np.concatenate(list(drawn[quantity].values())), level))
        for label, drawn in others.items()
    }
    return "; ".join(f"{value:.4g} under the prior '{label}'" for label, value in values.items())
