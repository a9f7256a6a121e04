"""Priors: one TOML file per device family, each parameter with unit, law and source.

A prior owns the way from its parameter to an unbounded one (logarithm, normal quantile or identity) and the Jacobian of
that way; the likelihood never sees either.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import read_toml, shipped
from shj_bayes.errors import PriorError, did_you_mean, shown
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.model.noise import noise_parameters
from shj_bayes.model.parameters import base_and_run, base_parameters, describe

SCHEMA = "shj-bayes/priors/1"
LAWS = {
    "normal": ("mean", "sd"),
    "cauchy": ("median", "scale"),
    "lognormal": ("median", "spread"),
    "uniform": ("low", "high"),
    "loguniform": ("low", "high"),
}
# Where the law exists (above 0 for all others); a prior with mass beyond stops a fit half-way.
ALLOWED = {"beta": BETA_RANGE, "gamma": (-np.inf, np.inf)}
MIN_NUMBER = 1e-30  # of what is not 0; the inverse of a smaller one overflows, and 1e-320 has four digits left
MAX_NUMBER = 1e30  # squares and ratios of two such numbers still fit into a double
FREE_EDGE = 8.0  # normal quantile at which the upper end of a law is still told from 1 in double precision
MAX_GAMMA = 10.0  # s/mm, the width of its law; published ones are below 0.1
MAX_SPREAD = 5.0  # squares of what lies 30 spreads out, as far as the sampler can step, still fit into a double


@dataclass(frozen=True)
class Prior:
    """Prior law of one parameter."""

    name: str
    unit: str
    # "normal", "cauchy", "lognormal", "uniform", "loguniform": ``normal`` (mean, sd), ``cauchy`` (median, scale = half
    # the distance of the quartiles: heavy tails), ``lognormal`` (median, spread = standard deviation of the natural
    # logarithm), ``uniform`` and ``loguniform`` (low, high)
    law: str
    # a, b: the two numbers of the law, in that order
    a: float
    b: float
    source: str  # why this law
    earlier: bool = False  # whether it is the result of an earlier test

    def __post_init__(self) -> None:
        """Refuse laws that are no probability laws."""
        if self.law not in LAWS:
            raise PriorError(f"prior of {self.name}: law '{self.law}' is not known; choose one of {', '.join(LAWS)}")
        if not (np.isfinite(self.a) and np.isfinite(self.b)):
            raise PriorError(
                f"prior of {self.name}: {LAWS[self.law]} = {self.a}, {self.b}; both must be finite numbers"
            )
        if self.law in ("normal", "cauchy", "lognormal") and not self.b > 0:
            raise PriorError(f"prior of {self.name}: {LAWS[self.law][1]} = {self.b:g}; it must be above 0")
        if self.law in ("lognormal", "loguniform") and not self.a > 0:
            raise PriorError(f"prior of {self.name}: {LAWS[self.law][0]} = {self.a:g}; it must be above 0")
        for key, value in zip(LAWS[self.law], (self.a, self.b), strict=True):
            if 0 < abs(value) < MIN_NUMBER:
                raise PriorError(f"prior of {self.name}: {key} = {value:g}; 0 or {MIN_NUMBER:g} and above is allowed")
        if self.law in ("uniform", "loguniform") and not self.b > self.a:
            raise PriorError(f"prior of {self.name}: high = {self.b:g} must be above low = {self.a:g}")
        with np.errstate(over="ignore"):
            values = self.from_free(np.linspace(-FREE_EDGE, FREE_EDGE, 33))
        if not np.all(np.diff(values) > 0):
            raise PriorError(
                f"prior of {self.name}: the values of a {self.law} law of {self.a!r} and {self.b!r} cannot be told "
                "apart in double precision; make it wider"
            )

    @property
    def distribution(self) -> Any:
        """The law as a frozen scipy distribution, for whoever wants to go further with it."""
        from scipy import stats  # noqa: PLC0415  half a second that a fit need not wait for

        if self.law == "normal":
            return stats.norm(self.a, self.b)
        if self.law == "cauchy":
            return stats.cauchy(self.a, self.b)
        if self.law == "lognormal":
            return stats.lognorm(self.b, scale=self.a)
        if self.law == "uniform":
            return stats.uniform(self.a, self.b - self.a)
        return stats.loguniform(self.a, self.b)

    def to_free(self, value: FloatArray) -> FloatArray:
        """Parameter to unbounded parameter, standardised so that its prior is of unit size."""
        if self.law == "normal":
            return np.asarray((value - self.a) / self.b)
        if self.law == "lognormal":
            return np.asarray(np.log(value / self.a) / self.b)
        if self.law == "cauchy":  # from the nearer tail: it keeps its digits
            away = np.asarray(value, dtype=np.float64) - self.a
            return np.asarray(-np.sign(away) * ndtri(np.arctan2(self.b, np.abs(away)) / np.pi))
        low, high = self._bounds()
        inner = np.log(value) if self.law == "loguniform" else np.asarray(value)
        return np.asarray(ndtri((inner - low) / (high - low)))

    def from_free(self, z: FloatArray) -> FloatArray:
        """Unbounded parameter to parameter."""
        if self.law == "normal":
            return np.asarray(self.a + self.b * z)
        if self.law == "lognormal":
            return np.asarray(self.a * np.exp(self.b * z))
        if self.law == "cauchy":
            tail = ndtr(-np.abs(np.clip(z, -FREE_EDGE, FREE_EDGE)))
            return np.asarray(self.a + np.where(tail < 0.5, np.sign(z) * self.b / np.tan(np.pi * tail), 0.0))
        low, high = self._bounds()
        inner = low + (high - low) * ndtr(np.clip(z, -FREE_EDGE, FREE_EDGE))
        return np.asarray(np.exp(inner) if self.law == "loguniform" else inner)

    @property
    def either_sign(self) -> bool:
        """Whether the law is one of numbers of either sign, without bounds."""
        return self.law in ("normal", "cauchy")

    @property
    def support(self) -> tuple[float, float]:
        """Least and largest value that the law allows."""
        if self.either_sign:
            return -np.inf, np.inf
        return (0.0, np.inf) if self.law == "lognormal" else (self.a, self.b)

    def quantile(self, probability: FloatArray | float) -> FloatArray:
        """Value below which the parameter lies with a probability."""
        return self.from_free(ndtri(np.asarray(probability, dtype=np.float64)))

    def log_density(self, value: FloatArray) -> FloatArray:
        """Log density of the parameter in its own unit, within its support."""
        if self.law == "uniform":
            return np.full(np.shape(value), -np.log(self.b - self.a))
        if self.law == "loguniform":
            return np.asarray(-np.log(np.log(self.b / self.a)) - np.log(value))
        if self.law == "cauchy":
            return np.asarray(-np.log(np.pi * self.b) - np.log1p(((value - self.a) / self.b) ** 2))
        scale = self.b * value if self.law == "lognormal" else np.full(np.shape(value), self.b)
        return np.asarray(self.log_density_free(self.to_free(value)) - np.log(scale))

    def log_density_free(self, z: FloatArray) -> FloatArray:
        """Log density of the unbounded parameter (the Jacobian is in it)."""
        # Uniform and loguniform too: their free parameter is the normal quantile of the probability. A logit was tried:
        # its tail is exponential, heavier than that of the t proposals, so that a sharpness that the data only bound
        # from below (a rate too low to resolve the knee) had an autocorrelation time of 170 steps.
        return np.asarray(-0.5 * z**2 - 0.5 * np.log(2 * np.pi))

    def _bounds(self) -> tuple[float, float]:
        return (np.log(self.a), np.log(self.b)) if self.law == "loguniform" else (self.a, self.b)


class Laws(tuple[Prior, ...]):
    """Priors of several parameters, and the space in which each of these is unbounded and standardised."""

    @cached_property
    def spread(self) -> FloatArray:
        """Standard deviations of the normal ones, 0 for others, shape (d,)."""
        return np.array([law.b if law.law == "normal" else 0.0 for law in self])

    @cached_property
    def _normal(self) -> tuple[FloatArray, tuple[int, ...]]:
        """Means of the normal ones, and the places of the others: curves have many of the former."""
        others = tuple(i for i, law in enumerate(self) if law.law != "normal")
        return np.array([0.0 if i in others else law.a for i, law in enumerate(self)]), others

    def natural(self, z: FloatArray) -> FloatArray:
        """Unbounded vectors, shape (..., d), to parameters in natural units; the last ones may be left out.

        They are at their median then.
        """
        if z.shape[-1] < len(self):
            z = np.concatenate([z, np.zeros((*z.shape[:-1], len(self) - z.shape[-1]))], axis=-1)
        mean, others = self._normal
        out = mean + self.spread * z
        for i in others:
            out[..., i] = self[i].from_free(z[..., i])
        return np.asarray(out)

    def unbounded(self, theta: FloatArray) -> FloatArray:
        """Parameters in natural units, shape (m, d), to unbounded vectors."""
        return np.stack([law.to_free(theta[:, i]) for i, law in enumerate(self)], axis=1)

    def log_density(self, z: FloatArray) -> FloatArray:
        """Log density in the unbounded space, shape (m, d) to (m,)."""
        return np.asarray(np.sum([law.log_density_free(z[:, i]) for i, law in enumerate(self)], axis=0))


@dataclass(frozen=True)
class Priors:
    """Priors of one device family."""

    family: str
    statement: str  # what devices it is meant for
    priors: dict[str, Prior]  # by parameter name
    sha256: str  # digest of the file
    # what earlier tests say, by the name of the sampled parameter itself: a ``ratio`` says nothing of ``ratio_3``
    earlier: dict[str, Prior] = field(default_factory=dict)

    def of(self, name: str) -> Prior:
        """Prior of a sampled parameter; ``K_2`` and ``ratio_3`` use the law of ``K`` and ``ratio``.

        A file that holds only the law of one noise scale, ``sigma``, serves for both parts of the noise.
        """
        base, _ = base_and_run(name)
        if name in self.earlier:
            return self.earlier[name]
        if base in self.priors:
            return self.priors[base]
        if base in ("sigma_white", "sigma_slow") and "sigma" in self.priors:
            return replace(self.priors["sigma"], name=base)
        noise = noise_parameters().get(base)
        if noise is not None and noise.prior is not None:
            return Prior(noise.name, noise.unit, *noise.prior)
        raise PriorError(f"priors '{self.family}' hold no law for {name}; add a table [{base}] to the file")


def read_priors(which: str | Path = "afc") -> Priors:
    """Read a shipped prior family by its name (``afc``, ``general``), or the path of a TOML file.

    `PriorError` if the file cannot be read, with the table and value at fault.
    """
    path = Path(which)
    if path.suffix != ".toml":
        names = shipped_families()
        if str(which) not in names:
            raise PriorError(
                f"priors '{which}' do not ship with shj-bayes; choose one of {', '.join(names)}, or name a .toml file"
                f"{did_you_mean(str(which), names)}"
            )
        path = shipped("priors", f"{which}.toml")
    table, digest = read_toml(path, SCHEMA, 1_000_000, PriorError)
    laws = {name: _prior(path.name, name, entry) for name, entry in table.items() if isinstance(entry, dict)}
    if not laws:
        raise PriorError(
            f"{path.name} holds no law; add a table such as [K] for each of {', '.join(base_parameters())}"
        )
    return Priors(str(table.get("family", path.stem)), str(table.get("statement", "")), laws, digest)


def shipped_families() -> list[str]:
    """Names of the prior families that ship with the tool."""
    return sorted(path.stem for path in shipped("priors").glob("*.toml"))


def _prior(file: str, name: str, entry: dict[str, Any]) -> Prior:
    """One table of a prior file."""
    known = base_parameters()
    if name not in known:
        hint = did_you_mean(name, known)
        raise PriorError(f"{file}: [{name}] is not a parameter; known are {', '.join(known)}{hint}")
    law = str(entry.get("law"))
    if law not in LAWS:
        raise PriorError(f"{file}: [{name}] law = {entry.get('law')!r}; choose one of {', '.join(LAWS)}")
    unit = describe(name).unit
    if entry.get("unit") != unit:
        raise PriorError(f"{file}: [{name}] unit = {entry.get('unit')!r}; it must be '{unit}'")
    numbers = []
    for key in LAWS[law]:
        value = entry.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise PriorError(f"{file}: [{name}] {key} = {shown(value)}; a {law} law needs a number there")
        if abs(value) > MAX_NUMBER:  # also keeps out whole numbers that are too long for a double
            raise PriorError(f"{file}: [{name}] {key} = {shown(value, 20)}; at most {MAX_NUMBER:g} in size is allowed")
        numbers.append(float(value))
    if not str(entry.get("source", "")).strip():
        raise PriorError(f"{file}: [{name}] has no source; say in one line where the law comes from")
    if name == "gamma" and not (
        (law in ("normal", "cauchy") and numbers[0] == 0) or (law == "uniform" and numbers[0] == -numbers[1])
    ):
        raise PriorError(
            f"{file}: [gamma] must be symmetric about 0, so that neither sign of speed dependence is favoured"
        )
    if name == "gamma" and numbers[1] > MAX_GAMMA:
        raise PriorError(
            f"{file}: [gamma] {LAWS[law][1]} = {numbers[1]:g} s/mm; at most {MAX_GAMMA:g} is allowed, at which 1 mm/s "
            f"makes the force {1 + MAX_GAMMA:g} times as large"
        )
    try:
        prior = Prior(name, unit, law, numbers[0], numbers[1], str(entry["source"]))
    except PriorError as error:
        raise PriorError(f"{file}: {error}") from error
    low, high = prior.support
    noise = noise_parameters().get(name)
    least, most = noise.bounds if noise else ALLOWED.get(name, (0.0, np.inf))
    if low < least or high > most:
        raise PriorError(
            f"{file}: [{name}] a {law} law from {low:g} to {high:g} leaves the allowed {least:g} to {most:g} {unit}; "
            "use a law that stays inside"
        )
    if law == "lognormal" and numbers[1] > MAX_SPREAD:
        raise PriorError(
            f"{file}: [{name}] spread = {numbers[1]:g}; at most {MAX_SPREAD:g} is allowed, "
            f"a factor of {np.exp(MAX_SPREAD):.0f} either way at one standard deviation"
        )
    return prior
