"""The numbers that the page's script draws: bounded, thinned honestly, and the samples themselves."""

import json
from pathlib import Path

import numpy as np
import pytest
from made_diagnosis import write

from shj_bayes.report import browse as viewer
from shj_bayes.report.numbers import numbers_of
from shj_bayes.report.page import LOOPS, policy, script
from shj_bayes.results.device import DeviceData, read_diagnosis


def test_every_number_is_a_sample_to_within_half_a_step(well_specified: DeviceData) -> None:
    made = viewer.device_viewer(well_specified, numbers_of(well_specified))
    for run, shown in zip(well_specified.runs, made["runs"], strict=True):
        assert shown["every"] == 1
        assert np.array(shown["x"]) * made["scale"]["x"] == pytest.approx(
            run.displacement_mm, abs=0.51 * made["scale"]["x"]
        )
        assert np.array(shown["measured"]) * made["scale"]["force"] == pytest.approx(
            run.force_kN, abs=0.51 * made["scale"]["force"]
        )
        assert made["scale"]["force"] < 0.001 * np.ptp(run.force_kN)
    assert viewer.thinning_words(made) == "Every sample of the calculation is here."


def test_long_runs_are_thinned_keep_their_turning_points_and_say_so(
    well_specified: DeviceData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer, "MAX_POINTS", 400)
    made = viewer.device_viewer(well_specified, numbers_of(well_specified))
    for run, shown in zip(well_specified.runs, made["runs"], strict=True):
        assert len(shown["t"]) <= 400 // len(well_specified.runs) + run.reversals.size + 1
        turning = np.round(run.displacement_mm[run.reversals] / made["scale"]["x"])
        assert set(turning.astype(int)) <= set(shown["x"])
        assert shown["cycles"] == sorted(set(shown["cycles"]))
        assert 0 <= shown["cycles"][0] < shown["cycles"][-1] <= len(shown["t"])
    assert "and every turning point is here; the calculation used them all" in viewer.thinning_words(made)


def test_the_cycle_shown_first_is_a_large_closed_one(well_specified: DeviceData) -> None:
    made = viewer.device_viewer(well_specified, numbers_of(well_specified))
    run, at = made["runs"][0], made["cycle"]
    x = np.array(run["x"])[run["cycles"][at] : run["cycles"][at + 1]]
    assert np.ptp(x) > 0.95 * np.ptp(run["x"])
    assert abs(x[-1] - x[0]) < 0.15 * np.ptp(x)


def test_samples_that_are_no_numbers_are_left_out(well_specified: DeviceData) -> None:
    first = well_specified.runs[0]
    force = first.force_kN.copy()
    force[5] = np.nan
    numbers = numbers_of(well_specified)
    broken = well_specified._replace(runs=(first._replace(force_kN=force), *well_specified.runs[1:]))
    made = viewer.device_viewer(broken, numbers)
    assert len(made["runs"][0]["t"]) == first.time_s.size - 1
    json.dumps(made, allow_nan=False)


@pytest.mark.parametrize("verdict", ["named", "adequate"])
def test_a_diagnosis_has_after_only_when_something_was_found(tmp_path: Path, verdict: str) -> None:
    made = viewer.diagnosis_viewer(read_diagnosis(write(tmp_path, verdict, "device")))
    assert [run["name"] for run in made["runs"]] == ["run 1", "run 2"]
    assert all(("after" in run) == (verdict == "named") for run in made["runs"])
    assert bool(made["names"]["after"]) == (verdict == "named")


def test_scripts_are_small_and_hold_nothing_that_ends_them_early() -> None:
    text = script(LOOPS)
    assert len(text.encode("utf-8")) < 22_000
    assert "</" not in text
    assert "<!--" not in text
    assert not any(word in text for word in ("fetch(", "XMLHttpRequest", "eval(", "innerHTML", "http"))
    assert policy(text) != policy(script(("sheet",)))
