"""The parameters by name, with unit and meaning."""

from functools import cache
from typing import NamedTuple

from shj_bayes.errors import ModelError
from shj_bayes.model.noise import noise_parameters


class Parameter(NamedTuple):
    """One parameter of the law or of the noise."""

    name: str  # name as users see it (docs/glossary.md)
    unit: str  # unit, ``"1"`` where there is none
    meaning: str  # a few plain words


_LAW = (
    Parameter("K", "kN/mm", "initial stiffness"),
    Parameter("Fy", "kN", "sliding force of the first run"),
    Parameter("beta", "1", "sharpness of the knee"),
    Parameter("gamma", "s/mm", "speed coefficient 1/dep; 0 is no dependence on speed"),
    Parameter("ratio", "1", "sliding force of the second run / first run"),
)
LAW_PARAMETERS = {parameter.name: parameter for parameter in _LAW}
SHAREABLE = ("K", "beta", "gamma")


@cache
def base_parameters() -> dict[str, Parameter]:
    """Every parameter of the law and of the noise models by name."""
    return LAW_PARAMETERS | {p.name: Parameter(p.name, p.unit, p.meaning) for p in noise_parameters().values()}


def run_name(name: str, run: int) -> str:
    """Name of a per-run parameter; the second run's ratio is plainly ``ratio``."""
    return "ratio" if name == "ratio" and run == 2 else f"{name}_{run}"


def base_of(name: str) -> str:
    """Give a name, of whatever it is, without the number of a run behind it: K of K_3, ratio of ratio."""
    return name.partition("_")[0]


def base_and_run(name: str) -> tuple[str, int]:
    """Parameter behind a per-run name and its run: K_3 is K of run 3, ratio that of run 2, K that of run 1."""
    known = base_parameters()
    if name in known:
        return name, 2 if name == "ratio" else 1
    base, _, run = name.rpartition("_")
    if base not in known or not run.isdigit():
        raise ModelError(f"'{name}' is not a parameter; known are {', '.join(known)}")
    return base, int(run)


def describe(name: str) -> Parameter:
    """Give unit and meaning of a sampled parameter, also of those with a run number behind them."""
    known = base_parameters()
    if name in known:
        return known[name]
    base, run = base_and_run(name)
    words = f"sliding force of run {run} / first run" if base == "ratio" else f"{known[base].meaning}, run {run}"
    return Parameter(name, known[base].unit, words)
