"""What a noise model is: a white part, a part correlated in time, how heavy its tails are; and all that there are.

`filter` holds the likelihood that all of them share.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError, did_you_mean

Values = Mapping[str, FloatArray]


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

    id: str  # word for ``--noise``
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


SIGMA = NoiseParameter("sigma", "kN", "noise scale", (0.5, 1.0, 2.0), (0.003, 0.01), 1.0)
WHITE = NoiseParameter("sigma_white", "kN", "noise from sample to sample", (0.3, 1.0, 3.0, 10.0), (0.003, 0.01), 1.0)
SLOW = NoiseParameter("sigma_slow", "kN", "slow part of the noise", (0.05, 0.4, 1.0), (0.002, 0.01), 1.0)
TAU = NoiseParameter(
    "tau_slow", "s", "correlation time of the slow part", (0.2, 1.0, 5.0, 30.0), (0.5, 5.0), 3.0,
    prior=("lognormal", 3.0, 1.0, "As in the shipped families, where a file holds none."),
)  # fmt: skip
PHI = NoiseParameter(
    "phi", "1", "lag-one noise correlation at the sampling rate", (-0.3, 0.3, 0.8, 0.98), (0.1, 0.8), 0.5,
    bounds=(-1.0, 1.0),
)  # fmt: skip
NU = NoiseParameter("nu", "1", "degrees of freedom of the noise (large is Gaussian)", (4.0, 30.0), (5.0,), 10.0)


def gaussian(white_kN: FloatArray, slow_kN: FloatArray) -> NoiseComponents:
    """Parts of a noise model without heavy tails."""
    return NoiseComponents(white_kN, slow_kN, np.full(white_kN.shape, np.inf))


def _slow(values: Values) -> NoiseComponents:
    """White from sample to sample, slow as it is."""
    return gaussian(values["sigma_white"], values["sigma_slow"])


def _student(values: Values) -> NoiseComponents:
    """As `_slow`, with Student's t for what is new in each sample."""
    return NoiseComponents(values["sigma_white"], values["sigma_slow"], values["nu"])


def _exponential(values: Values, seconds: FloatArray, step_s: float) -> FloatArray:
    """Correlation exp(-t / tau_slow) of an Ornstein-Uhlenbeck process, whatever the sampling rate."""
    return np.exp(-seconds[:, None] / values["tau_slow"])


def _all_correlated(values: Values) -> NoiseComponents:
    """No white part."""
    return gaussian(np.zeros_like(values["sigma"]), values["sigma"])


def _by_samples(values: Values, seconds: FloatArray, step_s: float) -> FloatArray:
    """Autocorrelation phi^k at a lag of k samples; a gap counts as a whole number of samples."""
    return np.asarray(np.power(values["phi"], np.rint(seconds[:, None] / step_s)))


def _independent(values: Values) -> NoiseComponents:
    """No slow part."""
    return gaussian(values["sigma"], np.zeros_like(values["sigma"]))


def _forgotten(values: Values, seconds: FloatArray, step_s: float) -> FloatArray:
    """Nothing is remembered."""
    return np.zeros((seconds.size, values["sigma"].size))


NOISES = (
    # The default, with a memory of seconds, means the same at any sampling rate: r(t) = w(t) + s(t),
    # sd(w) = sigma_white, cov(s(t), s(t')) = sigma_slow^2 exp(-|t - t'| / tau_slow).
    Noise(id="slow", own=(WHITE, SLOW, TAU), parts=_slow, decay=_exponential),
    # First-order autoregressive at the recorded rate, for comparison with the literature; its parameters hold for this
    # rate only: r_i = phi r_(i-1) + sigma sqrt(1 - phi^2) z_i, z ~ N(0, 1).
    Noise(id="ar1", own=(SIGMA, PHI), parts=_all_correlated, decay=_by_samples),
    # White alone, r_i ~ N(0, sigma^2), for comparison with least squares: too narrow for real noise.
    Noise(id="independent", own=(SIGMA,), parts=_independent, decay=_forgotten),
    # As `slow`, with (r_i - E[r_i | before]) / sd[r_i | before] ~ t_nu for each average of samples: single readings
    # that are far off count less.
    Noise(id="student", own=(WHITE, SLOW, TAU, NU), parts=_student, decay=_exponential),
)
DEFAULT = NOISES[0].id


@cache
def noise_models() -> dict[str, Noise]:
    """Every noise model by its word, the default first."""
    return {model.id: model for model in NOISES}


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
