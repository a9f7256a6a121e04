"""The parameters by name: what is sampled, what each run of a device uses, and in which unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shj_bayes.errors import ModelError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Parameter:
    """One parameter of the law or of the noise.

    Parameters
    ----------
    name : str
        Name as users see it (see INTERFACE, Words).
    unit : str
        Unit, ``"1"`` where there is none.
    meaning : str
        A few plain words.
    """

    name: str
    unit: str
    meaning: str


BASE = {
    p.name: p
    for p in (
        Parameter("K", "kN/mm", "initial stiffness"),
        Parameter("Fy", "kN", "sliding force of the first run"),
        Parameter("beta", "1", "sharpness of the knee"),
        Parameter("gamma", "s/mm", "speed coefficient 1/dep; 0 is no dependence on speed"),
        Parameter("ratio", "1", "sliding force of the second run / first run"),
        Parameter("sigma", "kN", "noise scale"),
        Parameter("phi", "1", "lag-one noise correlation at the sampling rate"),
        Parameter("nu", "1", "degrees of freedom of the noise (large is Gaussian)"),
    )
}
SHAREABLE = ("K", "beta", "gamma")
NOISE_PARAMETERS = {"independent": ("sigma",), "ar1": ("sigma", "phi"), "student": ("sigma", "phi", "nu")}


@dataclass(frozen=True)
class Layout:
    """Which parameters are sampled for a device, in order, and how each run uses them.

    Parameters
    ----------
    n_runs : int
        Consecutive runs of the device, 1 to 9.
    noise : {"independent", "ar1", "student"}
        Noise model.
    free : tuple of str
        Those of K, beta, gamma that each run has for itself (``K_2`` for the second run);
        the others are shared by all runs.
    """

    n_runs: int
    noise: str = "ar1"
    free: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse layouts that name unknown things."""
        if not 1 <= self.n_runs <= 9:
            raise ModelError(f"a device has {self.n_runs} runs; allowed are 1 to 9 consecutive runs")
        if self.noise not in NOISE_PARAMETERS:
            raise ModelError(f"noise model '{self.noise}' is not known; choose one of {', '.join(NOISE_PARAMETERS)}")
        wrong = [name for name in self.free if name not in SHAREABLE]
        if wrong:
            raise ModelError(f"'{wrong[0]}' cannot be freed between runs; allowed are {', '.join(SHAREABLE)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters in order: law, ratios, freed parameters, noise."""
        runs = range(2, self.n_runs + 1)
        ratios = tuple(run_name("ratio", run) for run in runs)
        freed = tuple(f"{name}_{run}" for run in runs for name in SHAREABLE if name in self.free)
        return ("K", "Fy", "beta", "gamma", *ratios, *freed, *NOISE_PARAMETERS[self.noise])

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Sampled parameters with unit and meaning."""
        return tuple(describe(name) for name in self.names)

    def index(self, name: str) -> int:
        """Position of a parameter in a vector."""
        return self.names.index(name)

    def laws(self, theta: FloatArray, run: int) -> FloatArray:
        """Law parameters that one run uses.

        Parameters
        ----------
        theta : array, shape (m, len(names))
            Parameter sets in natural units.
        run : int
            Run number, 1 for the first.

        Returns
        -------
        array, shape (m, 4)
            K (kN/mm), Fy of that run (kN), beta, gamma (s/mm).
        """
        columns = [
            theta[:, self.index(f"{name}_{run}" if run > 1 and name in self.free else name)] for name in SHAREABLE
        ]
        capacity = theta[:, self.index("Fy")]
        if run > 1:
            capacity = capacity * theta[:, self.index(run_name("ratio", run))]
        return np.ascontiguousarray(np.stack([columns[0], capacity, columns[1], columns[2]], axis=1))

    def noise_parameters(self, theta: FloatArray) -> dict[str, FloatArray]:
        """Noise parameters by name, each of shape (m,)."""
        return {name: np.ascontiguousarray(theta[:, self.index(name)]) for name in NOISE_PARAMETERS[self.noise]}


def run_name(name: str, run: int) -> str:
    """Name of a per-run parameter; the second run's ratio is plainly ``ratio``."""
    return "ratio" if name == "ratio" and run == 2 else f"{name}_{run}"


def describe(name: str) -> Parameter:
    """Give unit and meaning of a sampled parameter, also of those with a run number behind them."""
    base, _, run = name.partition("_")
    if base not in BASE or (run and not run.isdigit()):
        raise ModelError(f"'{name}' is not a parameter; known are {', '.join(BASE)}")
    parameter = BASE[base]
    if not run:
        return parameter
    words = f"sliding force of run {run} / first run" if base == "ratio" else f"{parameter.meaning}, run {run}"
    return Parameter(name, parameter.unit, words)
