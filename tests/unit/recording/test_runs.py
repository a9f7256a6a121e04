"""Several runs in one file: found, said, and parted as the user says."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.errors import RecordingError
from shj_bayes.recording.clock import restarts
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.runs import divisions, settle, split
from shj_validation.proof.protocols import course

from .conftest import friction_force

RATE_HZ = 20.0
STEPPED = (Block(6.0, 0.27, 2), Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
PLAIN = (Block(20.0, 0.1, 4),)
HEAD = "time_s,displacement_mm,force_kN"


def one_run(blocks, seed, stop_s=0.0):
    """Rows of one run, from rest at 0 mm."""
    time, motion = exact_motion(blocks, RATE_HZ)
    rng = np.random.default_rng(seed)
    x = motion.displacement_mm + 0.02 * rng.standard_normal(time.size)
    rows = np.column_stack([time, x, friction_force(motion) + 0.5 * rng.standard_normal(time.size)])
    return rows[time >= stop_s]


def behind(runs, rest_s=0.0, sampled=True):
    """Runs on one clock; at rest the rig lets go of the force."""
    rng = np.random.default_rng(9)
    parts, clock = [], 0.0
    for number, run in enumerate(runs):
        if number and rest_s and sampled:
            t = np.arange(0.0, rest_s, 1 / RATE_HZ)
            level = parts[-1][-1, 1]
            noise = rng.standard_normal((2, t.size))
            parts.append(np.column_stack([clock + t, level + 0.02 * noise[0], 0.5 * noise[1]]))
        clock += rest_s if number else 0.0
        parts.append(run + np.array([clock, 0.0, 0.0]))
        clock = parts[-1][-1, 0] + 1 / RATE_HZ
    return np.vstack(parts)


def in_memory(rows):
    return Recording(*rows.T)


def written(path, rows, head=HEAD):
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def codes(recording):
    return {finding.code: finding for finding in recording.findings}


THREE = [one_run(STEPPED, seed) for seed in (1, 2, 3)]


def test_rests_away_from_the_start_belong_to_the_test():
    """A test may hold its device at the end of a stroke for minutes, to see what rest does."""
    time = course("improved", RATE_HZ, 1)
    recording = Recording(time.time_s, time.x_mm, np.tanh(time.v_mm_s))
    assert divisions(recording) == ()


def stood_still(parts, rest_s=40.0):
    """Positions of a rig that stands still between the parts where the one before it ended, and goes on from there."""
    x, n = [parts[0]], round(rest_s * RATE_HZ)
    for part in parts[1:]:
        way = np.arange(x[-1][-1], part[0], np.sign(part[0] - x[-1][-1]) * 10.0 / RATE_HZ)
        x += [np.full(n, x[-1][-1]), way, part]
    x = np.concatenate(x)
    noise = np.random.default_rng(5).standard_normal(x.size)
    return Recording(np.arange(x.size) / RATE_HZ, x + 0.02 * noise, 70.0 * np.tanh(np.gradient(x) * 100))


def test_a_protocol_cut_off_away_from_the_start_is_found_when_it_begins_again():
    x = exact_motion(STEPPED, RATE_HZ)[1].displacement_mm
    early, late = x[: round(0.62 * x.size)], x[: round(0.94 * x.size)]
    assert min(abs(early[-1]), abs(late[-1])) > 0.2 * np.ptp(x)
    recording = stood_still([late, early, late])
    assert "3 runs" in codes(settle([recording])[0])["several-runs"].message
    for run, part in zip(split(recording), (late, early, late), strict=True):
        assert run.n_samples == pytest.approx(part.size, abs=100)


@pytest.mark.parametrize("blocks", [[replace(block, n_cycles=4) for block in STEPPED], (Block(24.0, 0.1, 12),)])
def test_rests_in_the_middle_of_a_stroke_are_said(blocks):
    x = exact_motion(blocks, RATE_HZ)[1].displacement_mm
    one, two = round(0.45 * x.size), round(0.78 * x.size)
    (whole,) = settle([stood_still([x[:one], x[one:two], x[two:]])])
    assert "--runs 3" in codes(whole)["long-rests"].message
    assert whole.usable


@pytest.mark.parametrize(("rest_s", "sampled"), [(40.0, True), (40.0, False), (0.0, True)])
def test_a_protocol_that_begins_again_is_refused_until_somebody_says(rest_s, sampled):
    recording = in_memory(behind(THREE, rest_s, sampled))
    (whole,) = settle([recording])
    found = codes(whole)["several-runs"]
    assert found.severity == "unusable"
    assert "3 runs" in found.message
    for option in ("--runs 3", "--split", "--one-run"):
        assert option in found.message
    assert settle([recording], "one") == [recording]
    for runs in (settle([recording], 3), settle([recording], "split")):
        assert len(runs) == 3
        for run, rows in zip(runs, THREE, strict=True):
            assert run.n_samples == pytest.approx(len(rows), abs=60 if rest_s and sampled else 3)
            assert run.usable
            assert "runs-split" in codes(run)


def test_what_the_rig_does_at_rest_belongs_to_no_run():
    """At the stop the law still has 80 kN; the released force would be evidence against it."""
    first, second, _ = split(in_memory(behind(THREE, 40.0)))
    released = np.abs(first.force_kN[-20:]) < 20
    assert np.count_nonzero(released) == 0
    before = second.displacement_mm < second.displacement_mm[0] + 0.2
    assert 20 < int(np.argmin(before)) < 60  # enough of the rest to see the force from which it starts


def test_alike_stretches_of_one_amplitude_with_rests_are_runs_but_cycling_on_is_not():
    runs = [one_run(PLAIN, seed) for seed in (1, 2)]
    assert [way.why for way in divisions(in_memory(behind(runs)))] == []
    assert [way.n_runs for way in divisions(in_memory(behind(runs, 30.0))) if way.why == "repeat"] == [2]


def test_rests_between_unlike_stretches_are_a_warning():
    runs = [one_run((block,), 1) for block in (Block(6.0, 0.2, 3), Block(12.0, 0.2, 3), Block(24.0, 0.2, 3))]
    recording = in_memory(behind(runs, 20.0))
    (whole,) = settle([recording])
    assert codes(whole)["long-rests"].severity == "warning"
    assert whole.usable
    assert settle([recording], "one") == [recording]
    assert len(settle([recording], "split")) == 3
    assert len(settle([recording], 3)) == 3
    with pytest.raises(RecordingError, match=r"2 runs were expected.*2 rests.*\(3 runs\)"):
        split(recording, 2)


def test_short_rests_and_holds_are_not_remarked(clean):
    recording = Recording(clean.time, clean.displacement, clean.force)
    assert divisions(recording) == ()
    with pytest.raises(RecordingError, match=r"2 runs were expected, but found was: no long rest"):
        split(recording, 2)
    assert split(recording) == (recording,)
    held = np.interp(np.arange(0, 160, 0.05) % 16, [0, 5, 8, 13, 16], [0, 20, 20, 0, 0])  # ramp and hold
    force = 50.0 * np.tanh(np.gradient(held) * 100)
    assert divisions(Recording(np.arange(held.size) * 0.05, held, force)) == ()


def test_the_number_that_was_given_chooses_the_longest_rests():
    first, second, third = THREE
    rows = behind([behind([first, one_run(PLAIN, 7)], 15.0), third], 60.0)
    assert len(split(in_memory(rows), 2)) == 2
    whole = in_memory(behind([first, second], 40.0))
    assert split(whole, 1) == (whole,)


def test_time_that_begins_again_is_split_without_an_option(tmp_path):
    path = written(tmp_path / "device.csv", np.vstack(THREE))
    recording = read(path)
    assert list(recording.run_starts) == [len(THREE[0]), 2 * len(THREE[0])]
    assert "3 runs" in codes(recording)["time-restarts"].message
    runs = settle([recording])
    assert [run.source.name for run in runs] == [f"device.csv run {i}" for i in (1, 2, 3)]
    assert {run.source.sha256 for run in runs} == {recording.source.sha256}
    for run, rows in zip(runs, THREE, strict=True):
        np.testing.assert_allclose(run.time_s, rows[:, 0], atol=1e-6)
        np.testing.assert_allclose(run.force_kN, rows[:, 2], rtol=1e-8)
        assert "gaps" not in codes(run)  # of the whole, between the runs
        assert run.run_starts == {}
    assert settle([recording], "one") == [recording]


def test_a_run_column_tells_runs_apart(tmp_path):
    rows = behind(THREE)
    number = np.repeat([1.0, 2.0, 3.0], [len(run) for run in THREE])
    path = written(tmp_path / "a.csv", np.column_stack([rows, number]), f"{HEAD},Run No.")
    recording = read(path)
    assert "3 runs" in codes(recording)["run-column"].message
    assert [run.n_samples for run in settle([recording])] == [len(run) for run in THREE]
    counts = np.arange(len(rows)) % 50  # comes again and again: it numbers something else
    recording = read(written(tmp_path / "b.csv", np.column_stack([rows, counts]), f"{HEAD},Run"))
    assert recording.run_starts == {}
    assert "Run" in codes(recording)["columns-ignored"].message


def test_a_clock_that_overflows_in_motion_is_no_further_run():
    rows = behind(THREE)
    wrapped = rows[:, 0] % 40.0
    assert restarts(wrapped, rows[:, 1], rows[:, 2]) == []
    again = np.concatenate([run[:, 0] for run in THREE])
    assert restarts(again, rows[:, 1], rows[:, 2]) == [len(THREE[0]), 2 * len(THREE[0])]
    jump = rows[:, 0].copy()
    jump[300] = 1e6
    jump[500] = 0.0
    assert restarts(jump, rows[:, 1], rows[:, 2]) == []


def test_the_number_counts_over_all_files(tmp_path):
    double = in_memory(behind(THREE[:2], 40.0))
    single = in_memory(THREE[2])
    assert len(settle([double, single], 3)) == 3
    with pytest.raises(RecordingError, match="4 runs were expected, but found were 3"):
        settle([double, replace(single)], 4)
