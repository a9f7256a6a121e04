"""Withheld answers against canned diagnoses: agreement and disagreement are found, and no answer is copied."""

import json

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from made_diagnosis import made
from scipy.io import savemat

from shj_bayes.cli import main
from shj_bayes.errors import ProofError
from shj_bayes.model.device import effect_named
from shj_bayes.results.codec import to_json
from shj_validation.proof import pool, real
from shj_validation.proof.answers import CASES, band_of, clamping_changes
from shj_validation.proof.real import prove_recordings

BY_ID = {case.id: case for case in CASES}


def diagnosis(verdict="named", where=(), fy_kN=0.02, gamma=0.0, heldout=0.5, **effects):
    """A diagnosis with what the comparisons read."""
    base = to_json(made("named"))

    def spread(value):
        return {"mean": value, "sd": 0.0, "q05": value, "q50": value, "q95": value}

    found = [
        base["effects"][0]
        | {
            "id": k,
            "size_kN": fy_kN * abs(values["size"]),
            "parameters": {n: spread(v) | {"unit": "1"} for n, v in values.items()},
        }
        for k, values in effects.items()
    ]
    law = {"K": 10.0, "beta": 20.0, "Fy": fy_kN, "gamma": gamma}
    return base | {
        "verdict": verdict,
        "effects": found,
        "location": [base["location"][0] | {"coordinate": name} for name in where],
        "modelled": effects,
        "shift": {name: {"before": spread(value), "after": spread(value)} for name, value in law.items()},
        "after": base["after"] | {"heldout_rmse_kN": heldout},
    }


@pytest.fixture
def band(tmp_path):
    """A band actuator that is moved from 4 to 9 s; the force while pushing goes from 2000 to 2600 lb."""
    time = np.linspace(0, 15, 1501)
    moved = (time > 4) & (time < 9)
    pushing = np.sin(2 * np.pi * time) > 0
    path = tmp_path / "band.csv"
    pd.DataFrame(
        {
            "Time (s)": time,
            "Displacement (in)": -np.cos(2 * np.pi * time),
            "Band position 1 (in)": 0.655 - 0.03 * moved,
            "Band force 1 (lb)": np.where(pushing, 40.0, 1400.0),
            "Band force 2 (lb)": np.where(pushing, np.where(moved, 2600.0, 2000.0), 40.0),
        }
    ).to_csv(path, index=False)
    return path


def test_a_change_of_clamping_is_compared_in_time_and_size(band):
    step = {"size": 0.15, "begin": 4 / 15, "length": 5 / 15, "side": 1.0}
    judged = BY_ID["brfd step"].judge(diagnosis(tension_step=step), band, {})
    assert [one.agrees for one in judged] == [True, True, True]
    assert "from 4.0 to 9.0 s (band force push +30 %, pull +0 %)" in judged[0].words
    late = BY_ID["brfd step"].judge(diagnosis(tension_step=step | {"begin": 0.8}), band, {})
    assert not late[0].agrees
    weak = BY_ID["brfd step"].judge(diagnosis(tension_step=step | {"size": -0.15}), band, {})
    assert [one.agrees for one in weak] == [True, False, True]


def test_a_change_of_clamping_without_a_name_is_compared_by_its_curves(band):
    """Pinned to 0 at the beginning, so that the level in between is anywhere: what counts is inside against outside.

    Where an end of the band does not pull its curve may be anywhere, too.
    """
    at = np.linspace(0.0, 15.0, 61)
    loaded = np.where(at < 1.0, 0.0, -20.0)
    curves = {"push": np.where((at > 4.2) & (at < 9.3), 4.0, loaded), "pull": loaded.copy()}
    for side, idle in (("push", 0.75), ("pull", 0.25)):
        curves[side][at % 1.0 == idle] = -60.0
    rows = [
        {"action": "capacity", "coordinate": "time", "direction": side, "period": None}
        | {"curve": {"at": at.tolist(), "mean": mean.tolist()}}
        for side, mean in curves.items()
    ]
    judged = BY_ID["brfd step"].judge(diagnosis() | {"coordinates": rows}, band, {})
    assert [one.agrees for one in judged] == [True, True, True]
    assert "diagnosed from 4.1 to 9.4 s" in judged[0].words
    pull_alone = BY_ID["brfd step"].judge(diagnosis() | {"coordinates": rows[1:]}, band, {})
    assert not pull_alone[0].agrees


def test_a_change_of_clamping_is_drawn_beside_what_was_withheld(band):
    step = {"size": 0.15, "begin": 4 / 15, "length": 5 / 15, "side": 0.6}
    changes = clamping_changes(diagnosis(tension_step=step), known := band_of(band))
    for side, size, measured in (("push", 0.24, 0.3), ("pull", 0.06, 0.0)):
        at, change = changes[side]
        assert np.median(change[known.inside(at)]) == pytest.approx(size)
        assert np.abs(change[(at < 3.9) | (at > 9.1)]).max() == 0.0
        at, change = known.change[side]
        assert np.median(change[known.inside(at)]) == pytest.approx(measured)


def test_no_change_of_clamping_differs(band):
    assert [one.agrees for one in BY_ID["brfd step"].judge(diagnosis(), band, {})] == [False]


def test_pressure_is_compared_as_a_constant_force(tmp_path):
    path = tmp_path / "seal.txt"
    pd.DataFrame(np.full((50, 7), 1.0)).to_csv(path, sep="\t", header=False, index=False)
    near = diagnosis(load_offset={"size": 2.5})
    assert [one.agrees for one in BY_ID["seal KDN_1bar"].judge(near, path, {})] == [True]
    far = diagnosis(load_offset={"size": 1.0})
    judged = BY_ID["seal KDN_1bar"].judge(far, path, {})
    assert "pushes with 49.1 N; diagnosed constant 20.0 N" in judged[0].words
    assert not judged[0].agrees


@pytest.fixture
def axis(tmp_path):
    """An axis that swings by 100 mm to either side, at 100 mm/s in the mean."""
    time = np.linspace(0, 8, 4001)
    path = tmp_path / "emps.mat"
    swing = np.sin(np.pi * time / 2)
    savemat(path, {"t": time, "qm": 0.1 * swing, "vir": np.sign(np.gradient(swing)), "gtau": 1.0})
    return path


def test_published_friction_and_mass_are_compared(axis):
    own = diagnosis(fy_kN=0.0204, gamma=203.5 / 20.4 / 1000, inertia={"size": 96.0}, load_offset={"size": -3.16 / 20.4})
    judged = BY_ID["emps"].judge(own, axis, {})
    assert all(one.agrees is True for one in judged)  # as JSON has it, not as numpy has it
    assert [one.agrees for one in BY_ID["emps"].judge(diagnosis(), axis, {})] == [True, False, False, False]


def test_a_curve_is_friction_too(axis):
    """Where no formula follows it the law may lie anywhere: here it is 10 % low, and a curve makes up for it."""
    own = diagnosis(fy_kN=0.0204 / 1.1, gamma=203.5 / 20.4 / 1000, inertia={"size": 95.0})
    alone = BY_ID["emps"].judge(own, axis, {})
    name = "capacity_over_speed_50_20"
    first, *rest = effect_named(name).names

    def coulomb_N(size):
        modelled = own["modelled"] | {name: {first: size} | dict.fromkeys(rest, 0.0)}
        return float(BY_ID["emps"].judge(own | {"modelled": modelled}, axis, {})[0].words.split()[-2])

    assert alone[0].words.endswith("Coulomb 18.5 N")
    assert abs(coulomb_N(0.5) - 18.5) > 0.5
    assert coulomb_N(1.0) - 18.5 == pytest.approx(2.0 * (coulomb_N(0.5) - 18.5), abs=0.2)


def test_growth_from_cycle_to_cycle_is_compared(tmp_path):
    growing = diagnosis(bedding_in={"size": 0.1}, asymmetry={"size": 0.1})
    assert [one.agrees for one in BY_ID["friction of KDN_1bar"].judge(growing, tmp_path, {})] == [False]
    assert [one.agrees for one in BY_ID["friction of O-ring_7bar"].judge(growing, tmp_path, {})] == [True]
    judged = BY_ID["friction of O-ring_7bar"].judge(diagnosis(asymmetry={"size": 0.1}), tmp_path, {})
    assert [one.words for one in judged] == ["the force grows from cycle to cycle; no slow change was found"]
    assert not judged[0].agrees


def test_push_and_pull_are_compared_with_the_loop(tmp_path):
    """Levels of 12 and 8 kN: push is 20 % off the mean, by an asymmetry, by an offset, or by both."""
    time = np.linspace(0, 10, 2001)
    path = tmp_path / "loop.csv"
    force = np.where(np.cos(2 * np.pi * time / 2) > 0, 12.0, -8.0)
    columns = {"time_s": time, "displacement_mm": 25 * np.sin(2 * np.pi * time / 2) + 3, "force_kN": force}
    pd.DataFrame(columns).to_csv(path, index=False)
    judge = BY_ID["brfd ds2_0.5Hz36lb1in"].judge
    apart = diagnosis(
        slack={"size": 3.0, "softness": 0.5, "start": 0.5}, asymmetry={"size": 0.3}, load_offset={"size": -0.12}
    )
    judged = judge(apart, path, {})
    assert [one.agrees for one in judged] == [True, True]
    assert "push is +20 % off the mean of push and pull at mid-stroke; diagnosed +18 %" in judged[1].words
    assert [one.agrees for one in judge(diagnosis(), path, {})] == [False, False]


def test_an_asymmetry_beside_the_offset_belongs_to_it(axis):
    """At 100 mm/s, the mean, friction is 40 N; -13 % of it in push and +2 N throughout are -3.2 N together."""
    own = diagnosis(
        fy_kN=0.020, gamma=0.01, inertia={"size": 95.0}, load_offset={"size": 0.1}, asymmetry={"size": -0.13}
    )
    offset = BY_ID["emps"].judge(own, axis, {})[2]
    assert float(offset.words.split()[-2]) == pytest.approx(-3.2, abs=0.1)
    assert offset.agrees


def test_metal_that_yields_gets_no_friction_name(tmp_path):
    judge = BY_ID["flexural plate"].judge
    assert judge(diagnosis("unknown", restoring={"size": 0.1}, wear={"size": 0.1}), tmp_path, {})[0].agrees
    assert judge(diagnosis("named", restoring={"size": 0.1}), tmp_path, {})[0].agrees
    assert not judge(diagnosis("named", restoring={"size": 0.1}, wear={"size": 0.1}), tmp_path, {})[0].agrees


def test_the_force_of_the_gas_is_compared(tmp_path):
    judge = BY_ID["mr damper"].judge
    assert judge(diagnosis(fy_kN=0.5, load_offset={"size": 0.16}), tmp_path, {})[0].agrees
    assert not judge(diagnosis(fy_kN=0.5, load_offset={"size": -0.16}), tmp_path, {})[0].agrees
    assert not judge(diagnosis(), tmp_path, {})[0].agrees


def test_a_catalogue_without_the_effect_must_say_unknown(tmp_path):
    hidden = diagnosis("unknown", where=["slip since reversal"], heldout=1.0)
    judged = BY_ID["brfd slack hidden"].judge(hidden, tmp_path, {"brfd slack": diagnosis(heldout=0.6)})
    assert [one.agrees for one in judged] == [True, True, True]
    named = diagnosis("named", where=["travel"], heldout=0.6)
    judged = BY_ID["brfd slack hidden"].judge(named, tmp_path, {"brfd slack": diagnosis(heldout=0.9)})
    assert [one.agrees for one in judged] == [False, False, False]


@pytest.fixture
def lehigh(band, tmp_path):
    """A folder in which two of the recordings with band columns lie."""
    folder = tmp_path / "recordings" / "brfd-lehigh"
    folder.mkdir(parents=True)
    table = pd.read_csv(band)
    table.insert(2, "Force (kip)", np.sign(np.cos(2 * np.pi * table["Time (s)"])) * 3.0)
    for name in ("step0.03ea1forward", "harmonic0.03ea1forward"):
        table.to_csv(folder / f"ds4_{name}.csv.gz", index=False)
    return folder


def test_a_run_that_was_stopped_goes_on(lehigh, tmp_path, monkeypatch, capsys):
    asked = []

    def serve(tasks, workers, done, module=pool.WORKER):
        for task in tasks:
            asked.append(task["name"])
            done(task, diagnosis())
            if len(asked) == 1:
                raise KeyboardInterrupt

    monkeypatch.setattr(pool, "in_parallel", serve)
    with pytest.raises(KeyboardInterrupt):
        prove_recordings(tmp_path / "recordings", tmp_path / "out")
    result = prove_recordings(tmp_path / "recordings", tmp_path / "out", progress=True)
    assert sorted(asked) == sorted(row["id"] for row in result.record["cases"])
    assert "1 of 2 were diagnosed before" in capsys.readouterr().out
    prove_recordings(tmp_path / "recordings", tmp_path / "out")  # which begins anew: this one had ended
    assert len(asked) == 4


def test_the_diagnosis_sees_three_columns(lehigh, tmp_path, monkeypatch):
    """Of a recording with band columns only time, displacement and force go behind the fence."""
    (lehigh / "ds4_harmonic0.03ea1forward.csv.gz").unlink()
    seen = []

    def serve(tasks, workers, done, module=pool.WORKER):
        for task in tasks:
            seen.append(task["recordings"][0].read_text(encoding="utf-8"))
            done(task, diagnosis())

    monkeypatch.setattr(pool, "in_parallel", serve)
    result = prove_recordings(tmp_path / "recordings", tmp_path / "out")
    assert [text.splitlines()[0] for text in seen] == ["time_s,displacement_mm,force_kN"]
    assert {len(line.split(",")) for line in seen[0].splitlines()} == {3}
    assert "0 of 1 comparisons agree" in result.text
    assert "DIFFERS" in result.text
    page = result.page.read_text(encoding="utf-8")
    assert "no change of clamping was found" in page
    assert page.count("Clamping over time") == 1
    assert "off on cycles left out with the law alone, 500 N with what was found" in result.text
    assert "off on cycles left out with the law alone" in page
    assert "CC BY-SA" in page  # whose recording it is
    stored = json.loads((tmp_path / "out" / "recordings.json").read_text(encoding="utf-8"))
    assert len(stored["absent"]) == len({case.file for case in CASES}) - 1


def test_a_story_says_what_stays_open():
    open_ = real._open(
        diagnosis("unknown")
        | {
            "reason": "no known mechanism",
            "coordinates": [
                {"action": "capacity", "coordinate": "time", "probability": 0.4, "matches": []},
                {"action": "capacity", "coordinate": "slip", "probability": 1.0, "matches": []},
                {"action": "added", "coordinate": "constant", "probability": 1.0, "matches": ["load_offset"]},
            ],
        }
    )
    assert open_ == [
        "which mechanism it is: no known mechanism",
        "whether there is a dependence of the capacity over time (P = 0.40)",
        "what makes the capacity depend on slip: no known formula has this curve",
    ]
    family = diagnosis("family") | {"family": [{"id": "wear"}, {"id": "thermal"}], "coordinates": []}
    assert real._open(family) == ["which of these it is: wear, thermal"]
    assert all(case.file.split("/")[0] in real.SOURCES for case in CASES)


def test_wrong_folders_are_refused_in_words(tmp_path):
    with pytest.raises(ProofError, match="is not a folder"):
        prove_recordings(tmp_path / "none", tmp_path / "out")
    done = CliRunner().invoke(main, ["prove", "--recordings", str(tmp_path), "-o", str(tmp_path / "out")])
    assert done.exit_code == 1
    assert "holds none of the recordings looked for" in done.output
