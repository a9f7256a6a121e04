"""What a noise model is: a white part, a part correlated in time, how heavy its tails are; and all that there are.

Every module of this package that holds a ``NOISE`` is one; adding a file is enough.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model import noise

Values = Mapping[str, FloatArray]
DEFAULT = "slow"


class NoiseComponents(NamedTuple):
    """The two parts of the noise for m parameter sets; all arrays have shape (m,)."""

    white_kN: FloatArray  # standard deviation of the part that is new in each sample
    slow_kN: FloatArray  # standard deviation of the part that is correlated in time
    nu: FloatArray  # degrees of freedom of what is new; infinity is Gaussian


class NoiseParameter(NamedTuple):
    """One parameter of a noise model."""

    name: str  # name as users see it (docs/glossary.md)
    unit: str  # unit, ``"1"`` where there is none
    meaning: str  # a few plain words
    # Where the searches for the most probable noise begin: a grid in a fit, a grid in a diagnosis, one value beside a
    # large residual. In its unit, but kN as shares of a force: of the size of the residual; in a diagnosis, of Fy.
    # Where nothing stands they begin at quartiles and median of its prior.
    in_fit: tuple[float, ...] = ()
    in_diagnosis: tuple[float, ...] = ()
    typical: float | None = None
    # law, its two numbers (as for `priors.Prior`) and their source, where a file of priors holds none
    prior: tuple[str, float, float, str] | None = None
    bounds: tuple[float, float] = (0.0, np.inf)  # where the noise exists


@dataclass(frozen=True, eq=False)
class Noise:
    """One noise model."""

    id: str  # word for ``--noise``; the file carries it
    own: tuple[NoiseParameter, ...]  # its parameters, in the order in which they are sampled
    # ``parts(values)`` gives the `NoiseComponents` from parameters by name, each of shape (m,)
    parts: Callable[[Values], NoiseComponents]
    # ``decay(values, seconds, step_s)`` gives the autocorrelation of the slow part at each of n lags (s), shape (n, m),
    # for a channel sampled every ``step_s`` seconds. The slow part is a first-order Markov process, since `filter`
    # carries one state: the correlation at the sum of two lags is the product of those at each.
    decay: Callable[[Values, FloatArray, float], FloatArray]

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return tuple(parameter.name for parameter in self.own)


# Parameters of several models; one of a single model stands in its own module.
SIGMA = NoiseParameter("sigma", "kN", "noise scale", (0.5, 1.0, 2.0), (0.003, 0.01), 1.0)
WHITE = NoiseParameter("sigma_white", "kN", "noise from sample to sample", (0.3, 1.0, 3.0, 10.0), (0.003, 0.01), 1.0)
SLOW = NoiseParameter("sigma_slow", "kN", "slow part of the noise", (0.05, 0.4, 1.0), (0.002, 0.01), 1.0)
TAU = NoiseParameter(
    "tau_slow", "s", "correlation time of the slow part", (0.2, 1.0, 5.0, 30.0), (0.5, 5.0), 3.0,
    prior=("lognormal", 3.0, 1.0, "As in the shipped families, where a file holds none."),
)  # fmt: skip


def gaussian(white_kN: FloatArray, slow_kN: FloatArray) -> NoiseComponents:
    """Parts of a noise model without heavy tails."""
    return NoiseComponents(white_kN, slow_kN, np.full(white_kN.shape, np.inf))


def exponential(values: Values, seconds: FloatArray, step_s: float) -> FloatArray:
    """Correlation exp(-t / tau_slow) of an Ornstein-Uhlenbeck process, whatever the sampling rate."""
    return np.exp(-seconds[:, None] / values["tau_slow"])


@cache
def noise_models() -> dict[str, Noise]:
    """Every noise model by its word, the default first."""
    found = {model.id: model for model in discovered(noise, "NOISE", ModelError)}
    return dict(sorted(found.items(), key=lambda item: (item[0] != DEFAULT, item[0])))


@cache
def noise_parameters() -> dict[str, NoiseParameter]:
    """Every parameter of a noise model by its name; two of one name must be one."""
    known: dict[str, NoiseParameter] = {}
    for model in noise_models().values():
        for own in model.own:
            if known.setdefault(own.name, own) != own:
                raise ModelError(f"noise model {model.id}: '{own.name}' is a parameter of another model; rename it")
    return known


def noise_model(word: str) -> Noise:
    """Noise model of a word; `ModelError` with those that there are where there is none."""
    known = noise_models()
    if word not in known:
        raise ModelError(
            f"noise '{word}' is not known; choose one of {', '.join(known)}{did_you_mean(word, list(known))}"
        )
    return known[word]
