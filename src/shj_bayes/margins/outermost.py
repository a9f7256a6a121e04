"""New devices as their test would show them; of a set with few devices of its own, under the outermost prior.

Two devices that agree by chance make a band that is too narrow under any one prior: in the closest third of simulated
pairs a 90 % band held 80 % of new devices. With more than `FEW` devices the set itself says enough.

A new device carries the error of its reading as the tested ones do. The readings of all devices, tested and new, are
then alike before the test, and the band holds its share of them whatever the error is said to be. Without it a stated
error larger than the true one is taken off the scatter of the devices, and the band comes out too narrow.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from shj_bayes.margins.row import HIGH, LOW
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import NewDevice, new_device
from shj_bayes.population.quantities import stream

FEW = 3
DEFAULT = "default"
Newcomers = Mapping[str, NewDevice]
"""New devices of one set by prior of the spread, the default first."""


def newcomers(result: PopulationResult, set_name: str) -> dict[str, NewDevice]:
    """Draw new devices of a set under every prior of the spread that was tried, each read as the tested ones were."""
    return {label: _as_read(new_device(result, set_name, label), result) for label in (DEFAULT, *result.other_priors)}


def _as_read(device: NewDevice, result: PopulationResult) -> NewDevice:
    """Give the draws of design quantities (all of them positive) the error with which those of the set are known."""
    groups = [group for group in result.sets if device.set_name in (ANY_SET, group.name)] or result.sets
    draws = {}
    for q, values in device.draws.items():
        errors = np.concatenate([group.errors.get(q, ()) for group in groups])
        known = errors[np.isfinite(errors)]
        rng = np.random.default_rng(stream(result.seed, "reading", device.set_name, q))
        error = float(np.sqrt(np.mean(known**2))) if known.size else 0.0
        draws[q] = values * np.exp(error * rng.standard_normal(values.size))
    return replace(device, draws=draws)


def own_devices(result: PopulationResult, set_name: str, quantities: Iterable[str]) -> int:
    """Devices of a set that give all of the quantities; for a set never tested so many that the default counts.

    What a set never tested will be follows from all sets together, not from a few devices of its own.
    """
    if set_name == ANY_SET:
        return FEW + 1
    index = result.index(set_name)
    return min(result.fit(q).n_devices[index] for q in quantities if q in result.posteriors)


def priors_that_count(labels: Sequence[str], own: int) -> tuple[str, ...]:
    """Priors of the spread that a band is taken over: the default, with few devices all."""
    return tuple(labels) if own <= FEW else (DEFAULT,)


def outer(by_prior: Mapping[str, float], side: str, own: int) -> float:
    """Least favourable value of the priors that count; the default's for the middle."""
    values = [by_prior[label] for label in priors_that_count(tuple(by_prior), own)]
    return {LOW: min(values), HIGH: max(values)}.get(side, by_prior[DEFAULT])
