"""Structured or not: quiet on what the model describes, loud on what it does not, and never fooled by correlation."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from shj_bayes.report import words
from shj_bayes.report.binned import stroke_profiles
from shj_bayes.report.data import DeviceData, RunData
from shj_bayes.report.residual_file import read_residual, write_residual
from shj_bayes.report.residuals import repeat_p, structure


def toy(rng: np.random.Generator, *, phi: float, shape_kN: float = 0.0, fitted_phi: float | None = None) -> DeviceData:
    """A device whose law is zero: AR(1) noise of 1 kN, and a shape in step with the cycles."""
    rate, n_cycles, per_cycle = 20.0, 12, 400
    n = n_cycles * per_cycle
    time = np.arange(n) / rate
    phase = 2 * np.pi * np.arange(n) / per_cycle
    x = 50 * np.sin(phase)
    half = np.floor((phase + np.pi / 2) / np.pi).astype(np.int64)
    model = phi if fitted_phi is None else fitted_phi

    def noise(m: int, correlation: float) -> np.ndarray:
        z = rng.standard_normal((m, n)) * np.sqrt(1 - correlation**2)
        z[:, 0] /= np.sqrt(1 - correlation**2)
        return np.asarray(lfilter([1.0], [1.0, -correlation], z, axis=1))

    force = noise(1, phi)[0] + shape_kN * (x / 50) ** 2 * np.sign(np.cos(phase))
    law = np.zeros((60, n))
    run = RunData(1, time, x, np.abs(np.gradient(x, time)), force, np.ones(n, bool), half, law, noise(60, model))
    draws = {"Fy": np.full((4, 10), 80.0), "phi": np.full((4, 10), model)}
    return DeviceData({"device": "toy"}, draws, draws, (run,))


def test_well_specified_is_not_flagged(well_specified: DeviceData) -> None:
    found = structure(well_specified)
    assert not found.structured, found
    assert words.residual_headline(found) == "Nothing beyond noise is seen in the residuals."


def test_misspecified_is_flagged(misspecified: DeviceData) -> None:
    found = structure(misspecified)
    assert found.structured
    text = words.residual_headline(found)
    assert "leaves something out" in text
    assert "% of the sliding force" in text


def test_a_list_of_devices_repeats_what_was_found_and_reads_no_sentence(
    tmp_path: Path, misspecified: DeviceData
) -> None:
    found = structure(misspecified)
    write_residual(tmp_path, found)
    record = json.loads((tmp_path / "residual.json").read_text(encoding="utf-8"))
    changed = record | {"statement": "Nothing beyond noise: it is all well."}
    (tmp_path / "residual.json").write_text(json.dumps(changed), encoding="utf-8")
    left = read_residual(tmp_path)
    assert left is not None
    assert left.structured
    assert left.cell == words.in_a_cell(found)


@pytest.mark.parametrize("phi", [0.0, 0.8, 0.95])
def test_false_alarms_are_rare(phi: float) -> None:
    """About 3 in 100 by calibration over 250 devices each; more than 10 in 100 here would be a fault."""
    rng = np.random.default_rng(17)
    assert sum(structure(toy(rng, phi=phi)).seen for _ in range(40)) <= 4


def test_shape_is_found_and_placed() -> None:
    found = structure(toy(np.random.default_rng(2), phi=0.8, shape_kN=3.0))
    assert found.seen
    assert found.largest.where == "near the end of the stroke"
    assert abs(found.largest.mean_kN) == pytest.approx(2.7, abs=0.8)
    assert found.largest.share == pytest.approx(abs(found.largest.mean_kN) / 80)


def test_noise_model_that_swallowed_the_shape_is_named() -> None:
    """Correlation time 5 s in cycles of 20 s: the noise band is so wide that nothing leaves it; yet shape returns."""
    device = toy(np.random.default_rng(3), phi=0.8, shape_kN=1.5, fitted_phi=0.99)
    found = structure(device)
    assert found.absorbed
    assert found.p_repeat is not None
    assert found.p_repeat < 0.01
    assert any("the noise model has absorbed misfit" in line for line in words.residual_details(found))
    assert "noise term has taken up" in words.band_words(found)


def test_too_few_cycles_say_so(fitted_short: DeviceData) -> None:
    assert repeat_p(fitted_short) is None
    assert any("too few" in line for line in words.residual_details(structure(fitted_short)))


@pytest.fixture
def fitted_short() -> DeviceData:
    device = toy(np.random.default_rng(5), phi=0.5)
    run = device.runs[0]
    keep = slice(0, 400 * 5)
    short = RunData(
        1, run.time_s[keep], run.displacement_mm[keep], run.speed_mm_s[keep], run.force_kN[keep], run.used[keep],
        run.half_cycle[keep], run.law_kN[:, keep], run.predicted_kN[:, keep],
    )  # fmt: skip
    return DeviceData(device.record, device.draws, device.prior, (short,))


def test_profile_against_hand_calculation() -> None:
    device = toy(np.random.default_rng(6), phi=0.0, shape_kN=10.0)
    push, pull = stroke_profiles(device.runs[0], n_bins=10)
    assert push.direction == 1
    assert push.mean_kN == pytest.approx(10 * (push.centre_mm / 50) ** 2, abs=1.0)
    assert pull.mean_kN == pytest.approx(-10 * (pull.centre_mm / 50) ** 2, abs=1.0)
    # Independent noise: the 90 % band of a mean of m samples is 1.645 / sqrt(m).
    m = 12 * 400 / 2 * np.diff(np.arcsin(np.linspace(-1, 1, 11)))[5] / np.pi
    assert push.high_kN[5] == pytest.approx(1.645 / np.sqrt(m), rel=0.25)


@pytest.mark.parametrize("p_noise", [0.5, 0.001])
@pytest.mark.parametrize("n_cycles", [2, 8])
@pytest.mark.parametrize("percent", [1.0, 4.0, 33.0, 273.0])
@pytest.mark.parametrize("memory_s", [0.0, 9.0])
def test_badge_headline_and_table_say_the_same(
    well_specified: DeviceData, p_noise: float, n_cycles: int, percent: float, memory_s: float
) -> None:
    """Over all verdicts: no green beside a structure or a large misfit, no judgement on two cycles."""
    found = replace(
        structure(well_specified),
        p_noise=p_noise,
        p_repeat=None,
        n_cycles=n_cycles,
        unexplained_percent=percent,
        memory_s=memory_s,
        typical_cycle_s=10.0,
    )
    headline, colour = words.residual_headline(found), words.FIT[found.grade][1]
    cell = words.in_a_cell(found)
    assert cell in headline or cell == "nothing beyond noise"
    nothing = headline.startswith("Nothing beyond noise")
    assert nothing == (found.grade == "good") == (colour == "reliable") == (cell == "nothing beyond noise")
    assert nothing == (p_noise > 0.01 and n_cycles >= 3 and percent <= 5 and memory_s == 0)
    assert ("Too few cycles" in headline) == (n_cycles < 3) == (found.grade == "undecided")
    assert (found.grade == "poor") == (n_cycles >= 3 and percent > 5)
