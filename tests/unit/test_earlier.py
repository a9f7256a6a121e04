"""Yesterday's posterior as today's prior, with a warning where a recording would count twice."""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from shj_bayes._util.files import sealed
from shj_bayes.app.resume import Earlier, earlier
from shj_bayes.errors import PopulationError, PriorError
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.population.hierarchy import ANY_SET, SCHEMA
from shj_bayes.recording.recording import Recording, Source

BANDS = {
    "K": (16.0, 17.0, 18.0),
    "Fy": (78.0, 80.0, 82.0),
    "gamma": (-0.001, 0.001, 0.003),
    "ratio": (0.8, 0.85, 0.9),
}
KNOWN = Earlier("device d", BANDS, "digest", frozenset({"a" * 64}))


def test_laws_have_the_quantiles_of_the_earlier_posterior():
    family = read_priors()
    priors = KNOWN.on(family)
    for name in ("K", "Fy", "gamma", "ratio"):
        found = priors.of(name).quantile(np.array([0.05, 0.5, 0.95]))
        assert found == pytest.approx(BANDS[name], rel=0.01), name
    assert [priors.of(name) for name in ("beta", "sigma_white")] == [
        family.of(name) for name in ("beta", "sigma_white")
    ]
    assert priors.sha256 != family.sha256
    assert DeviceModel(2, priors).laws
    assert "device d" in priors.family


def test_the_ratio_of_the_second_run_says_nothing_of_the_third():
    family = read_priors()
    assert KNOWN.on(family).of("ratio_3") == family.of("ratio_3")
    third = Earlier("device d", BANDS | {"ratio_3": (0.7, 0.75, 0.8)}, "digest", frozenset()).on(family)
    assert third.of("ratio_3").quantile(0.5) == pytest.approx(0.75)
    assert third.of("ratio").quantile(0.5) == pytest.approx(0.85)


def test_a_recording_that_the_prior_rests_on_is_told():
    t = np.arange(100) / 10.0
    mine, other = (Recording(t, np.sin(t), np.cos(t), source=Source("r.csv", d * 64)) for d in "ab")
    warned, silent = KNOWN.remarked([mine, other])
    assert [f.code for f in warned.findings] == ["recording-in-prior"]
    assert warned.findings[0].severity == "warning"
    assert silent.findings == ()


ONE = {"n_devices": 1, "devices": ["a"], "tags": None, "points": {}, "errors": {}, "how_wide": None}
POPULATION = {"schema": SCHEMA, "version": "0", "seed": 1, "converged": True, "quantities": [], "priors": {}}
POPULATION |= {"other_priors": []}


def population_of(folder: Path, bands: Mapping[str, Sequence[float]]) -> None:
    """Write a sealed population of two sets."""
    ends = {q: dict(zip(("q05", "q50", "q95"), band, strict=True)) for q, band in bands.items()}
    sets = [ONE | {"name": name, "new_device": ends} for name in ("Bare", "Zinc 70", ANY_SET)]
    (folder / "population.json").write_text(json.dumps(sealed(POPULATION | {"sets": sets})), encoding="utf-8")


def test_bands_come_from_what_is_sealed(tmp_path: Path):
    population_of(tmp_path, BANDS)
    (tmp_path / "population.csv").write_text(
        "set,n_devices,quantity,unit,q05,q50,q95\nBare,3,Fy,kN,70,80,90\n", encoding="utf-8"
    )
    assert earlier(f"{tmp_path}#Bare").bands == BANDS
    path = tmp_path / "population.json"
    path.write_text(path.read_text(encoding="utf-8").replace("78.0", "70.0"), encoding="utf-8")
    with pytest.raises(PopulationError, match="was altered after it was written"):
        earlier(f"{tmp_path}#Bare")


@pytest.mark.parametrize(
    "band", [(82.0, 80.0, 78.0), (80.0, 80.0, 82.0), (0.0, 80.0, 82.0), (-5.0, 80.0, 82.0), (78.0, 80.0, math.inf)]
)
def test_bands_that_are_none_are_refused(tmp_path: Path, band: tuple[float, ...]):
    population_of(tmp_path, BANDS | {"Fy": band})
    with pytest.raises(PriorError, match=r"Fy of a new device of set Bare has 5, 50 and 95 % at .*; they must be"):
        earlier(f"{tmp_path}#Bare")


@pytest.mark.parametrize(
    "sets", [5, [5], [{}], [{"name": "Bare"}], [ONE | {"name": "Bare", "new_device": {"Fy": "x"}}]]
)
def test_a_population_that_holds_something_else_is_one_line(tmp_path: Path, sets: object):
    (tmp_path / "population.json").write_text(json.dumps(sealed(POPULATION | {"sets": sets})), encoding="utf-8")
    with pytest.raises(
        PopulationError,
        match=r"population\.json in .*: sets.* (lacks|must be) .*; .*run shj-bayes tables or campaign again",
    ):
        earlier(f"{tmp_path}#Bare")


def test_a_set_of_a_campaign_is_chosen_by_name(tmp_path: Path):
    population_of(tmp_path, BANDS)
    assert earlier(f"{tmp_path}#zinc 70").bands == BANDS
    with pytest.raises(PriorError, match="holds several sets; there are Bare, Zinc 70"):
        earlier(str(tmp_path))
    with pytest.raises(PriorError, match="no set 'Zink 70'; there are Bare, Zinc 70; did you mean 'Zinc 70'"):
        earlier(f"{tmp_path}#Zink 70")
    with pytest.raises(PriorError, match="there is no fit and no campaign in it"):
        earlier(str(tmp_path / "none"))
    (tmp_path / "fit.json").write_text("{}", encoding="utf-8")
    with pytest.raises(PriorError, match="the fit of one device and has no sets; leave #Bare out"):
        earlier(f"{tmp_path}#Bare")
