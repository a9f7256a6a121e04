"""Device estimates from the results folders of finished fits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.inference.store import read_posterior, read_record
from shj_bayes.population.device import DeviceEstimate
from shj_bayes.population.quantities import QUANTITIES, FloatArray


def device_from_fit(folder: Path, name: str, set_name: str) -> DeviceEstimate:
    """Read one finished fit as a device of a population.

    Parameters
    ----------
    folder : Path
        Results folder of the fit (``posterior.nc``, ``fit.json``).
    name, set_name : str
        The device and its set.

    Returns
    -------
    DeviceEstimate
        Draws of K, Fy, beta, gamma and ratio, as far as the fit has them, with the density of the prior they were
        sampled under, so that the population does not count that prior once for each device.
    """
    record = read_record(folder)
    laws = {law["name"]: law for law in record["prior_laws"]}
    posterior = read_posterior(folder)["posterior"]
    draws = {q: posterior[q].to_numpy().ravel() for q in QUANTITIES if q in posterior}
    log_prior = {q: _pooled_log_density(laws[q], values) for q, values in draws.items()}
    return DeviceEstimate.from_posterior(name, set_name, draws, log_prior)


def _pooled_log_density(law: dict[str, Any], values: FloatArray) -> FloatArray:
    """Log density, up to a constant, of a prior law on the scale on which the quantity is pooled."""
    logarithmic = QUANTITIES[law["name"]].logarithmic
    if law["law"] == ("lognormal" if logarithmic else "normal"):
        pooled, centre = (np.log(values), np.log(law["a"])) if logarithmic else (values, law["a"])
        return np.asarray(-0.5 * ((pooled - centre) / law["b"]) ** 2)
    if law["law"] == ("loguniform" if logarithmic else "uniform"):
        return np.zeros_like(values)
    if logarithmic:  # a density of the value itself gains the factor d value / d log value
        density = 0.0 if law["law"] == "uniform" else -0.5 * ((values - law["a"]) / law["b"]) ** 2
        return np.asarray(density + np.log(values))
    return np.asarray(-0.5 * (np.log(values / law["a"]) / law["b"]) ** 2 - np.log(values))
