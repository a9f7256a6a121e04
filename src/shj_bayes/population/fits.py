"""Device estimates from the results folders of finished fits."""

from pathlib import Path

import numpy as np

from shj_bayes._util.files import damage_told
from shj_bayes.errors import PopulationError, ShjError
from shj_bayes.model.law import variant_named
from shj_bayes.model.priors import Prior
from shj_bayes.population.device import NO_TAGS, DeviceEstimate, Tags
from shj_bayes.population.quantities import QUANTITIES, FloatArray
from shj_bayes.population.tested import RangeTested
from shj_bayes.results.device import read_group
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import read


def device_from_fit(folder: Path, name: str, set_name: str, tags: Tags = NO_TAGS) -> DeviceEstimate:
    """Read one finished fit as a device of a population.

    Draws of K, Fy, beta, gamma and ratio, as far as the fit has them, with the density of the prior they were sampled
    under, so that the population does not count that prior once for each device.
    """
    record = read(FitRecord, folder)
    with damage_told(f"fit.json or posterior.nc in {folder.name}", PopulationError):
        laws = {law.name: Prior(**vars(law)) for law in record.prior_laws}
        posterior = read_group(folder, "posterior")
        draws = {q: posterior[q].ravel() for q in QUANTITIES if q in posterior}
        log_prior = {q: _pooled_log_density(laws[q], values) for q, values in draws.items()}
        return DeviceEstimate.from_posterior(name, set_name, draws, log_prior, tags)


def _pooled_log_density(prior: Prior, values: FloatArray) -> FloatArray:
    """Log density of a prior on the scale on which the quantity is pooled, shape (n,)."""
    density = prior.log_density(values)
    # On a logarithmic scale a density of the value itself gains the factor d value / d log value.
    return density + np.log(values) if QUANTITIES[prior.name].logarithmic else density


def tested_by_fit(folder: Path) -> RangeTested | None:
    """Amplitudes and peak speeds of a device's recordings; None where its files do not hold them.

    From the complete half-cycles: the first and last of each run may be cut short.
    """
    try:
        variant = variant_named(read(FitRecord, folder).model.variant)
        data = read_group(folder, "constant_data")
        x, speed = data["displacement_mm"], data["speed_mm_s"]
        half, run = data["half_cycle_of_sample"], data["run"]
    except (ShjError, KeyError, TypeError):
        return None
    amplitudes, peaks = [], []
    for r in np.unique(run):
        for h in np.unique(half[run == r])[1:-1]:
            of_it = (run == r) & (half == h)
            amplitudes.append(0.5 * float(np.ptp(x[of_it])))
            peaks.append(float(np.quantile(speed[of_it], 0.98)))
    if not amplitudes or min(amplitudes) <= 0 or min(peaks) <= 0:
        return None
    # A recording on noisy displacement has half-cycles of different size; 2 % at either end is not a range.
    low, high = np.quantile(amplitudes, (0.02, 0.98)), np.quantile(peaks, (0.1, 0.9))
    return RangeTested(float(low[0]), float(low[1]), float(high[0]), float(high[1]), variant, folder.name)
