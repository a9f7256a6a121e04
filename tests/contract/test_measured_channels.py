"""A bolt tension beside the force, from files to a diagnosis, a page, a fit, and back from its files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

import shj_bayes
from shj_bayes.errors import ModelError
from shj_bayes.inference.binning import runs_of
from shj_bayes.margins.history import measured_channels
from shj_bayes.margins.specimen import read_specimen
from shj_bayes.model.curve import Curve
from shj_bayes.model.device import force_with_effects
from shj_bayes.model.effects.effect import Base, Contribution
from shj_bayes.model.history import histories
from shj_bayes.planning.protocol import Rig, table_1_protocol
from shj_bayes.planning.rivals import common_scales, linearise, read_device
from shj_bayes.recording.motion import exact_motion, table_1
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording
from shj_bayes.results import store
from shj_bayes.results.fit import FitRecord

CURVE = Curve("capacity", "measured_tension", 0.5)
TIME, MOTION = exact_motion(table_1(), 5.0)
COLUMNS = "tension=Bolt load (kN),temperature=Plate (degC),load2=Second cell (kN)"


def wandering(rng: np.random.Generator) -> np.ndarray:
    """A curve between -1 and 1 that changes over a minute or two."""
    walk = gaussian_filter1d(np.cumsum(rng.standard_normal(TIME.size)), 60)
    walk -= np.linspace(walk[0], walk[-1], TIME.size)
    return np.asarray(walk / np.abs(walk).max())


def write_device(folder: Path, *, follows: bool, seed: int) -> list[Path]:
    """Two runs with a tension that wanders by 10 %, which Coulomb's friction follows, or not."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    out = []
    for history in histories([TIME, TIME], [MOTION, MOTION]):
        wander = wandering(rng)
        coulomb = replace(
            CURVE.effect(),
            act=lambda h, v, b, w=wander: Contribution(clamping=1.0 + 0.1 * np.interp(h.time_s, TIME, w)),
        )
        base = Base(15.0, 70.0 if history.run == 1 else 60.0, 20.0, 0.01, 70.0)
        acting = [(coulomb, dict.fromkeys(coulomb.names, 0.0))] if follows else []
        force = force_with_effects(history, base, acting)
        force = force + rng.standard_normal(TIME.size)
        columns = {
            "time (s)": TIME,
            "displacement (mm)": MOTION.displacement_mm + 0.02 * rng.standard_normal(TIME.size),
            "force (kN)": force,
            "Bolt load (kN)": 45.0 * (1.0 + 0.1 * wander) + 0.3 * rng.standard_normal(TIME.size),
            "Plate (degC)": 21.0 + 0.1 * rng.standard_normal(TIME.size),
            "Second cell (kN)": 0.5 * force + rng.standard_normal(TIME.size),
        }
        path = folder / f"run{history.run}.csv"
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.7g")
        out.append(path)
    return out


def test_a_force_that_follows_the_tension_is_named_and_the_rest_is_said(tmp_path: Path) -> None:
    found = shj_bayes.diagnose(
        write_device(tmp_path, follows=True, seed=1), tmp_path / "out", quick=True, columns=COLUMNS
    )
    record = found.record
    assert record["verdict"] == "named", record["reason"]
    (effect,) = record["effects"]
    assert (effect["id"], effect["family"]) == ("measured_tension", "slow_change")
    # Coulomb: from 0.9 to 1.1 of the tension the force rises by 20 % of its middle value.
    change = effect["parameters"]["change"]
    assert change["q05"] - 0.02 < 0.2 < change["q95"] + 0.02
    assert change["sd"] < 0.03
    (row,) = (c for c in record["coordinates"] if c["probability"] > 0.5)
    assert (row["coordinate"], row["unit"], row["action"]) == ("measured_tension", "kN", "capacity")
    assert row["matches"] == ["measured_tension"]
    at, mean, low, high = (np.array(row["curve"][key]) for key in ("at", "mean", "q05", "q95"))
    assert at[[0, -1]] == pytest.approx([40.5, 49.5], abs=0.7)
    inside = (at > 42.0) & (at < 48.0)
    truth = 100.0 * (at / at[at.size // 2] - 1.0)
    assert np.all((low[inside] - 1.0 < truth[inside]) & (truth[inside] < high[inside] + 1.0))
    assert np.corrcoef(at, mean)[0, 1] > 0.98
    said = {c["name"]: c["refused"] for c in record["channels"]}
    assert said == {"tension": None, "temperature": "constant", "load2": "follows_force"}
    page = (tmp_path / "out" / "diagnosis.html").read_text(encoding="utf-8")
    assert (
        "The sliding force follows the measured tension" in page or "Sliding force follows the measured tension" in page
    )
    assert "Curve of the sliding force over measured tension" in page
    assert "not held against the measured temperature: it is constant within its noise" in page
    assert "not held against the measured load2: the measured force explains" in page


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_a_tension_that_has_nothing_to_do_with_the_force_raises_no_alarm(tmp_path: Path, seed: int) -> None:
    """One in a hundred such devices would be allowed one: 0 of 20 were seen."""
    paths = write_device(tmp_path, follows=False, seed=seed)
    record = shj_bayes.diagnose(paths, tmp_path / "out", quick=True, columns=COLUMNS).record
    assert record["verdict"] == "adequate"
    assert not [c for c in record["coordinates"] if c["coordinate"] == "measured_tension" and c["probability"] > 0.5]
    assert "it does not follow it" in (tmp_path / "out" / "diagnosis.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Path], Path]:
    """A short fit with a curve over the tension."""
    folder = tmp_path_factory.mktemp("fit")
    paths = write_device(folder, follows=True, seed=1)[:1]
    out = folder / "out"
    shj_bayes.fit(paths, out, effects=(CURVE.id,), columns=COLUMNS, max_steps=60, threads=1)
    return paths, out


def test_a_fit_is_read_again_with_its_channels(fitted: tuple[list[Path], Path]) -> None:
    paths, out = fitted
    record = store.read(FitRecord, out)
    assert list(record.channels) == ["measured_tension"]
    specimen = read_specimen(out, record.device, "s", out)
    (one,) = measured_channels(specimen)
    said = record.channels["measured_tension"]
    assert (one.unit, one.low, one.reference, one.high) == ("kN", said.low, said.reference, said.high)
    assert len(specimen.beliefs) == 2
    runs = runs_of([read(path, columns=COLUMNS) for path in paths])
    for run, stored in zip(runs, specimen.histories, strict=True):
        channel = next(c for c in run.further if c.name == "tension")
        wanted = np.interp(stored.time_s, channel.time_s, channel.values)
        np.testing.assert_allclose(stored.measured["measured_tension"].at(stored.time_s), wanted, atol=1e-3)


def test_a_plan_goes_on_from_such_a_fit(fitted: tuple[list[Path], Path]) -> None:
    device = read_device(fitted[1], None)
    assert [e.name for e in device.runs[0].recording.extras] == ["tension"]
    key = frozenset({"capacity over measured_tension"})
    rig = Rig(max_stroke_mm=100.0, max_speed_mm_s=20.0, max_force_kN=200.0, max_minutes=10.0, rate_Hz=5.0)
    protocol = table_1_protocol()
    scales = common_scales(device.runs, rig, (protocol,))
    base = replace(device.device, effects=())
    known = linearise(replace(device, device=base, sets=((frozenset(), 0.1), (key, 0.9)), hidden=frozenset()), scales)
    assert known.keys[0] == key
    time, motion = protocol.sampled(5.0)
    planned = known.placed(histories([time], [motion])[0])
    held = planned.measured["measured_tension"]
    assert np.ptp(held.at(planned.time_s)) == 0.0
    assert np.isfinite(known.rivals[0].model.force(np.ones((1, len(known.rivals[0].model.names))), planned, 0.0)).all()


def test_without_its_channel_a_curve_is_refused_with_what_to_do(
    fitted: tuple[list[Path], Path], tmp_path: Path
) -> None:
    with pytest.raises(ModelError, match=r"--columns tension="):
        shj_bayes.fit(fitted[0], tmp_path / "out", effects=(CURVE.id,), max_steps=200, threads=1)


def test_recordings_of_other_motion_do_not_need_it() -> None:
    motion = Recording(TIME, MOTION.displacement_mm, 60.0 * np.tanh(MOTION.displacement_mm))
    assert runs_of([motion])[0].further == ()
