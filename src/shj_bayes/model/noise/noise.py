"""What a noise model is: a white part, a part correlated in time, how heavy its tails are; and all that there are.

Every module of this package that holds a ``NOISE`` is one; adding a file is enough.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model import noise
from shj_bayes.model.parameters import NOISE_PARAMETERS, FloatArray

Values = Mapping[str, FloatArray]
DEFAULT = "slow"


class NoiseComponents(NamedTuple):
    """The two parts of the noise for m parameter sets; all arrays have shape (m,)."""

    white_kN: FloatArray  # standard deviation of the part that is new in each sample
    slow_kN: FloatArray  # standard deviation of the part that is correlated in time
    nu: FloatArray  # degrees of freedom of what is new; infinity is Gaussian


@dataclass(frozen=True, eq=False)
class Noise:
    """One noise model."""

    id: str  # word for ``--noise``; the file carries it
    # its parameters, in the order in which they are sampled; each has a prior in the prior files
    parameters: tuple[str, ...]
    # ``parts(values)`` gives the `NoiseComponents` from parameters by name, each of shape (m,)
    parts: Callable[[Values], NoiseComponents]
    # ``decay(values, seconds, step_s)`` gives the autocorrelation of the slow part at each of n lags (s), shape (n, m),
    # for a channel sampled every ``step_s`` seconds. The slow part is a first-order Markov process, since `filter`
    # carries one state: the correlation at the sum of two lags is the product of those at each.
    decay: Callable[[Values, FloatArray, float], FloatArray]

    def __post_init__(self) -> None:
        """Refuse parameters without a unit and a meaning."""
        unknown = [name for name in self.parameters if name not in NOISE_PARAMETERS]
        if unknown:
            raise ModelError(
                f"noise model {self.id}: '{unknown[0]}' is not a noise parameter; known are "
                f"{', '.join(NOISE_PARAMETERS)} (add it to model/parameters.py, with a law in each prior file)"
            )


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


def noise_model(word: str) -> Noise:
    """Noise model of a word; `ModelError` with those that there are where there is none."""
    known = noise_models()
    if word not in known:
        raise ModelError(
            f"noise '{word}' is not known; choose one of {', '.join(known)}{did_you_mean(word, list(known))}"
        )
    return known[word]
