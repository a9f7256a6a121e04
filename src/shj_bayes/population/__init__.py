"""Device to device: what a new device of a set will be like, and how two sets compare.

measurement -> device -> hierarchy -> correlation -> predict -> loops -> compare -> results, with the paper's tables in
published and its claims in paper_claims; tested is the range of strokes and speeds that may be spoken of.
"""

from shj_bayes.population.compare import Comparison, Contrast, compare
from shj_bayes.population.device import DeviceEstimate, Tags
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.loops import LoopBand, loop_band
from shj_bayes.population.measurement import PosteriorDraws, Rounded, RoundedRatio
from shj_bayes.population.paper_claims import Claim, paper_claims
from shj_bayes.population.posterior import ANY_SET, DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.predict import NewDevice, how_wide, new_device, new_device_table
from shj_bayes.population.priors import PopulationPrior, population_prior
from shj_bayes.population.published import published_devices, published_rows
from shj_bayes.population.results import load_population, to_tables, write_population

__all__ = [
    "ANY_SET",
    "Claim",
    "Comparison",
    "Contrast",
    "DeviceEstimate",
    "DeviceSet",
    "LoopBand",
    "NewDevice",
    "PopulationPrior",
    "PopulationResult",
    "PosteriorDraws",
    "QuantityPosterior",
    "Rounded",
    "RoundedRatio",
    "Tags",
    "compare",
    "fit_population",
    "how_wide",
    "load_population",
    "loop_band",
    "new_device",
    "new_device_table",
    "paper_claims",
    "population_prior",
    "published_devices",
    "published_rows",
    "to_tables",
    "write_population",
]
