"""A device with wear through its virtual test: what is read off, what it depends on; no diagnosis makes it unsafe."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from shj_bayes.errors import PopulationError
from shj_bayes.margins.export import loops
from shj_bayes.margins.history import LoadingHistory, depends, from_file, load_cases, sine
from shj_bayes.margins.sheet import pool
from shj_bayes.margins.specimen import Belief, Specimen, drive
from shj_bayes.margins.virtual_test import virtual_tests
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.history import SCALES, histories
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import Tags
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult
from shj_bayes.population.readings import counted_from, of_readings, read_off
from shj_bayes.recording.motion import exact_motion, table_1

LAW = {"K": 15.0, "Fy": 80.0, "beta": 15.0, "gamma": 0.0, "ratio": 0.95}
WEAR, BEDDING = {"wear.size": 0.06}, {"bedding_in.size": 0.2, "bedding_in.length": 0.5}
ALONE_LAW = {"Fy": 71.0, "ratio": 0.76}  # what the law alone makes of such a device
TIME, MOTION = exact_motion(table_1(), 10.0)


def belief(effects, **values):
    model = DeviceModel(2, read_priors(), effects=effects_named(effects))
    told = LAW | values
    rng = np.random.default_rng(3)
    theta = np.array([[told.get(name, 1.0) for name in model.names]] * 16)
    theta[:, model.names.index("Fy")] *= np.exp(0.004 * rng.standard_normal(16))
    return Belief(model, theta)


def specimen(*beliefs, scale=1.0, name="d"):
    tested = histories([TIME] * 2, [MOTION] * 2)
    worn = belief(["wear"], **WEAR)
    rng = np.random.default_rng(4)
    forces = drive(worn.model, worn.typical, tested)
    measured = tuple(scale * f[0] + 0.3 * rng.standard_normal(TIME.size) for f in forces)
    return Specimen(name, "set", beliefs, tested, (0.0, 0.0), measured)


def test_what_is_read_off_a_force_of_known_shape():
    """A force of 50 kN in push and 40 in pull that loses 5 % a metre: cycles and sides by hand."""
    (history,) = histories([TIME], [MOTION])
    lost = 1.0 - 0.05 * history.travel_m
    force = np.where(history.direction > 0, 50.0, -40.0) * lost
    readings = read_off(force[None], MOTION, history.travel_m)
    assert counted_from([readings]) == pytest.approx(6.0)
    found = {name: float(value[0]) for name, value in of_readings(readings, 48.0).items()}
    last = float(lost[MOTION.start[-2] - 1])
    assert found["most"] == pytest.approx(50.0, rel=1e-3)
    assert found["least"] == pytest.approx(40.0 * last, rel=0.01)
    assert found["push"] / found["pull"] == pytest.approx(1.25, rel=0.01)
    assert found["loss_per_m"] == pytest.approx(0.055, abs=0.005)
    assert found["first"] > found["third"] > found["last"]
    assert found["energy"] == pytest.approx(2 * 0.095 * 90 * float(np.mean(lost[MOTION.start[-11] :])), rel=0.02)


def test_only_half_cycles_that_slide_fully_count():
    """2 F / K = 10.7 mm: the middle half of a stroke of 24 mm begins before the device slides, that of 48 mm not."""
    law = belief(())
    (history,) = histories([TIME], [MOTION])
    readings = read_off(drive(law.model, law.typical, [history])[0], MOTION, history.travel_m)
    assert counted_from([readings]) == pytest.approx(24.0)
    with pytest.raises(PopulationError, match="slides fully"):
        of_readings(readings, np.inf)


@pytest.mark.parametrize(
    "beliefs",
    [
        (belief(["wear"], **WEAR), belief((), **ALONE_LAW)),
        (belief((), **ALONE_LAW),),
        (belief(["bedding_in"], **BEDDING, Fy=70.0, ratio=0.74), belief((), **ALONE_LAW)),
    ],
    ids=["rightly", "not", "wrongly"],
)
def test_no_diagnosis_makes_a_bound_less_safe_than_the_recording(beliefs):
    """Run 2 ends at 80 x 0.95 x exp(-0.06 x 6.7) = 51 kN; the product of the parameters with wear would be 76 kN.

    Of 7.6 m travelled 6.7 are slid.
    """
    (trial,) = virtual_tests([specimen(*beliefs)], None)
    measured = min(run["least"][3] for run in trial.table)
    assert measured == pytest.approx(50.8, abs=1.0)
    assert trial.values["lowest"] <= 1.0001 * measured
    assert trial.values["highest"] >= 0.9999 * max(run["most"][3] for run in trial.table)
    assert trial.values["plateau_2"] == pytest.approx(trial.table[1]["plateau"][3], rel=1e-6)


def test_a_wild_draw_of_a_model_makes_no_measured_value_unsure():
    """The recording bounds this device from below; one draw of 16 of a wrong model has half the force."""
    wrong = belief(["bedding_in"], **BEDDING)
    wild = wrong.theta.copy()
    wild[3, wrong.model.names.index("Fy")] *= 0.5
    sure, unsure = (
        virtual_tests([specimen(replace(wrong, theta=theta), belief(()))], None)[0] for theta in (wrong.theta, wild)
    )
    for q in ("least", "least_2", "lowest", "plateau"):
        assert unsure.values[q] == pytest.approx(sure.values[q], rel=2e-3)
        assert unsure.errors[q] == pytest.approx(sure.errors[q], abs=2e-3)
        assert unsure.errors[q] < 0.03  # of all 16 draws the standard deviation is 0.17


def test_the_error_of_the_model_is_seen_and_carried_to_another_history():
    alone = belief((), **ALONE_LAW)
    devices = [specimen(alone, scale=scale, name=f"d{scale}") for scale in (0.95, 1.0, 1.05)]
    (trial, *_) = own = virtual_tests(devices, None)
    assert np.exp(trial.model_errors["least_2"]) < 0.95
    assert trial.cycle_errors.std() > 0.05
    right = virtual_tests([specimen(belief(["wear"], **WEAR), alone)], None)[0]
    assert right.cycle_errors.std() < 0.01
    other = virtual_tests(devices, sine(60.0, 9.0, 3))
    assert all(t.carried for t in other)
    assert not trial.carried
    groups = PopulationResult((DeviceSet("set", tuple(t.name for t in own), Tags(), {}),), {}, {}, {}, {}, 1)
    spread = [float(np.std(pool(t, groups).fit("least_2").mu)) for t in (own, other)]
    assert spread[1] > spread[0]


def test_what_a_model_depends_on_is_found_by_trying():
    history = histories([TIME] * 2, [MOTION] * 2)[1]
    law, worn = belief((), gamma=0.01), belief(["wear"], **WEAR)
    assert [depends(law, history, name) for name in ("speed", "travel", "time")] == [True, False, False]
    assert [depends(worn, history, name) for name in ("speed", "travel", "time")] == [False, True, False]


def test_travel_beyond_the_test_is_refused_where_the_force_depends_on_it():
    long = sine(60.0, 9.0, 40)
    worn = specimen(belief(["wear"], **WEAR), belief((), **ALONE_LAW))
    with pytest.raises(PopulationError, match=r"travel of .* m, which was not tested.*--extrapolate"):
        virtual_tests([worn], long)
    (beyond,) = virtual_tests([worn], long, extrapolate=True)
    (law,) = virtual_tests([specimen(belief((), **ALONE_LAW))], long)
    assert 0 < beyond.values["lowest"] < law.values["lowest"]


def test_another_motion_keeps_the_scales_of_the_devices_own_test():
    """A curve over travel is stated over the travel of the test; a shorter history walks a part of it."""
    device = specimen(belief(["wear"], **WEAR))
    time, motion = exact_motion(table_1()[:1], 10.0)
    for history in LoadingHistory(time, motion, "a part").through(device):
        for name in SCALES:
            assert getattr(history, name) == getattr(device.histories[-1], name), name
        assert history.tested_m > np.ptp(history.travel_m)


def test_bounds_are_taken_over_all_speeds_and_what_is_typical_is_not():
    """Fy 80 kN at rest gains 0.02 s/mm x 10 mm/s = 20 % at the peak of a stroke; the second run has 0.95 of both."""
    law = belief((), gamma=0.02)
    device = replace(specimen(law), measured_kN=())
    (trial,) = virtual_tests([device], None)
    assert trial.values["lowest"] == pytest.approx(0.95 * 80.0, rel=0.01)
    assert trial.values["highest"] == pytest.approx(1.2 * 80.0, rel=0.01)
    assert trial.values["plateau"] == pytest.approx(1.19 * 80.0, rel=0.01)
    assert trial.third_mm_s == pytest.approx(10.0, rel=0.03)
    (slow,) = virtual_tests([device], sine(60.0, 0.1, 3))
    for q in ("lowest", "highest"):
        assert slow.values[q] == pytest.approx(trial.values[q], rel=0.02)
    assert slow.values["plateau"] == pytest.approx(80.0, rel=0.01)
    flat = replace(device, beliefs=(belief(()),))
    assert [case.speed_mm_s for case in load_cases(None, flat, extrapolate=False)] == [None]
    bent = replace(device, beliefs=(belief(["stribeck"], **{"stribeck.size": 0.2, "stribeck.speed": 3.0}),))
    assert len(load_cases(None, bent, extrapolate=False)) == 4  # its least need not be at an end


def test_the_widest_half_cycle_of_an_irregular_history_is_drawn_whole(tmp_path):
    """From -20 to 70 mm is the widest; back it goes to 10 mm only."""
    ends = [0.0, 15.0, -20.0, 70.0, 10.0, 35.0, -5.0, 20.0]
    steps = [np.linspace(a, b, 60, endpoint=False) for a, b in pairwise(ends)]
    x = np.concatenate([*steps, [ends[-1]]])
    time = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x)) / 6.0)])
    path = tmp_path / "quake.csv"
    path.write_text("time,slip\n" + "\n".join(f"{t},{d}" for t, d in zip(time, x, strict=True)), encoding="utf-8")
    trials = virtual_tests([specimen(belief(()))], from_file(path))
    band = loops(trials, 6.0)[0]
    push, pull = (np.isfinite(side[1]) for side in (band.push, band.pull))
    assert (band.displacement_mm[push].min(), band.displacement_mm[push].max()) == pytest.approx((-20.0, 70.0), abs=1.5)
    assert (band.displacement_mm[pull].min(), band.displacement_mm[pull].max()) == pytest.approx((10.0, 70.0), abs=1.5)
    assert band.push[1][push].max() == pytest.approx(80.0, rel=0.01)


def test_devices_that_do_not_depend_on_what_was_not_tested_are_drawn_beside_those_that_do():
    devices = [specimen(belief((), gamma=gamma), name=f"g{gamma}") for gamma in (0.0, 0.01)]
    trials = virtual_tests(devices, sine(60.0, 40.0, 3), extrapolate=True)
    assert [len(trial.laws) for trial in trials] == [1, 3]
    assert [band.law for band in loops(trials, 40.0)] == [law for law in trials[1].laws for _ in (1, 2)]
