"""Names and runs: which entry of a vector each run of a device uses."""

import re

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.model.parameters import Layout, describe, run_name


@pytest.mark.parametrize(
    ("layout", "names"),
    [
        (Layout(1, "independent"), "K Fy beta gamma sigma"),
        (Layout(2), "K Fy beta gamma ratio sigma phi"),
        (Layout(2, "student"), "K Fy beta gamma ratio sigma phi nu"),
        (Layout(3), "K Fy beta gamma ratio ratio_3 sigma phi"),
        (Layout(2, free=("gamma", "K")), "K Fy beta gamma ratio K_2 gamma_2 sigma phi"),
        (Layout(3, free=("beta",)), "K Fy beta gamma ratio ratio_3 beta_2 beta_3 sigma phi"),
        (Layout(1, free=("K", "beta", "gamma")), "K Fy beta gamma sigma phi"),
    ],
)
def test_names_in_order(layout: Layout, names: str) -> None:
    assert " ".join(layout.names) == names
    assert [p.name for p in layout.parameters] == list(layout.names)
    assert len(set(layout.names)) == len(layout.names)
    assert all(p.unit and p.meaning for p in layout.parameters)


def test_each_run_takes_its_own_entries() -> None:
    layout = Layout(3, free=("K",))
    value = {"K": 10.0, "Fy": 80.0, "beta": 7.0, "gamma": 0.01, "ratio": 0.5, "ratio_3": 0.25}
    value |= {"K_2": 11.0, "K_3": 12.0, "sigma": 1.0, "phi": 0.3}
    theta = np.array([[value[n] for n in layout.names]] * 2)
    assert layout.laws(theta, 1).tolist() == [[10.0, 80.0, 7.0, 0.01]] * 2
    assert layout.laws(theta, 2).tolist() == [[11.0, 40.0, 7.0, 0.01]] * 2
    assert layout.laws(theta, 3).tolist() == [[12.0, 20.0, 7.0, 0.01]] * 2  # ratio_3 is against the FIRST run
    noise = layout.noise_parameters(theta)
    assert {k: v.tolist() for k, v in noise.items()} == {"sigma": [1.0, 1.0], "phi": [0.3, 0.3]}
    assert all(array.flags.c_contiguous for array in (layout.laws(theta, 2), *noise.values()))


def test_run_names_and_descriptions() -> None:
    assert (run_name("ratio", 2), run_name("ratio", 3), run_name("K", 2)) == ("ratio", "ratio_3", "K_2")
    assert describe("K_2").unit == "kN/mm"
    assert describe("K_2").meaning == "initial stiffness, run 2"
    assert describe("ratio_3").meaning == "sliding force of run 3 / first run"


@pytest.mark.parametrize("name", ["dep", "K_x", "", "_2"])
def test_unknown_parameters_are_named(name: str) -> None:
    with pytest.raises(ModelError, match=re.escape(f"'{name}' is not a parameter; known are K, Fy, beta")):
        describe(name)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"n_runs": 0}, "a device has 0 runs; allowed are 1 to 9"),
        ({"n_runs": 10}, "a device has 10 runs"),
        ({"n_runs": 2, "noise": "white"}, "noise model 'white' is not known; choose one of independent, ar1, student"),
        ({"n_runs": 2, "free": ("Fy",)}, "'Fy' cannot be freed between runs; allowed are K, beta, gamma"),
    ],
)
def test_impossible_layouts(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=re.escape(message)):
        Layout(**arguments)
