"""The parameters by name, with unit and meaning."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from shj_bayes.errors import ModelError

FloatArray = NDArray[np.float64]


class Parameter(NamedTuple):
    """One parameter of the law or of the noise."""

    name: str  # name as users see it (docs/glossary.md)
    unit: str  # unit, ``"1"`` where there is none
    meaning: str  # a few plain words


def _table(*parameters: Parameter) -> dict[str, Parameter]:
    return {parameter.name: parameter for parameter in parameters}


LAW_PARAMETERS = _table(
    Parameter("K", "kN/mm", "initial stiffness"),
    Parameter("Fy", "kN", "sliding force of the first run"),
    Parameter("beta", "1", "sharpness of the knee"),
    Parameter("gamma", "s/mm", "speed coefficient 1/dep; 0 is no dependence on speed"),
    Parameter("ratio", "1", "sliding force of the second run / first run"),
)
NOISE_PARAMETERS = _table(
    Parameter("sigma_white", "kN", "noise from sample to sample"),
    Parameter("sigma_slow", "kN", "slow part of the noise"),
    Parameter("tau_slow", "s", "correlation time of the slow part"),
    Parameter("sigma", "kN", "noise scale"),
    Parameter("phi", "1", "lag-one noise correlation at the sampling rate"),
    Parameter("nu", "1", "degrees of freedom of the noise (large is Gaussian)"),
)
BASE = LAW_PARAMETERS | NOISE_PARAMETERS
SHAREABLE = ("K", "beta", "gamma")


def run_name(name: str, run: int) -> str:
    """Name of a per-run parameter; the second run's ratio is plainly ``ratio``."""
    return "ratio" if name == "ratio" and run == 2 else f"{name}_{run}"


def base_of(name: str) -> str:
    """Give a name, of whatever it is, without the number of a run behind it: K of K_3, ratio of ratio."""
    return name.partition("_")[0]


def base_and_run(name: str) -> tuple[str, int]:
    """Parameter behind a per-run name and its run: K_3 is K of run 3, ratio that of run 2, K that of run 1."""
    if name in BASE:
        return name, 2 if name == "ratio" else 1
    base, _, run = name.rpartition("_")
    if base not in BASE or not run.isdigit():
        raise ModelError(f"'{name}' is not a parameter; known are {', '.join(BASE)}")
    return base, int(run)


def describe(name: str) -> Parameter:
    """Give unit and meaning of a sampled parameter, also of those with a run number behind them."""
    if name in BASE:
        return BASE[name]
    base, run = base_and_run(name)
    words = f"sliding force of run {run} / first run" if base == "ratio" else f"{BASE[base].meaning}, run {run}"
    return Parameter(name, BASE[base].unit, words)
