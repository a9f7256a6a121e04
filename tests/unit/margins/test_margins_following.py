"""Devices whose force follows the bolt tension, in histories that say nothing of it: limits over what was seen."""

from collections.abc import Sequence

import numpy as np
import pytest

from shj_bayes.margins.export import Bound, python_script, tcl_script
from shj_bayes.margins.history import channel_words, left_out_words, load_cases, measured_channels, sine, values_to_try
from shj_bayes.margins.specimen import Belief, Specimen, drive
from shj_bayes.margins.virtual_test import virtual_tests
from shj_bayes.model.curve import Curve
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.history import Measured, histories
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import exact_motion, table_1

TIME, MOTION = exact_motion(table_1(), 10.0)
CURVE = Curve("capacity", "measured_tension", 0.5)
LAW = {"K": 15.0, "Fy": 80.0, "beta": 15.0, "gamma": 0.0}
TENSION = 45.0 + 5.0 * np.sin(TIME / 60.0)
MEASURED = {"measured_tension": Measured("kN", TIME, TENSION, 40.0, 50.0, 46.0)}


def belief(effects: list[str], coefficients: Sequence[float] = ()) -> Belief:
    model = DeviceModel(1, read_priors(), effects=effects_named(effects))
    told = LAW | {f"{CURVE.id}.c{i}": float(c) for i, c in enumerate(coefficients, start=1)}
    rng = np.random.default_rng(3)
    theta = np.array([[told.get(name, 1.0) for name in model.names]] * 16)
    theta[:, model.names.index("Fy")] *= np.exp(0.004 * rng.standard_normal(16))
    return Belief(model, theta)


def rising(slope: float) -> np.ndarray:
    """Coefficients of a curve that rises by `slope` of Fy from one end of the range to the other."""
    share = np.linspace(0.0, 1.0, 41)
    return np.linalg.lstsq(CURVE.rows(share, np.ones(41)), slope * (share - 0.5), rcond=None)[0]


@pytest.fixture(scope="module")
def specimen() -> Specimen:
    tested = histories([TIME], [MOTION], [MEASURED])
    found = belief([CURVE.id], rising(0.2))
    measured = drive(found.model, found.typical, tested)[0][0]
    return Specimen("d", "set", (found, belief([])), tested, (0.0,), (measured,))


def test_what_is_followed_is_found_with_its_range(specimen: Specimen) -> None:
    (one,) = measured_channels(specimen)
    assert (one.coordinate, one.unit) == ("measured_tension", "kN")
    assert (one.low, one.reference, one.high) == (40.0, 46.0, 50.0)
    assert one.weakest == pytest.approx(40.0, abs=0.5)
    assert one.strongest == pytest.approx(50.0, abs=0.5)
    tried = [at["measured_tension"] for at in values_to_try(specimen)]
    assert tried == [one.reference, one.weakest, one.strongest]


def test_limits_of_another_history_are_the_outermost_over_the_recorded_range(specimen: Specimen) -> None:
    asked = sine(90.0, 9.0, 3)
    (trial,) = virtual_tests([specimen], asked)
    # 80 kN at mid-range: 72 at 40 kN of tension, 88 at 50.
    assert trial.values["lowest"] == pytest.approx(72.0, rel=0.02)
    assert trial.values["highest"] == pytest.approx(88.0, rel=0.02)
    assert 80.0 < trial.values["plateau"] < 83.0  # at the median, 46 kN
    assert trial.laws == ("tested",)
    assert trial.channels == measured_channels(specimen)
    # A history is driven at three values; that of the test at those that were measured.
    cases = load_cases(asked, specimen, extrapolate=False)
    assert [case.speed_mm_s for case in cases].count(None) == 3
    own, *_ = load_cases(None, specimen, extrapolate=False).values()
    assert own is specimen.histories


def test_a_device_that_follows_nothing_is_driven_once() -> None:
    tested = histories([TIME], [MOTION], [MEASURED])
    plain = Specimen("d", "set", (belief([]),), tested, (0.0,))
    assert measured_channels(plain) == ()
    assert len(load_cases(sine(60.0, 9.0, 3), plain, extrapolate=False)) == 1


def test_the_designer_is_told(specimen: Specimen) -> None:
    found = [measured_channels(specimen), ()]
    (asked,) = channel_words(found, own_test=False)
    assert "1 of 2 devices follows the measured tension" in asked
    assert "median of each test (typically 46)" in asked
    assert "40 to 50 kN" in asked
    assert "those of the tests, 40 to 50 kN" in channel_words(found, own_test=True)[0]
    assert channel_words([(), ()], own_test=True) == ()
    bound = Bound("set", "lower", 15.0, 70.0, 15.0, 1.0, 0.5, 3)
    for script in (
        python_script([bound], 60.0, "a", left_out_words(found)),
        tcl_script([bound], "a", left_out_words(found)),
    ):
        assert (
            "# - Not carried, that the force follows the measured tension. The bounds are those of tests at 40"
            in script
        )
