"""The quantities that are pooled from device to device, and the scale on which each is close to normal."""

import zlib
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from shj_bayes.errors import PopulationError

FloatArray = NDArray[np.float64]
Band = tuple[float, float, float]
LEVELS = (0.05, 0.5, 0.95)
_FARTHEST = 300.0  # heavy tails of a spread that no data limit; keeps products of two quantities finite


def band_of(values: FloatArray) -> Band:
    """5, 50 and 95 % of draws."""
    low, middle, high = (float(x) for x in np.quantile(values, LEVELS))
    return low, middle, high


def stream(seed: int, *labels: str) -> np.random.SeedSequence:
    """Return the stream of chance that belongs to some labels, whatever else is drawn."""
    return np.random.SeedSequence([seed, *(zlib.crc32(label.encode()) for label in labels)])


@dataclass(frozen=True)
class Quantity:
    """One pooled quantity."""

    name: str  # word of the interface: K, Fy, beta, gamma or ratio; with a run number behind it where a run has its own
    unit: str  # natural unit
    logarithmic: bool  # True when the logarithm is pooled (the quantity is positive), False when the value itself is

    def pool(self, natural: FloatArray | float) -> FloatArray:
        """Natural values on the pooled scale; `PopulationError` where one is not finite or has no logarithm."""
        values = np.asarray(natural, dtype=np.float64)
        if not np.all(np.isfinite(values)) or (self.logarithmic and np.any(values <= 0)):
            bound = "finite and above zero" if self.logarithmic else "finite"
            raise PopulationError(
                f"{self.name} [{self.unit}] must be {bound}; got values from {np.min(values):g} to "
                f"{np.max(values):g}. Correct the device's estimate or leave {self.name} out of it"
            )
        return np.log(values) if self.logarithmic else values

    def natural(self, pooled: FloatArray | float) -> FloatArray:
        """Values on the pooled scale in natural units; logarithms beyond +-300 are held there."""
        values = np.asarray(pooled, dtype=np.float64)
        return np.exp(np.clip(values, -_FARTHEST, _FARTHEST)) if self.logarithmic else values


_OF_ALL_RUNS = (
    Quantity("K", "kN/mm", True),  # initial stiffness
    Quantity("Fy", "kN", True),  # sliding force of the first run
    Quantity("ratio", "1", True),  # sliding force of the second run over that of the first
    Quantity("gamma", "s/mm", False),  # relative change of force per unit of speed; 0 means none
    Quantity("beta", "1", True),  # sharpness of the transition to sliding
)
LATER_RUNS = range(3, 10)  # a device has up to nine runs
QUANTITIES: dict[str, Quantity] = {q.name: q for q in _OF_ALL_RUNS} | {
    name: replace(q, name=name)
    for run in (2, *LATER_RUNS)
    for q in _OF_ALL_RUNS
    if q.name != "Fy" and (q.name, run) != ("ratio", 2)
    for name in (f"{q.name}_{run}",)
}
"""The ratio is pooled as its logarithm, not its logit: nothing in friction forbids a second run above the first
(bedding-in), log Fy of the second run then stays a plain sum, and a ratio rounded to 1 stays finite."""


LEAST, MOST = "least", "most"
LOWEST, HIGHEST = "lowest", "highest"
THIRD_CYCLE = "third"
_OF_A_TEST = (
    Quantity(LEAST, "kN", True),  # smallest plateau force of the first run
    Quantity(MOST, "kN", True),  # largest force of the first run
    Quantity("plateau", "kN", True),  # mean plateau force of the first run
    Quantity(THIRD_CYCLE, "kN", True),  # force of the third cycle of the first run
    Quantity("energy", "kJ", True),  # energy of a cycle of the largest amplitude, first run
)
_OF_ALL_TESTS = (
    Quantity(LOWEST, "kN", True),  # smallest plateau force of all runs
    Quantity(HIGHEST, "kN", True),  # largest force of all runs
)
DESIGN: dict[str, Quantity] = {q.name: q for q in (*_OF_ALL_TESTS, *_OF_A_TEST)} | {
    name: replace(q, name=name)
    for run in (2, *LATER_RUNS)
    for q in _OF_A_TEST
    if q.name != THIRD_CYCLE
    for name in (f"{q.name}_{run}",)
}
"""Read off the force of a test, real or virtual; their logarithms are pooled."""


def quantity(name: str) -> Quantity:
    """Look up a pooled quantity by its name; `PopulationError` where there is none."""
    if name not in QUANTITIES and name not in DESIGN:
        hint = "; dep is never pooled, give gamma = 1/dep" if name == "dep" else ""
        raise PopulationError(
            f"{name!r} is not a pooled quantity; these are: {', '.join(q.name for q in _OF_ALL_RUNS)}{hint}"
        )
    return QUANTITIES[name] if name in QUANTITIES else DESIGN[name]
