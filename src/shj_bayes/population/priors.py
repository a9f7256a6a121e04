"""What is assumed about the spread between devices before any is tested, and two other answers to the same question."""

from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.model.parameters import base_of
from shj_bayes.population.quantities import FloatArray, quantity


@dataclass(frozen=True)
class PopulationPrior:
    """Prior of the hierarchy of one quantity, on its pooled scale.

    device ~ Normal(mu_set, tau_set), mu_set ~ Normal(M, S), log tau_set ~ Normal(log tau0, omega).
    """

    # centre, centre_sd: M ~ Normal(centre, centre_sd)
    centre: float
    centre_sd: float
    between_scale: float  # S ~ half Student-t with 4 degrees of freedom and this scale
    spread_median: float  # median of tau0, the typical spread between devices of one set
    # tau0 is log-normal with this standard deviation of the logarithm; 0 means half-Cauchy with median (and scale)
    # ``spread_median`` instead
    spread_log_sd: float
    unequal_scale: float  # omega ~ half-normal with this scale: how much the spread may differ from set to set
    source: str  # where the numbers come from

    def __post_init__(self) -> None:
        """Refuse scales that are not above zero."""
        scales = (self.centre_sd, self.between_scale, self.spread_median, self.unequal_scale)
        if not (np.isfinite([self.centre, *scales]).all() and min(scales) > 0 and self.spread_log_sd >= 0):
            raise PopulationError(f"every scale of a population prior must be finite and above zero; got {self}")

    def packed(self) -> FloatArray:
        """Numbers in the order the sampler reads them."""
        level = (self.centre, self.centre_sd, self.between_scale)
        return np.array([*level, np.log(self.spread_median), self.spread_log_sd, self.unequal_scale])


_SPREAD = (
    "spread of one set: median 0.2 of the value (FEMA P-695 rates the dispersion of test data from 0.10, superior, to "
    "0.50, poor; geometric middle 0.22) with a factor of 7 either way, which reaches from what rounding alone makes "
    "(0.03) to more than the value itself; "
    "unequal spread: half-normal 1, so that sets may differ by factors of 3 and more; "
)
_PRIORS = {
    "K": PopulationPrior(np.log(20.0), 3.0, 1.0, 0.2, 2.0, 1.0, _SPREAD + "level: 20 kN/mm, a factor 20 either way"),
    "Fy": PopulationPrior(
        np.log(80.0), 3.0, 1.0, 0.2, 2.0, 1.0, _SPREAD + "level: 80 kN (two M16 8.8 bolts), a factor 20"
    ),
    "ratio": PopulationPrior(
        0.0, 1.0, 0.5, 0.2, 2.0, 1.0, _SPREAD + "level: 1 (no change between runs), a factor e either way"
    ),
    "gamma": PopulationPrior(
        0.0,
        0.05,
        0.03,
        0.01,
        2.0,
        1.0,
        "level symmetric about 0, 0.05 s/mm (half the force at 10 mm/s); spread of one set: median 0.01 s/mm, a tenth "
        "of the force at 10 mm/s, with a factor of 7 either way",
    ),
    "energy": PopulationPrior(
        np.log(15.0), 3.0, 1.0, 0.2, 2.0, 1.0, _SPREAD + "level: 15 kJ (80 kN over a cycle of 48 mm), a factor 20"
    ),
    "beta": PopulationPrior(np.log(20.0), 2.0, 1.0, 0.3, 2.0, 1.0, "level: 20, a factor 7 either way; spread 0.3"),
}


def population_prior(name: str) -> PopulationPrior:
    """Return the default prior of one quantity."""
    quantity(name)
    base = base_of(name)
    return _PRIORS[base if base in _PRIORS else "Fy"]  # all forces read off a test are sliding forces


ASSUMED = {
    "alike": "if all sets are held to spread nearly alike",
    "free": "if the spread is left to the devices alone",
}
"""What `other_priors` assume, in words."""


def other_priors(prior: PopulationPrior) -> dict[str, PopulationPrior]:
    """Return the two other priors of the spread that every answer is shown under.

    ``alike``: all sets spread nearly alike (omega half-normal 0.25), so that no set is believed to be tight because its
    few devices happen to agree. ``free``: typical spread half-Cauchy with twice the median (Gelman 2006) and omega
    twice as free, so that the data alone limit it.
    """
    return {
        "alike": replace(
            prior, unequal_scale=0.25 * prior.unequal_scale, source="sets spread nearly alike; " + prior.source
        ),
        "free": replace(
            prior,
            spread_median=2.0 * prior.spread_median,
            spread_log_sd=0.0,
            unequal_scale=2.0 * prior.unequal_scale,
            source="typical spread half-Cauchy with twice the median (Gelman 2006); " + prior.source,
        ),
    }
