"""What the model leaves over: its size, and nothing that the fit and the diagnosis do not say too."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_diagnosis import made
from page_tools import read_old
from scipy.signal import lfilter

from shj_bayes.app.resume import device_text
from shj_bayes.report import words
from shj_bayes.report.numbers import N_STROKE, left_over, stroke_profiles
from shj_bayes.results.device import DeviceData, RunData
from shj_bayes.results.diagnosis import DiagnosisVerdict, Input, LeftOver
from shj_bayes.results.fit import CyclesRecord, FitRecord, Remark, RemarkRecord, Trust
from shj_bayes.results.store import diagnosis_in, find, read, write


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
    return DeviceData(read_old(), draws, draws, (run,))


def test_a_right_model_follows_the_force_and_a_wrong_one_does_not(
    well_specified: DeviceData, misspecified: DeviceData
) -> None:
    right, wrong = left_over(well_specified), left_over(misspecified)
    assert right.grade == "good"
    assert wrong.grade in ("fair", "poor")
    assert wrong.unexplained_percent > 2 * right.unexplained_percent


def test_what_is_unexplained_is_what_neighbouring_samples_share() -> None:
    """White noise of 1 kN is the instruments'; a shape of 8 kN at the ends of the stroke is 4.9 kN, 6.1 % of 80 kN."""
    rng = np.random.default_rng(2)
    assert left_over(toy(rng, phi=0.0)).unexplained_percent < 0.2
    found = left_over(toy(rng, phi=0.0, shape_kN=8.0))
    assert found.unexplained_percent == pytest.approx(100 * 8 * np.sqrt(3 / 8) / 80, rel=0.02)
    assert (found.grade, found.n_cycles) == ("poor", 12)


def test_a_fit_that_a_diagnosis_ended_in_is_told_by_that_one(tmp_path: Path) -> None:
    """As the margins take it, where the folder of the device holds another one too."""
    (tmp_path / "diagnosis").mkdir()
    (tmp_path / "diagnosis" / "diagnosis.json").write_text("{}", encoding="utf-8")
    assert diagnosis_in(tmp_path) == "diagnosis"
    (tmp_path / "diagnosis.json").write_text("{}", encoding="utf-8")
    assert diagnosis_in(tmp_path) == "."


@pytest.mark.parametrize("below", [".", "diagnosis"])
def test_the_page_repeats_the_fit_and_the_diagnosis_and_tests_nothing_itself(tmp_path: Path, below: str) -> None:
    """What the fit found from cycle to cycle and what the diagnosis says of the same files; of others nothing."""
    device = toy(np.random.default_rng(3), phi=0.0)
    record = replace(device.record, cycles=CyclesRecord(widening={"K": 1.0, "Fy": 2.1}))
    device = device._replace(record=record)
    for digest, said in (("", "named"), ("b", "")):
        inputs = (Input(name="run", sha256=digest),) * len(record.inputs)
        (tmp_path / below).mkdir(exist_ok=True)
        write(replace(made("named"), inputs=inputs), tmp_path / below)
        found = left_over(device, tmp_path)
        assert (found.widening, found.diagnosed, found.grade) == (2.1, said, "fair")
        write(found, tmp_path)
        assert find(LeftOver, tmp_path) == found
    assert "cycles scatter more" in words.left_words(found)
    assert "cycles scatter" in words.left_cell(found)


def test_profile_against_hand_calculation() -> None:
    device = toy(np.random.default_rng(6), phi=0.0, shape_kN=10.0)
    push, pull = stroke_profiles(device.runs[0])
    assert push.mean_kN == pytest.approx(10 * (push.centre_mm / 50) ** 2, abs=1.0)
    assert pull.mean_kN == pytest.approx(-10 * (pull.centre_mm / 50) ** 2, abs=1.0)
    # Independent noise: the 90 % band of a mean of m samples is 1.645 / sqrt(m).
    m = 12 * 400 / 2 * np.diff(np.arcsin(np.linspace(-1, 1, N_STROKE + 1)))[10] / np.pi
    assert push.high_kN[10] == pytest.approx(1.645 / np.sqrt(m), rel=0.25)


@pytest.mark.parametrize(
    ("percent", "said"), [(0.724, "0.72 %"), (9.96, "10 %"), (99.6, "100 %"), (4200.0, "more than 100 % of Fy")]
)
def test_a_headline_holds_no_nonsense(percent: float, said: str) -> None:
    assert words.fit_words(LeftOver(percent, 8)).startswith(said)


def test_the_word_of_the_calculation_does_not_stand_alone(tmp_path: Path, fitted: Path) -> None:
    record = replace(read(FitRecord, fitted), verdict=Trust.RELIABLE)
    write(LeftOver(310.0, 9), tmp_path)
    first = device_text(tmp_path, record).splitlines()[0]
    assert first.endswith(": reliable; poor fit: more than 100 % of Fy unexplained")


def test_a_prior_that_the_data_contradict_is_told_with_what_to_do() -> None:
    """No advice to take the priors that were taken, and none on the unit of what has none."""
    far = RemarkRecord(parameter="beta", kind=Remark.AGAINST_PRIOR, q50=1.0, prior_q05=1.36, prior_q95=366.0)
    of_force = replace(far, parameter="Fy")
    told = words.remark(far, "1", family="general")
    assert "--units" not in told
    assert "--priors general" not in told
    assert "Check the units" in words.remark(of_force, "kN", family="afc")
    assert "--priors general" in words.remark(of_force, "kN", family="afc")
    earlier = words.remark(replace(of_force, kind=Remark.AGAINST_EARLIER), "kN", family="afc")
    assert "--priors-from" in earlier
    assert "--priors general" not in earlier


@pytest.mark.parametrize("n_cycles", [2, 8])
@pytest.mark.parametrize("percent", [1.0, 4.0, 33.0, 273.0])
@pytest.mark.parametrize("widening", [1.0, 3.0])
@pytest.mark.parametrize("diagnosed", ["", *DiagnosisVerdict])
def test_badge_sentence_and_table_say_the_same(n_cycles: int, percent: float, widening: float, diagnosed: Any) -> None:
    """Over all verdicts: no green beside a large misfit or scatter, no judgement on two cycles, one diagnosis."""
    found = LeftOver(percent, n_cycles, widening, diagnosed)
    sentence, (name, colour), cell = words.left_words(found), words.FIT[found.grade], words.left_cell(found)
    assert (colour == "reliable") == (name == "good fit") == (n_cycles >= 3 and percent <= 2 and widening == 1)
    assert ("Too few cycles" in sentence) == (n_cycles < 3) == (found.grade == "undecided")
    assert (found.grade == "poor") == (n_cycles >= 3 and percent > 5)
    assert sentence.startswith("The model follows the force") == (found.grade == "good")
    assert words.fit_words(found) in cell
    if n_cycles >= 3:
        assert words.missing_words(found) in sentence
        assert ("scatter more" in sentence) == (found.grade == "fair" and widening > 1)


def test_a_fit_with_given_effects_names_the_diagnosis_that_keeps_them() -> None:
    sentence = words.left_words(LeftOver(4.0, 8), ["slack", "wear"])
    assert sentence.endswith("shj-bayes diagnose --effects slack,wear says.")
    assert "--effects" not in words.left_words(LeftOver(4.0, 8, 1.0, "named"), ["slack"])
