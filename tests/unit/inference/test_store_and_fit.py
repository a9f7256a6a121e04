"""A finished fit: is the truth in it, are the files complete, do they read back as written, do ArviZ's tools work?"""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from shj_bayes._util.imports import arviz
from shj_bayes.errors import InferenceError
from shj_bayes.inference import store
from shj_bayes.inference.convergence import FitVerdict, Widening, judge
from shj_bayes.inference.fit import CHECKPOINT, Fit, evenly_spread, fit, weights_of_all_samples, with_widening
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.predictive import draw_noise, force_at_points, points_of
from shj_bayes.inference.sampler import LIBRARY, SamplingPlan, run_ensembles
from shj_bayes.inference.start import find_start, polish
from shj_bayes.model.device import effects_named
from shj_bayes.model.filter import Timing, log_density, simulate
from shj_bayes.model.simulate import Truth
from shj_bayes.results import device as device_file
from shj_bayes.results import store as store_file
from shj_bayes.results.codec import to_json
from shj_bayes.results.device import read_device
from shj_bayes.results.fit import SCHEMA, FitRecord, Trust
from shj_bayes.results.store import read

Fitted = tuple[Fit, Path]
COLUMNS = ["name", "unit", "mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat"]
GROUPS = {
    "posterior", "prior", "posterior_predictive", "prior_predictive", "log_likelihood", "log_prior", "sample_stats",
    "observed_data", "constant_data", "loops",
}  # fmt: skip
az = arviz()
OLD_ARVIZ = az.__version__.startswith("0.")
FORCE = "force_of_half_cycle"


def test_fit_holds_the_truth(fitted: Fitted, truth: Truth, as_vector: Callable[..., np.ndarray]) -> None:
    result = fitted[0]
    assert result.verdict.word == "reliable", result.verdict.reasons
    values = as_vector(result.likelihood, truth)[0]
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
    assert [list(row) for row in written["parameters"]] == [COLUMNS] * len(result.likelihood.model.names)
    for column in COLUMNS[2:]:
        np.testing.assert_allclose(table[column], result.summary[column], rtol=1e-12)
        np.testing.assert_allclose([row[column] for row in written["parameters"]], result.summary[column], rtol=1e-11)
    assert np.all(np.diff(result.summary[["q05", "q50", "q95"]].to_numpy(), axis=1) > 0)
    assert table["unit"].tolist() == ["kN/mm", "kN", "1", "s/mm", "1", "kN", "kN", "s"]


def test_record_says_where_everything_comes_from(fitted: Fitted) -> None:
    result, folder = fitted
    record = store_file.read(FitRecord, folder)
    assert record == result.record
    assert record.schema == SCHEMA
    assert record.verdict == result.verdict.word == judge(result.figures).word
    assert record.reasons == result.verdict.reasons
    assert (record.seed, record.key, record.device) == (3, "abc", "small")
    assert {name: record.versions[name] for name in store.PACKAGES} == {n: version(n) for n in store.PACKAGES}
    assert [entry.name for entry in record.inputs] == ["simulated-run1", "simulated-run2"]
    assert [law.name for law in record.prior_laws] == list(result.likelihood.model.names)
    assert all(law.source for law in record.prior_laws)


def test_groups_read_back_as_they_were_made(fitted: Fitted) -> None:
    result, folder = fitted
    data = result.data
    with xr.open_datatree(folder / "posterior.nc", engine="h5netcdf") as stored:
        back = stored.load()
    assert set(data.children) == set(back.children) == GROUPS
    for group in GROUPS:
        for name, values in data[group].variables.items():
            read = back[group].variables[name]
            assert np.array_equal(values.to_numpy(), read.to_numpy()), (group, name)
            assert (values.dims, values.dtype, values.attrs) == (read.dims, read.dtype, read.attrs), (group, name)
            assert read.attrs["units"], (group, name)
            assert read.attrs["meaning"], (group, name)
        assert back[group].attrs["inference_library"] == LIBRARY
        assert {"meaning", "inference_library_version", "creation_library_version"} <= set(back[group].attrs)
    assert list(back["posterior"].data_vars) == list(result.likelihood.model.names)
    assert back["posterior"].sizes["chain"] == 4
    assert back.attrs["schema"] == SCHEMA
    record = store_file.read(FitRecord, folder)
    without = {key: value for key, value in to_json(record).items() if key not in ("files", "digest")}
    assert json.loads(back.attrs["provenance"]) == without
    for group in ("posterior", "constant_data"):
        for name, array in device_file.read_group(folder, group).items():
            assert np.array_equal(array, back[group][name].to_numpy()), name


def test_stored_draws_are_the_posterior_of_the_summary(fitted: Fitted) -> None:
    result = fitted[0]
    for name, mean, sd in result.summary[["name", "mean", "sd"]].itertuples(index=False):
        draws = result.data["posterior"][name].to_numpy()
        assert draws.mean() == pytest.approx(mean, abs=0.15 * sd)
        assert draws.std() == pytest.approx(sd, rel=0.15)


def test_draws_and_densities_belong_together(fitted: Fitted) -> None:
    """Where no interval was widened, the density of a stored draw is the one that was stored for it."""
    result = fitted[0]
    posterior, data = result.likelihood, result.data
    assert not result.widening.widened
    theta = np.stack([data["posterior"][n].to_numpy()[2, :5] for n in posterior.model.names], axis=1)
    lp = data["sample_stats"]["lp"].to_numpy()
    assert lp.shape == data["posterior"]["K"].shape
    z = posterior.model.laws.unbounded(theta)
    np.testing.assert_allclose(lp[2, :5], posterior.log_posterior_free(z), atol=1e-6)
    parts = data["log_likelihood"][FORCE].to_numpy()[2, :5]
    np.testing.assert_allclose(parts, posterior.log_likelihood_by_half_cycle(theta), atol=1e-6)
    # The prior in natural units has the factor dz / d theta that the one of the unbounded parameters has not.
    step = 1e-6
    natural = posterior.model.laws.natural
    factor = np.log(step / (natural(z + step / 2) - natural(z - step / 2))).sum(axis=1)
    total = sum(data["log_prior"][n].to_numpy()[2, :5] for n in posterior.model.names)
    np.testing.assert_allclose(total, posterior.model.laws.log_density(z) + factor, atol=1e-5)


def test_one_observable_in_all_groups(fitted: Fitted) -> None:
    """Mean force of each half-cycle in the direction of motion, for all draws, under one name."""
    result = fitted[0]
    data, n_draws = result.data, result.data["posterior"].sizes["draw"]
    assert 0.5 * store.N_STORED <= n_draws <= 1.05 * store.N_STORED
    n = sum(run.motion.n_half for run in result.likelihood.runs)
    assert data["observed_data"][FORCE].dims == ("half_cycle",)
    for group in ("posterior_predictive", "log_likelihood"):
        assert data[group][FORCE].shape == (4, n_draws, n)
    for group in ("observed_data", "posterior_predictive", "prior_predictive", "log_likelihood"):
        values = data[group][FORCE]
        assert values.dims[-1] == "half_cycle"
        assert values["run"].to_numpy().tolist() == [1] * (n // 2) + [2] * (n // 2)
        assert values["number"].to_numpy().tolist() == [*range(n // 2)] * 2
    measured = data["observed_data"][FORCE].to_numpy()
    run = result.likelihood.runs[1]
    own = run.used & (run.motion.half_cycle == 3)
    expected = run.motion.direction[3] * run.recording.force_kN[own].mean()
    assert measured[n // 2 + 3] == pytest.approx(expected, rel=1e-12)
    predicted = data["posterior_predictive"][FORCE].to_numpy().reshape(-1, n)
    assert np.abs((measured - predicted.mean(axis=0)) / predicted.std(axis=0)).max() < 4


def test_half_cycles_without_evidence_are_left_out(make_small: Callable[..., Likelihood]) -> None:
    small = make_small(n_runs=1)
    run = small.runs[0]
    some = replace(run.recording, used=run.used & (run.motion.half_cycle != 2))
    result = fit([replace(run, recording=some)], small.model, plan=SamplingPlan(seed=1, round_steps=60, max_steps=60))
    number = result.data["observed_data"]["number"].to_numpy().tolist()
    assert number == [k for k in range(run.motion.n_half) if k != 2]
    for group in ("observed_data", "posterior_predictive", "log_likelihood"):
        assert np.isfinite(result.data[group][FORCE]).all()


def test_means_are_those_of_all_samples(make_small: Callable[..., Likelihood], monkeypatch: pytest.MonkeyPatch) -> None:
    """At 0.04 standard deviations by chance, as each has 4000 draws and more; averages alone are 0.2 and more off."""
    posterior, start = find_start(make_small(rate_Hz=50.0, n_runs=1))
    states, figures = run_ensembles(posterior, posterior.model.names, start, SamplingPlan(seed=3))
    draws = np.stack([state.chain[figures.n_burn :].reshape(-1, start.free.size) for state in states])
    weights, tail = weights_of_all_samples(posterior, start, draws)
    assert tail < 0.5
    chosen = np.take_along_axis(draws, evenly_spread(weights)[:, :, None], axis=1)
    whole = posterior.refined(start.free, longest_s=0.0)
    states, figures = run_ensembles(whole, whole.model.names, polish(whole, [start.free]), SamplingPlan(seed=4))
    right = np.concatenate([state.chain[figures.n_burn :].reshape(-1, start.free.size) for state in states])
    law = slice(posterior.model.n_law)
    before, after = (
        np.abs(some.mean(axis=(0, 1)) - right.mean(axis=0))[law] / right.std(axis=0)[law] for some in (draws, chosen)
    )
    assert before.max() > 0.15
    assert after.max() < 0.08


def test_weights_follow_a_long_tail(make_small: Callable[..., Likelihood], truth: Truth) -> None:
    """Of a knee that the rate hardly resolves, where the log ratio of the likelihoods is no parabola."""
    posterior, start = find_start(make_small(replace(truth, beta=60.0), rate_Hz=20.0, n_runs=1))
    states, figures = run_ensembles(posterior, posterior.model.names, start, SamplingPlan(seed=3))
    draws = np.stack([state.chain[figures.n_burn :].reshape(-1, start.free.size) for state in states])
    some = draws.reshape(-1, start.free.size)[::10]
    smooth = np.log(weights_of_all_samples(posterior, start, draws)[0].ravel()[::10])
    some[:, posterior.model.n_law :] = start.free[posterior.model.n_law :]
    fine = posterior.refined(start.free, longest_s=0.0)
    exact = fine.log_posterior_free(some) - posterior.log_posterior_free(some)
    assert np.std(exact) > 0.15
    assert np.std(exact - smooth) < 0.012


def test_samples_that_contradict_their_averages_weigh_nothing(make_small: Callable[..., Likelihood]) -> None:
    """Hum that the averages do not see tells nothing of the law; one draw that carries all weight is told."""
    small = make_small(rate_Hz=50.0, n_runs=1)
    run = small.runs[0]
    hum = 8.0 * np.sin(2.0 * np.pi * 16.3 * run.recording.time_s)
    loud = replace(run, recording=replace(run.recording, force_kN=run.recording.force_kN + hum))
    rng, moved = np.random.default_rng(1), []
    for one in (run, loud):
        posterior, start = find_start(make_likelihood([one], small.model))
        draws = start.free + rng.standard_normal((4, 500, start.free.size)) @ np.linalg.cholesky(start.covariance).T
        weights = weights_of_all_samples(posterior, start, draws)[0]
        moved.append(np.std(np.log(weights)))
    assert moved[1] < 0.6 * moved[0]
    widening = Widening(small.model.names, np.ones(len(small.model.names)), np.ones(len(small.model.names)), 0)
    verdict = FitVerdict(Trust.RELIABLE, ("they agree",))
    assert with_widening(verdict, widening, 0.2) == verdict
    assert with_widening(verdict, widening, 0.9).word == Trust.TENTATIVE
    assert "Pareto k 0.90" in with_widening(verdict, widening, 0.9).reasons[1]


@pytest.mark.parametrize("noise", ["slow", "ar1", "independent", "student"])
def test_noise_of_averages_is_that_of_samples_averaged(make_small: Callable[..., Likelihood], noise: str) -> None:
    """Spread of half-cycle means, and what neighbours share, against series drawn sample by sample."""
    small = make_small(noise=noise, n_runs=1, rate_Hz=50.0)
    run, part = small.runs[0], small.blocks[0]
    assert part.n < 0.8 * run.recording.n_samples
    own = {"sigma_white": 0.8, "sigma_slow": 0.6, "tau_slow": 1.0, "sigma": 1.0, "phi": 0.9, "nu": 200.0}
    values = {name: np.full(4000, own[name]) for name in small.model.noise.parameters}
    rng = np.random.default_rng(1)
    drawn = draw_noise(small.model.noise, values, np.zeros((4000, part.n)), part.timing, rng)
    first = part.timing.half[:-1]
    blocks = np.add.reduceat(drawn * part.count, first, axis=1) / np.add.reduceat(part.count, first)
    one = {name: float(v[0]) for name, v in values.items()}
    half = [(run.motion.half_cycle == k) & run.used for k in range(run.motion.n_half)]
    series = [simulate(small.model.noise, one, run.recording.time_s, run.recording.restarts, rng) for _ in range(1500)]
    samples = np.array([[s[k].mean() for k in half] for s in series])
    np.testing.assert_allclose(blocks.std(axis=0), samples.std(axis=0), rtol=0.12)
    shared = [np.corrcoef(means[:, 3], means[:, 4])[0, 1] for means in (blocks, samples)]
    assert shared[0] == pytest.approx(shared[1], abs=0.1)


def test_noise_at_low_speed_is_stated_and_drawn(
    make_small: Callable[..., Likelihood], fitted: tuple[Fit, Path]
) -> None:
    """Draws at the points of a recording scatter as the noise at each speed does: 2.97 +- 0.022 over 30 seeds."""
    result, folder = fitted
    stated = read(FitRecord, folder).noise_at_rest
    assert stated == pytest.approx(np.exp(result.likelihood.at_rest))
    small = make_small(noise="independent", n_runs=1).with_noise_at_rest(np.log(3.0))
    theta = np.tile(small.model.laws.natural(np.zeros((1, len(small.model.names)))), (4000, 1))
    points = tuple(points_of(run, 10_000) for run in small.runs)
    clean, noisy = force_at_points(small, theta, points, np.random.default_rng(2))
    scatter = (noisy - clean - (noisy - clean).mean(axis=1, keepdims=True)).std(axis=0)
    history = small.histories[0]
    fast, slow = (history.speed_mm_s > history.peak_speed_mm_s), (history.speed_mm_s < 0.02 * history.peak_speed_mm_s)
    assert scatter[slow].mean() / scatter[fast].mean() == pytest.approx(3.0, rel=0.04)


@pytest.mark.parametrize("noise", ["slow", "student"])
def test_noise_is_drawn_from_the_density_of_the_likelihood(make_small: Callable[..., Likelihood], noise: str) -> None:
    """No other error of displacement or turning points, and no other tails, suit the draws better than their own."""
    small = make_small(noise=noise, n_runs=1, rate_Hz=20.0)
    own = {"sigma_white": 0.5, "sigma_slow": 0.3, "tau_slow": 1.0, "nu": 4.0}
    values = {name: np.full(1000, own[name]) for name in small.model.noise.parameters}
    part = small.blocks[0]
    known = replace(part.timing, displacement_noise_mm=0.1, turning_noise_mm=np.full(part.timing.half.size - 1, 0.02))
    slope = np.repeat(np.linspace(0.0, 18.0, part.n)[None], 1000, axis=0)
    drawn = draw_noise(small.model.noise, values, slope, known, np.random.default_rng(1))

    def mean(change: Callable[[Timing], Timing] = lambda timing: timing, **other: float) -> float:
        told = values | {name: np.full(1000, value) for name, value in other.items()}
        return float(log_density(small.model.noise, told, drawn, slope, change(known)).sum(axis=1).mean())

    best = mean()
    for factor in (0.7, 1.4):
        assert mean(lambda t, f=factor: replace(t, displacement_noise_mm=0.1 * f)) < best
        assert mean(lambda t, f=factor: replace(t, turning_noise_mm=t.turning_noise_mm * f)) < best
        for name in values:
            assert mean(**{name: own[name] * factor}) < best, name


def test_noise_at_points_is_drawn_run_by_run(
    make_small: Callable[..., Likelihood], as_vector: Callable[..., np.ndarray]
) -> None:
    small = make_small(noise="ar1")
    at = small.model.names.index("phi"), small.model.names.index("sigma")
    theta = np.repeat(as_vector(small), 400, axis=0)
    theta[:, at[0]], theta[:, at[1]] = 0.6, 1.0
    n = small.runs[0].recording.n_samples
    for every in (1, 3):
        points = tuple(np.arange(0, n, every) for _ in small.runs)
        if every > 1:
            points = tuple(
                np.union1d(keep, run.motion.start[:-1]) for keep, run in zip(points, small.runs, strict=True)
            )
        clean, noisy = force_at_points(small, theta, points, np.random.default_rng(1))
        noise, m = noisy - clean, points[0].size
        assert noise.std() == pytest.approx(1.0, rel=0.03)
        gap = points[0][-1] - points[0][-2]  # the correlation is per recorded sample, whatever is left out between
        lag = [np.corrcoef(noise[:, i], noise[:, i + 1])[0, 1] for i in (m - 2, m - 1)]
        assert lag[0] == pytest.approx(0.6**gap, abs=0.15)
        assert abs(lag[1]) < 0.15  # the last sample of run 1 says nothing about the first of run 2
        runs = zip(small.runs, small.histories, strict=True)
        whole = np.concatenate([small.model.force(theta[:1], h, run.start_force_kN)[0] for run, h in runs])
        keep = np.concatenate([points[0], points[1] + n])
        np.testing.assert_allclose(clean[0], whole[keep], rtol=1e-9, atol=1e-9)


def test_long_recordings_are_thinned_to_points_that_keep_every_half_cycle(
    make_small: Callable[..., Likelihood],
) -> None:
    small = make_small()
    run = small.runs[0]
    assert np.array_equal(points_of(run, 10_000), np.arange(run.recording.n_samples))
    keep = points_of(run, 100)
    assert keep.size <= 101
    assert set(run.motion.start[:-1]) <= set(keep)
    assert np.diff(keep).max() <= np.ceil(run.recording.n_samples / (100 - run.motion.n_half))


def test_the_page_reads_the_thinned_file(
    make_small: Callable[..., Likelihood], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "N_POINTS", 80)
    small = make_small()
    result = fit(small.runs, small.model, plan=SamplingPlan(seed=1, round_steps=60, max_steps=60), folder=tmp_path)
    device = read_device(tmp_path)
    for run, own in zip(device.runs, small.runs, strict=True):
        keep = points_of(own, 80)
        assert run.time_s.size == keep.size < own.recording.n_samples / 2
        assert np.array_equal(run.force_kN, own.recording.force_kN[keep])
        assert np.array_equal(run.half_cycle[run.starts], np.arange(own.motion.n_half))
        assert run.law_kN.shape == run.predicted_kN.shape == (4 * store.N_LOOPS, keep.size)
        left = (run.force_kN - run.law_kN.mean(axis=0))[run.used]
        noise = (run.predicted_kN - run.law_kN)[:, run.used]
        assert left.std() == pytest.approx(noise.std(), rel=0.25)
    assert set(device.draws) == set(small.model.names) == set(device.prior)
    assert result.data["loops"].sizes["draw"] == store.N_LOOPS


def test_predictions_cover_the_data(fitted: Fitted) -> None:
    result = fitted[0]
    measured = result.data["constant_data"]["force"].to_numpy()
    predicted = result.data["loops"]["force"].to_numpy().reshape(-1, measured.size)
    low, high = np.quantile(predicted, [0.05, 0.95], axis=0)
    inside = np.mean((measured > low) & (measured < high))
    assert 0.8 < inside < 0.97  # 90 % nominal; 100 draws blur the edges
    clean = result.data["loops"]["force_model"].to_numpy().reshape(predicted.shape)
    assert (predicted - clean).std() == pytest.approx(1.0, rel=0.15)  # white 0.8 and slow 0.6 kN


@pytest.fixture(scope="module")
def with_slack(fitted: Fitted, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fit of the same recordings with an effect that the device has not."""
    folder, posterior = tmp_path_factory.mktemp("slack"), fitted[0].likelihood
    model = posterior.model.with_effects(effects_named(["slack"]))
    fit(posterior.runs, model, name="slack", plan=SamplingPlan(seed=3, max_steps=80), folder=folder)
    return folder


@pytest.mark.filterwarnings(
    "ignore:The inplace keyword in DataFrame.sort_values:Warning",  # ArviZ with pandas and matplotlib newer than it
    "ignore:Passing a dict or None as alias_mapping:Warning",
    "ignore:Estimated shape parameter of Pareto:UserWarning",  # of the model with slack, near its limit
)
def test_what_arviz_offers_works_on_the_file(fitted: Fitted, with_slack: Path) -> None:
    mpl.use("Agg")
    result, folder = fitted
    data, other = (az.from_netcdf(str(f / "posterior.nc"), engine="h5netcdf") for f in (folder, with_slack))
    names = list(result.likelihood.model.names)
    table = az.summary(data, round_to=10)
    assert list(table.index) == names
    np.testing.assert_allclose(table["mean"], [result.data["posterior"][n].mean() for n in names], rtol=1e-6)
    for group in GROUPS:
        drawn = "draw" in result.data[group].sizes
        own = {} if drawn else {"combined": False} | ({} if OLD_ARVIZ else {"sample_dims": []})
        got = az.extract(data, group=group, keep_dataset=True, **own)
        assert set(got.data_vars) == set(result.data[group].data_vars), group
        assert ("sample" in got.sizes) == drawn, group  # recordings have no draws to stack

    loo = az.loo(data, pointwise=True)
    n_half = result.data["observed_data"].sizes["half_cycle"]
    assert loo.n_data_points == n_half
    assert 3 < loo["p_loo" if OLD_ARVIZ else "p"] < 16  # eight parameters
    assert (loo.pareto_k < 0.7).mean() > 0.9
    ranks = az.compare({"base": data, "slack": other})
    assert set(ranks.index) == {"base", "slack"}
    assert ranks.loc["base", "elpd_diff"] < 2 + 2 * ranks["dse"].max()  # the device has no slack
    pit = np.asarray(az.loo_pit(data, y=FORCE) if OLD_ARVIZ else az.loo_pit(data)[FORCE])
    assert pit.shape == (n_half,)
    assert 0.15 < np.median(pit) < 0.85
    if OLD_ARVIZ:
        assert az.plot_ppc(data).lines
        assert az.plot_ppc(data, group="prior").lines
        assert az.plot_loo_pit(data, y=FORCE).lines
        prior, likelihood = (az.psens(data, component=part) for part in ("prior", "likelihood"))
    else:
        az.plot_ppc_dist(data)
        az.plot_loo_pit(data)
        of_both = az.psense_summary(data)
        prior, likelihood = of_both["prior"], of_both["likelihood"]
    for name in ("K", "Fy"):  # told by the data, not by the prior
        assert float(prior[name]) < 0.02 < float(likelihood[name])


def test_same_seed_same_numbers_and_a_finished_fit_is_not_repeated(fitted: Fitted) -> None:
    result, folder = fitted
    assert (folder / CHECKPOINT).exists()
    again = fit(
        result.likelihood.runs,
        result.likelihood.model,
        name="small",
        key="abc",
        plan=SamplingPlan(seed=3),
        folder=folder,
    )
    pd.testing.assert_frame_equal(again.summary, result.summary, check_exact=True)
    for group in GROUPS:
        for name, values in result.data[group].data_vars.items():
            assert np.array_equal(values.to_numpy(), again.data[group][name].to_numpy()), (group, name)


def test_fit_without_a_folder_writes_nothing(
    make_small: Callable[..., Likelihood], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    small = make_small(n_runs=1)
    result = fit(small.runs, small.model, plan=SamplingPlan(seed=1, round_steps=60, max_steps=60))
    assert result.verdict.word != "reliable"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "holds no fit.json; run shj-bayes fit first"),
        ("{", "fit.json is damaged: "),
        ('{"schema": "other/1"}', "has none of the schemas shj-bayes/fit/1, shj-bayes/fit/2; restore it, or run shj"),
        ("[1]", "has none of the schemas"),
    ],
)
def test_results_that_cannot_be_read(tmp_path: Path, text: str | None, message: str) -> None:
    if text is not None:
        (tmp_path / "fit.json").write_text(text, encoding="utf-8")
    with pytest.raises(InferenceError, match=re.escape(message)):
        store_file.read(FitRecord, tmp_path)


@pytest.mark.parametrize("content", [None, b"", b"not a netCDF file at all"])
def test_posteriors_that_cannot_be_read(tmp_path: Path, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / "posterior.nc").write_bytes(content)
    with pytest.raises(InferenceError, match=r"posterior\.nc in .* cannot be read .*; run the fit again"):
        device_file.read_group(tmp_path, "posterior")
