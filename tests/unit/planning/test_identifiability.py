"""What is said of a device before it is sampled, held against the fit and against what is known of its protocol."""

import numpy as np
import pytest

from shj_bayes.bench.work import answer_words
from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.planning.identifiability import Doubt, Identifiability, first_answer
from shj_bayes.recording.motion import Block

TRUTH = Truth(K=18.0, Fy=80.0, beta=10.0, gamma=0.01, sigma=0.6)
SMALL = Truth(K=0.018, Fy=0.08, beta=10.0, sigma=0.0006)
ONE_SPEED = tuple(Block(a, 10.0 / (2 * np.pi * a), 3) for a in (12.0, 24.0))
SEVERAL = tuple(Block(24.0, v / (2 * np.pi * 24.0), 2) for v in (2.0, 10.0, 30.0))


def said_of(blocks: tuple[Block, ...], truth: Truth = TRUTH, rate_Hz: float = 8.0) -> Identifiability:
    """Record of one run of a simulated device."""
    runs = runs_of(simulate_device(truth, seed=2, rate_Hz=rate_Hz, n_runs=1, blocks=blocks))
    return first_answer(runs, DeviceModel(1, read_priors()), threads=1)[0]


@pytest.fixture(scope="module")
def plain() -> Identifiability:
    return said_of(ONE_SPEED)


def test_the_widths_are_those_of_the_fit(plain: Identifiability) -> None:
    runs = runs_of(simulate_device(TRUTH, seed=2, rate_Hz=8.0, n_runs=1, blocks=ONE_SPEED))
    plan = SamplingPlan(1, max_steps=1500, threads=1)
    fitted = {row.name: row for row in fit(runs, DeviceModel(1, read_priors()), plan=plan).record.parameters}
    for row in plain.parameters:
        if row.name in ("K", "Fy", "gamma"):
            assert row.sd == pytest.approx(fitted[row.name].sd, rel=0.25)
            assert abs(row.mean - fitted[row.name].mean) < 0.5 * row.sd


def test_what_a_protocol_cannot_tell_is_told_by_another(plain: Identifiability) -> None:
    """At one period the acceleration is a multiple of the displacement; at one peak speed the speed is one of place."""
    one_period = said_of((Block(24.0, 10.0 / (2 * np.pi * 24.0), 6),))
    several = said_of(SEVERAL)
    pair = ("inertia", "restoring")
    assert pair in [one.pair for one in one_period.confusions]
    assert pair not in [one.pair for one in several.confusions]
    assert all(row["test"] and row["first"] and row["second"] for row in answer_words(one_period, "afc")["confusions"])
    assert plain.one_speed_mm_s == pytest.approx(10.0, rel=0.05)
    assert any("same peak speed" in line for line in answer_words(plain, "afc")["lines"])
    assert several.one_speed_mm_s is None


def test_widths_shrink_with_the_test_and_the_plateau_is_foretold(plain: Identifiability) -> None:
    longer = said_of((*ONE_SPEED, *ONE_SPEED, *ONE_SPEED, *ONE_SPEED))
    of = lambda said: {row.name: row.sd for row in said.parameters}  # noqa: E731
    assert of(longer)["Fy"] < 0.8 * of(plain)["Fy"]
    assert all(0.0 < row.narrowed <= 1.0 for row in plain.parameters)
    assert plain.least_kN is not None
    assert plain.least_sd_kN is not None
    # The plateau is Fy with the speed part of mid-stroke; it is known at least about as well as Fy.
    assert 80.0 < plain.least_kN < 90.0
    assert plain.least_sd_kN < 2.0 * of(plain)["Fy"]


def test_no_sliding_is_a_doubt_and_few_readings_are_told() -> None:
    elastic = said_of((Block(1.0, 0.2, 6),))
    assert elastic.doubts == (Doubt.NEVER_SLIDES,)
    assert "prior" in answer_words(elastic, "afc")["reasons"][0]
    assert elastic.least_kN is None
    no_top = answer_words(Identifiability(doubts=(Doubt.NO_TOP,)), "afc")
    assert (no_top["rows"], no_top["headline"]) == ([], "")
    assert "columns" in no_top["reasons"][0]
    slow, fast = said_of(ONE_SPEED, rate_Hz=40.0), said_of(ONE_SPEED, rate_Hz=1.5)
    assert not slow.few_readings
    assert fast.few_readings
    assert any("higher rate" in line for line in answer_words(fast, "afc")["lines"])


def test_rows_have_units_and_forces_of_small_devices_are_in_newtons(plain: Identifiability) -> None:
    rows = {row["name"]: row for row in answer_words(plain, "afc")["rows"]}
    assert (rows["Fy"]["unit"], rows["K"]["unit"], rows["beta"]["unit"]) == ("kN", "kN/mm", "")
    runs = runs_of(simulate_device(SMALL, seed=2, rate_Hz=8.0, n_runs=1, blocks=ONE_SPEED))
    small = first_answer(runs, DeviceModel(1, read_priors("general")), threads=1)[0]
    assert {row["name"]: row["unit"] for row in answer_words(small, "general")["rows"]}["Fy"] == "N"
