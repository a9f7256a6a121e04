"""Results of an earlier version still open and can be shown; `tests/fixtures/make_old_results.py` made them."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from shj_bayes.api import load
from shj_bayes.errors import ShjError
from shj_bayes.model.priors import LAWS
from shj_bayes.population import device
from shj_bayes.population.device import device_from_fit
from shj_bayes.report.device import render_device
from shj_bayes.results import device as device_file
from shj_bayes.results import store as store_file
from shj_bayes.results.fit import FitRecord

OLD = Path(__file__).resolve().parents[1] / "fixtures" / "fit-0.1"


@pytest.fixture
def old(tmp_path):
    return Path(shutil.copytree(OLD, tmp_path / "old"))


def test_it_is_an_old_one():
    record = json.loads((OLD / "fit.json").read_text(encoding="utf-8"))
    assert record["schema"] == "shj-bayes/fit/1"
    assert not {"digest", "files"} & set(record)


def test_it_opens_pools_and_reports(old):
    record = store_file.read(FitRecord, old)
    store_file.check_files(old, record)
    assert set(device_file.read_group(old, "posterior")) >= {row.name for row in record.parameters}
    assert device_from_fit(old, "old device", "set").name == "old device"
    page = render_device(old).read_text(encoding="utf-8")
    assert "old device" in page
    assert record.model.variant == "seed"
    assert "variant “published”" in page
    for row in record.parameters:
        assert row.name in page


def test_a_damaged_posterior_is_told_in_one_line(old):
    (old / "posterior.nc").write_bytes(b"not a netCDF file at all")
    with pytest.raises(ShjError, match=r"posterior\.nc in .* cannot be read .*; run the fit again"):
        _ = load(old).data


@pytest.mark.parametrize("key", ["parameters", "inputs", "sampling", "model", "prior_laws"])
def test_what_it_lacks_is_said(old, key):
    record = json.loads((old / "fit.json").read_text(encoding="utf-8"))
    for change in ({}, [], [{"name": "K"}], {"x": 1}):
        (old / "fit.json").write_text(json.dumps(record | {key: change}), encoding="utf-8")
        with pytest.raises(ShjError, match=r"fit\.json .*run (shj-bayes fit|the command) again"):
            (device_from_fit(old, "old", "set") if key == "prior_laws" else render_device(old))


@pytest.mark.parametrize(
    ("name", "law"),
    [*(("Fy", law) for law in LAWS), ("gamma", "normal"), ("gamma", "cauchy"), ("gamma", "uniform")],
)
def test_a_fit_under_any_law_of_a_prior_can_be_pooled(old, monkeypatch, name, law):
    a, b = (50.0, 150.0) if name == "Fy" else (0.001, 0.1)
    b = 0.5 if law == "lognormal" else b
    record = json.loads((old / "fit.json").read_text(encoding="utf-8"))
    entry = next(entry for entry in record["prior_laws"] if entry["name"] == name)
    entry.update(law=law, a=a, b=b)
    (old / "fit.json").write_text(json.dumps(record), encoding="utf-8")
    densities = {}
    monkeypatch.setattr(device, "of_draws", lambda q, _, density: densities.update({q: density}))
    device_from_fit(old, "old", "set")
    draws = device_file.read_group(old, "posterior")[name].ravel()
    known = {
        "normal": stats.norm(a, b), "cauchy": stats.cauchy(a, b), "lognormal": stats.lognorm(b, scale=a),
        "uniform": stats.uniform(a, b - a), "loguniform": stats.loguniform(a, b),
    }[law]  # fmt: skip
    inside = np.isfinite(known.logpdf(draws))
    pooled = known.logpdf(draws) + (np.log(draws) if name == "Fy" else 0.0)  # Fy is pooled as its logarithm
    assert inside.any()
    assert densities[name][inside] == pytest.approx(pooled[inside])
