"""Protocols: smooth, within the rig, exact in their turning points; the rig and its file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shj_bayes.errors import PlanError
from shj_bayes.margins.history import from_file
from shj_bayes.planning.plan import history_csv
from shj_bayes.planning.protocol import (
    LIMITS,
    Protocol,
    ProtocolBlock,
    Rig,
    proposals,
    read_rig,
    table_1_protocol,
)
from shj_bayes.recording.motion import table_1

RIG = Rig(95.0, 40.0, 200.0, 12.0, 20.0)


@pytest.mark.parametrize("waveform", ["sine", "triangle"])
def test_a_block_is_smooth_and_reaches_what_it_states(waveform: str) -> None:
    time, motion = Protocol(
        "p", (ProtocolBlock(20.0, 40.0, 2, waveform, 3.0), ProtocolBlock(60.0, 10.0, 1, waveform))
    ).sampled(500.0)
    x, speed = motion.displacement_mm, motion.speed_mm_s
    assert x[0] == speed[0] == 0.0
    assert np.abs(x).max() == pytest.approx(60.0, rel=1e-4)
    assert speed.max() == pytest.approx(40.0, rel=1e-4)
    # The stated speed is that of the displacement, and there is no jump in it.
    assert np.abs(np.abs(np.gradient(x, time)) - speed).max() < 0.3
    assert np.abs(np.diff(speed)).max() < 2.5
    resting = (np.abs(x - 20.0) < 1e-9) & (speed < 1e-6)
    assert np.count_nonzero(resting) / 500.0 == pytest.approx(3.0, abs=0.02)


def test_half_cycles_turn_where_the_motion_does() -> None:
    _, motion = table_1_protocol().sampled(20.0)
    assert motion.turning_mm[1:].size == 2 * sum(b.n_cycles for b in table_1())
    for a, b, sign in zip(motion.start[:-1], motion.start[1:], motion.direction, strict=True):
        assert np.all(sign * np.diff(motion.displacement_mm[a:b]) >= -1e-9)
    assert np.all(np.abs(motion.displacement_mm) <= 95.0)


def test_proposals_keep_to_the_rig_and_fill_its_time() -> None:
    small = Rig(30.0, 5.0, 100.0, 4.0, 5.0)
    table, *patterns = proposals(small)
    assert (table.name, table.largest_mm) == ("Table 1", pytest.approx(30.0))
    for p in patterns:
        assert not small.broken_by(p)
        p.sampled(small.rate_Hz)  # resolved at its rate
    assert any(p.times > 1 and p.duration_s + p.duration_s / p.times > 240.0 for p in patterns)


def test_a_pattern_that_comes_twice_is_its_blocks_twice() -> None:
    blocks = (ProtocolBlock(20.0, 40.0, 2), ProtocolBlock(60.0, 10.0, 1))
    twice, written = Protocol("p", blocks, 2), Protocol("p", blocks * 2)
    assert (twice.duration_s, twice.travel_m) == pytest.approx((written.duration_s, written.travel_m))
    (time, motion), (other, own) = twice.sampled(20.0), written.sampled(20.0)
    assert np.array_equal(time, other)
    assert np.array_equal(motion.displacement_mm, own.displacement_mm)
    assert np.array_equal(motion.start, own.start)


def test_a_history_outside_the_rig_is_not_written() -> None:
    text = history_csv(Protocol("p", (ProtocolBlock(50.0, 20.0, 1),)), RIG, middle_mm=3.0)
    rows = np.loadtxt(text.splitlines()[1:], delimiter=",")
    assert text.splitlines()[0] == "time_s,displacement_mm"
    assert np.diff(rows[:, 0]) == pytest.approx(0.05)
    assert rows[:, 1].max() == pytest.approx(53.0, abs=0.05)
    with pytest.raises(PlanError, match="the rig allows 95 mm and 40 mm/s"):
        history_csv(Protocol("p", (ProtocolBlock(100.0, 20.0, 1),)), RIG)
    assert RIG.broken_by(Protocol("p", (ProtocolBlock(96.0, 41.0, 20),))) != ()


def test_a_file_is_the_same_protocol_as_the_blocks_it_was_written_from(tmp_path: Path) -> None:
    blocks = Protocol("p", (ProtocolBlock(50.0, 20.0, 2), ProtocolBlock(20.0, 10.0, 1, "triangle", 4.0)))
    (tmp_path / "p.csv").write_text(history_csv(blocks, RIG), encoding="utf-8")
    asked = from_file(tmp_path / "p.csv")
    again = Protocol("p", samples=(asked.time_s, asked.motion))
    assert again.duration_s == pytest.approx(blocks.duration_s, abs=0.06)
    assert (again.largest_mm, again.fastest_mm_s) == pytest.approx((50.0, 20.0), rel=0.02)
    assert again.travel_m == pytest.approx(blocks.travel_m, rel=0.01)
    (_, own), (_, read) = blocks.sampled(20.0), again.sampled(20.0)
    assert read.turning_mm == pytest.approx(own.turning_mm, abs=0.1)
    assert read.speed_mm_s[: own.speed_mm_s.size] == pytest.approx(own.speed_mm_s[: read.speed_mm_s.size], abs=1.0)


@pytest.mark.parametrize("block", [(0.0, 1.0, 1), (1.0, float("nan"), 1), (1.0, 1.0, 0)])
def test_a_block_without_motion_is_refused(block: tuple[float, float, int]) -> None:
    with pytest.raises(PlanError, match="cannot be run"):
        ProtocolBlock(*block)


def test_a_rig_file_is_read_and_mistakes_are_told(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_text('schema = "shj-bayes/rig/1"\nmax_stroke_mm = 60\n', encoding="utf-8")
    assert read_rig(path) == {"max_stroke_mm": 60.0}
    path.write_text('schema = "shj-bayes/rig/1"\nmax_stroke = 60\n', encoding="utf-8")
    with pytest.raises(PlanError, match="did you mean 'max_stroke_mm'"):
        read_rig(path)
    with pytest.raises(PlanError, match="max_minutes = 0"):
        Rig(95.0, 40.0, 200.0, 0.0, 20.0)


@pytest.mark.parametrize("value", ["1" + "0" * 400, "1e308", "1e-308", "-1", "0", "nan", "-inf"])
@pytest.mark.parametrize("name", LIMITS)
def test_a_limit_that_no_rig_has_is_refused(tmp_path: Path, name: str, value: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(f'schema = "shj-bayes/rig/1"\n{name} = {value}\n', encoding="utf-8")
    with pytest.raises(PlanError, match=rf"{name} = .*; allowed is a number from"):
        read_rig(path)
    with pytest.raises(PlanError, match=rf"{name} = .*; allowed is a number from"):
        replace(RIG, **{name: float(value[:309])})


def test_a_week_on_the_rig_is_not_filled_with_repeats() -> None:
    rig = replace(RIG, max_stroke_mm=1.0, max_speed_mm_s=1e5, max_minutes=1e4)
    assert max(one.times for one in proposals(rig)) == 200
