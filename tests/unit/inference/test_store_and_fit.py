"""A finished fit: is the truth in it, are the files complete, and do they read back as written."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from shj_bayes.inference.problem import Problem

from shj_bayes.errors import InferenceError
from shj_bayes.inference import store
from shj_bayes.inference.convergence import judge
from shj_bayes.inference.fit import CHECKPOINT, Fit, fit, make_problem
from shj_bayes.inference.predictive import add_noise, log_likelihood_of_half_cycles, modelled_force
from shj_bayes.inference.sampler import Plan
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.protocol import Block

Fitted = tuple[Fit, Path]
COLUMNS = ["name", "unit", "mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat"]  # INTERFACE
GROUPS = {
    "posterior", "prior", "posterior_predictive", "prior_predictive", "log_likelihood", "sample_stats",
    "observed_data", "constant_data",
}  # fmt: skip


def test_fit_holds_the_truth(fitted: Fitted, truth: Truth, as_vector: Callable[..., np.ndarray]) -> None:
    result = fitted[0]
    assert result.verdict.word == "reliable", result.verdict.reasons
    values = as_vector(result.problem, truth)[0]
    z = (values - result.summary["mean"]) / result.summary["sd"]
    assert np.abs(z).max() < 4
    assert np.mean(np.abs(z) < 2) >= 0.7


def test_summary_has_the_columns_of_the_interface(fitted: Fitted) -> None:
    result, folder = fitted
    assert list(result.summary.columns) == COLUMNS
    table = pd.read_csv(folder / "summary.csv")
    assert list(table.columns) == [*COLUMNS, "schema"]
    written = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert sorted(written) == ["parameters", "schema"]
    assert [list(row) for row in written["parameters"]] == [COLUMNS] * len(result.problem.layout.names)
    for column in COLUMNS[2:]:
        np.testing.assert_allclose(table[column], result.summary[column], rtol=1e-12)
        np.testing.assert_allclose([row[column] for row in written["parameters"]], result.summary[column], rtol=1e-11)
    assert np.all(np.diff(result.summary[["q05", "q50", "q95"]].to_numpy(), axis=1) > 0)
    assert table["unit"].tolist() == ["kN/mm", "kN", "1", "s/mm", "1", "kN", "1"]


def test_record_says_where_everything_comes_from(fitted: Fitted) -> None:
    result, folder = fitted
    record = store.read_record(folder)
    assert record == json.loads(json.dumps(result.record))
    assert record["schema"] == store.SCHEMA
    assert (record["verdict"], record["reasons"]) == (result.verdict.word, list(result.verdict.reasons))
    assert (record["seed"], record["key"], record["device"]) == (3, "abc", "small")
    assert record["versions"]["emcee"] == "3.1.6" or record["versions"]["emcee"] > "3.1.6"
    assert [entry["name"] for entry in record["inputs"]] == ["simulated-run1", "simulated-run2"]
    assert {law["name"] for law in record["prior_laws"]} == set(result.problem.layout.names)
    assert all(law["source"] for law in record["prior_laws"])
    assert judge(result.figures).word == record["verdict"]


def test_inference_data_groups_and_round_trip(fitted: Fitted) -> None:
    result, folder = fitted
    data, back = result.data, store.read_posterior(folder)
    assert set(data.groups()) == GROUPS
    assert set(back.groups()) == GROUPS
    for group in GROUPS:
        for name, values in data[group].data_vars.items():
            assert np.array_equal(values.to_numpy(), back[group][name].to_numpy()), (group, name)
            assert values.dims == back[group][name].dims
    assert list(back.posterior.data_vars) == list(result.problem.layout.names)
    assert back.posterior.sizes["chain"] == 4
    for name in result.problem.layout.names:
        assert back.posterior[name].attrs["unit"]
        assert back.posterior[name].attrs["meaning"]
    assert back.attrs["schema"] == store.SCHEMA
    record = store.read_record(folder)
    without = {key: value for key, value in record.items() if key not in ("files", "digest")}
    assert json.loads(back.attrs["provenance"]) == without


def test_stored_draws_are_the_posterior_of_the_summary(fitted: Fitted) -> None:
    result = fitted[0]
    for name, mean, sd in result.summary[["name", "mean", "sd"]].itertuples(index=False):
        draws = result.data.posterior[name].to_numpy()
        assert draws.mean() == pytest.approx(mean, abs=0.15 * sd)
        assert draws.std() == pytest.approx(sd, rel=0.15)
    lp = result.data.sample_stats["lp"].to_numpy()
    assert lp.shape == result.data.posterior["K"].shape
    theta = np.stack([result.data.posterior[n].to_numpy()[2, 7] for n in result.problem.layout.names])[None]
    expected = result.problem.log_posterior_free(result.problem.free(theta))[0]
    assert lp[2, 7] == pytest.approx(expected, abs=1e-6)  # draw and density belong together


def test_stored_draws_are_thinned(fitted: Fitted) -> None:
    """Nearly independent draws, `N_STORED` of each ensemble, however long the chain was."""
    result = fitted[0]
    n_draws = result.data.posterior.sizes["draw"]
    assert 0.5 * store.N_STORED <= n_draws <= 1.05 * store.N_STORED


def test_likelihood_per_half_cycle_adds_up(fitted: Fitted) -> None:
    problem = fitted[0].problem
    data = fitted[0].data
    theta = np.stack([data.posterior[n].to_numpy()[:, :3].ravel() for n in problem.layout.names], axis=1)
    parts = log_likelihood_of_half_cycles(problem, theta)
    assert parts.shape == (12, sum(run.motion.n_half for run in problem.runs))
    np.testing.assert_allclose(parts.sum(axis=1), problem.log_likelihood(theta), rtol=1e-11)
    assert data.log_likelihood["force_of_half_cycle"].dims == ("chain", "draw", "half_cycle")
    assert data.log_likelihood["force_of_half_cycle"].shape == (4, store.N_LOOPS, parts.shape[1])


@pytest.mark.parametrize("noise", ["independent", "student"])
def test_likelihood_per_half_cycle_adds_up_for_other_noise(make_small: Callable[..., Problem], noise: str) -> None:
    problem = make_small(noise=noise)
    theta = problem.natural(np.random.default_rng(1).normal(0, 0.5, (4, len(problem.layout.names))))
    parts = log_likelihood_of_half_cycles(problem, theta)
    np.testing.assert_allclose(parts.sum(axis=1), problem.log_likelihood(theta), rtol=1e-11)


def test_predictions_cover_the_data(fitted: Fitted) -> None:
    result = fitted[0]
    measured = result.data.observed_data["force"].to_numpy()
    predicted = result.data.posterior_predictive["force"].to_numpy().reshape(-1, measured.size)
    low, high = np.quantile(predicted, [0.05, 0.95], axis=0)
    inside = np.mean((measured > low) & (measured < high))
    assert 0.8 < inside < 0.97  # 90 % nominal; 100 draws blur the edges
    clean = result.data.posterior_predictive["force_model"].to_numpy().reshape(predicted.shape)
    assert (predicted - clean).std() == pytest.approx(1.0, rel=0.15)  # sigma of the simulated device


def test_noise_is_added_run_by_run(small_device: Problem, as_vector: Callable[..., np.ndarray]) -> None:
    theta = np.repeat(as_vector(small_device), 300, axis=0)
    clean = modelled_force(small_device, theta)
    noise = add_noise(small_device, theta, clean, np.random.default_rng(1)) - clean
    n = small_device.runs[0].recording.n_samples
    lag = [np.corrcoef(noise[:, i], noise[:, i + 1])[0, 1] for i in (n - 2, n - 1, n)]
    assert lag[0] == pytest.approx(0.5, abs=0.2)
    assert abs(lag[1]) < 0.2  # the last sample of run 1 says nothing about the first of run 2
    assert lag[2] == pytest.approx(0.5, abs=0.2)


def test_same_seed_same_numbers_and_a_finished_fit_is_not_repeated(
    fitted: Fitted, make_small: Callable[..., Problem]
) -> None:
    result, folder = fitted
    assert (folder / CHECKPOINT).exists()
    again = fit(make_small(), name="small", key="abc", plan=Plan(seed=3), folder=folder)
    pd.testing.assert_frame_equal(again.summary, result.summary, check_exact=True)
    for group in ("posterior", "posterior_predictive", "prior", "log_likelihood"):
        for name, values in result.data[group].data_vars.items():
            assert np.array_equal(values.to_numpy(), again.data[group][name].to_numpy()), (group, name)


def test_fit_without_a_folder_writes_nothing(
    make_small: Callable[..., Problem], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = fit(make_small(n_runs=1), plan=Plan(seed=1, round_steps=60, max_steps=60))
    assert result.verdict.word != "reliable"
    assert list(tmp_path.iterdir()) == []


def test_problem_from_measured_displacement() -> None:
    """Through the reader's kinematics instead of the exact motion."""
    recordings = simulate_device(Truth(), seed=1, rate_Hz=10.0, blocks=(Block(24.0, 0.067, 3),))
    problem = make_problem(recordings, noise="independent", free=("K",), variant="continuous")
    assert problem.layout.names == ("K", "Fy", "beta", "gamma", "ratio", "K_2", "sigma")
    assert (problem.variant, problem.priors.family) == ("continuous", "afc")
    assert [run.motion.n_half for run in problem.runs] == [7, 7]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "holds no finished fit (no fit.json in it); run shj-bayes fit"),
        ("{", "fit.json is damaged: "),
        ('{"schema": "other/1"}', "has not the schema 'shj-bayes/fit/1'; run the fit again"),
        ("[1]", "has not the schema"),
    ],
)
def test_results_that_cannot_be_read(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / "fit.json").write_text(text, encoding="utf-8")
    with pytest.raises(InferenceError, match=re.escape(message)):
        store.read_record(tmp_path)


@pytest.mark.parametrize("content", [None, b"", b"not a netCDF file at all"])
def test_posteriors_that_cannot_be_read(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "posterior.nc").write_bytes(content)
    with pytest.raises(InferenceError, match=r"posterior\.nc in .* cannot be read .*; run the fit again"):
        store.read_posterior(tmp_path)
