"""Faults in the values of a recording of one device: repaired, and the rest as it was, or refused for the cause."""

import re
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from one_device import RATE_HZ, plain

from shj_bayes._util.arrays import FloatArray
from shj_bayes.recording.checks import inspect, repair
from shj_bayes.recording.motion import hysteresis, motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.readings import held
from shj_bayes.recording.recording import Recording

P = plain()
N = P.time_s.size
LOUD = {"repaired", "warning", "unusable"}


def rows_of(n_runs: int, length: int, seed: int) -> FloatArray:
    """Rows of runs of so many at random places, none beside another, shape (n_runs * length,)."""
    slots = np.random.default_rng(seed).choice(np.arange(2, N // (length + 9) - 2), n_runs, replace=False)
    return (slots[:, None] * (length + 9) + np.arange(length)).ravel()


@pytest.fixture
def written(tmp_path) -> Callable[..., Recording]:
    """Write three channels to a file and read it."""

    def write(t=P.time_s, x=P.displacement_mm, f=P.force_kN, head="time_s,displacement_mm,force_kN", **reading):
        path = tmp_path / "run.csv"
        np.savetxt(path, np.column_stack([t, x, f]), header=head, delimiter=",", comments="", fmt="%.10g")
        return read(path, **reading)

    return write


def repaired(t=P.time_s, x=P.displacement_mm, f=P.force_kN) -> Recording:
    """Repair and check three channels, as a file of them would be."""
    t, x, f, used, findings = repair(t, x, f, "run.csv")
    recording = Recording(t, x, f, used, findings=findings)
    return recording.with_findings(*inspect(recording))


def codes(recording: Recording) -> set[str]:
    return {finding.code for finding in recording.findings if finding.severity in LOUD}


def message(recording: Recording, code: str) -> str:
    return next(finding.message for finding in recording.findings if finding.code == code)


# --- rows that are no readings ---


@pytest.mark.parametrize("value", [0.0, -9999.0, 32767.0, 1e29, -999.0])
@pytest.mark.parametrize(
    ("where", "n_runs", "length"),
    [("both", 1, 1), ("both", 1, 3), ("force", 40, 1), ("both", 35, 1), ("displacement", 12, 6), ("both", 5, 10)],
)
def test_dropouts_and_sentinels_are_taken_out(value, where, n_runs, length):
    rows = rows_of(n_runs, length, seed=length)
    x, f = P.displacement_mm.copy(), P.force_kN.copy()
    if where != "force":
        x[rows] = value
    if where != "displacement":
        f[rows] = value
    recording = repaired(x=x, f=f)
    assert codes(recording) == {"spikes"}
    lost = ~np.asarray(recording.used)
    assert np.isin(np.flatnonzero(lost), rows).all()
    # A 0 where the channel passes 0 is taken out where the others are, or does no harm.
    wrong = (np.abs(x - P.displacement_mm) > 0.5) | (np.abs(f - P.force_kN) > 10.0)
    assert not (wrong & ~lost).any()
    np.testing.assert_array_equal(recording.force_kN[~lost & ~wrong], f[~lost & ~wrong])
    assert np.max(np.abs(recording.displacement_mm - P.displacement_mm)) < 0.6
    assert motion_of(recording).n_half == 25


@pytest.mark.parametrize(("size", "n_runs", "length"), [(0.6, 33, 3), (-0.8, 20, 1), (4.0, 12, 8), (30.0, 60, 2)])
def test_slips_of_a_few_rows_are_taken_out(size, n_runs, length):
    rows, x = rows_of(n_runs, length, seed=3), P.displacement_mm.copy()
    x[rows] += size
    recording = repaired(x=x)
    found = np.flatnonzero(~np.asarray(recording.used))
    assert np.isin(found, rows).all()
    assert found.size >= 0.98 * rows.size
    assert f"({found.size} rows)" in message(recording, "spikes")
    assert motion_of(recording).speed_mm_s.max() < 15.0


def test_rows_of_any_numbers_are_taken_out():
    rows, rng = rows_of(60, 1, seed=5), np.random.default_rng(8)
    x, f = P.displacement_mm.copy(), P.force_kN.copy()
    x[rows], f[rows] = rng.uniform(-400, 400, rows.size), rng.uniform(-400, 400, rows.size)
    recording = repaired(x=x, f=f)
    assert np.count_nonzero(np.asarray(recording.used)[rows]) <= 2
    assert np.count_nonzero(~np.asarray(recording.used)) <= rows.size
    assert motion_of(recording).n_half == 25


@pytest.mark.parametrize("share", [0.07, 0.15, 0.3])
@pytest.mark.parametrize("value", [0.0, -9999.0])
def test_more_than_may_be_repaired_is_refused_for_the_cause(share, value):
    rows = np.random.default_rng(2).choice(N, int(share * N), replace=False)
    x, f = P.displacement_mm.copy(), P.force_kN.copy()
    x[rows], f[rows] = value, value
    recording = repaired(x=x, f=f)
    assert {f.code for f in recording.findings if f.severity == "unusable"} == {"empty-cells"}
    assert "are empty or no readings" in message(recording, "empty-cells")
    # What is advised: without these rows the file is right.
    rest = np.delete(np.arange(N), rows)
    assert repaired(P.time_s[rest], x[rest], f[rest]).usable


def test_a_long_dropout_is_left_out_and_becomes_a_gap():
    x, f = P.displacement_mm.copy(), P.force_kN.copy()
    x[1700:1740], f[1700:1740] = -9999.0, -9999.0
    recording = repaired(x=x, f=f)
    assert recording.n_samples == N - 40
    assert {"spikes", "holes"} <= codes(recording)
    assert np.abs(recording.displacement_mm).max() < 49.0


def test_a_displacement_that_goes_on_elsewhere_is_refused():
    x = P.displacement_mm.copy()
    x[1000:] += 5.0
    recording = repaired(x=x)
    assert {f.code for f in recording.findings if f.severity == "unusable"} == {"jumps"}
    assert "5" in message(recording, "jumps")
    x[1000:] -= 5.0  # what is advised
    assert codes(repaired(x=x)) == set()


def test_a_sentinel_is_no_reason_to_doubt_the_unit(written):
    f = P.force_kN.copy()
    f[[700, 701, 1500, 2600]] = -9999.0
    for head in ("time_s,displacement_mm,force_kN", "time,displacement,force"):
        recording = written(f=f, head=head)
        assert codes(recording) == {"spikes"}
        assert "-9999 kN" in message(recording, "spikes")


# --- channels slower than the table ---


def latest(values: FloatArray, period: float) -> FloatArray:
    """A channel read every so many rows, its last reading in each row; between rows as on a line."""
    moments = np.floor(np.arange(N) / period + 1e-9) * period
    return np.interp(moments, np.arange(N), values)


@pytest.mark.parametrize("period", [1.25, 1.5, 2, 2.4, 3, 3.7, 4, 5, 10, 20])
@pytest.mark.parametrize("channel", ["displacement", "force"])
def test_a_channel_slower_than_the_table_is_used_at_its_own_rate(period, channel):
    x, f = P.displacement_mm, P.force_kN
    recording = repaired(x=latest(x, period)) if channel == "displacement" else repaired(f=latest(f, period))
    assert codes(recording) - {"coarse-sampling"} == {"held"}
    said = message(recording, "held")
    assert said.startswith(f"{channel} changes in every ")
    assert float(re.search(r"at ([\d.]+) Hz of 20 Hz", said)[1]) == pytest.approx(RATE_HZ / period, rel=0.01)
    used = np.asarray(recording.used)
    assert used.sum() == pytest.approx(N / period, abs=2 + N / period / 200)
    # Every reading that is evidence stands at its own moment beside the other channel of that moment.
    row = recording.time_s[used] * RATE_HZ
    np.testing.assert_allclose(recording.displacement_mm[used], np.interp(row, np.arange(N), x), atol=0.05)
    np.testing.assert_allclose(recording.force_kN[used], np.interp(row, np.arange(N), f), atol=3.0)


def test_both_channels_and_rows_written_twice():
    x, f = P.displacement_mm, P.force_kN
    recording = repaired(x=latest(x, 4), f=latest(f, 4))
    assert (recording.n_samples, recording.used.all(), codes(recording)) == (N // 4, True, {"held"})
    recording = repaired(x=latest(x, 2), f=latest(f, 4))
    assert (recording.n_samples, recording.used.sum()) == (N // 2, N // 4)
    np.testing.assert_array_equal(recording.force_kN[recording.used], f[::4])


def test_a_reading_that_comes_late_at_times_is_found():
    late = np.random.default_rng(1).random(N) < 0.3
    index = np.arange(N)
    index[late] -= 1
    index = np.maximum.accumulate(index)
    recording = repaired(x=P.displacement_mm[index])
    assert codes(recording) == {"held"}


HEALTHY = {
    "coarse counts": lambda x, f: (np.round(x / 0.5) * 0.5, f),
    "slow and coarse": lambda x, f: (np.round(x / 4.0) * 4.0, np.round(f / 2.0) * 2.0),
    "long rests": lambda x, f: (np.round(np.clip(x, -20, 20), 2), f),
    "plastic without noise": lambda x, f: (x, np.clip(np.round(f), -70, 70)),
}


@pytest.mark.parametrize("name", HEALTHY)
def test_standstill_and_rounding_are_no_slower_channel(name):
    for values in HEALTHY[name](P.displacement_mm, P.force_kN):
        assert held(values) is None


def test_stick_slip_is_neither_held_nor_no_reading():
    """Force that drops by a third and grows again, many times or few, and a displacement that goes on in steps."""
    t = P.time_s
    for every, part in ((1.3, 1.0), (1.3, 0.05), (7.0, 1.0)):
        saw = 1.0 - 0.33 * (1.0 - t / every % 1.0) * (np.abs(P.force_kN) > 70) * (t < part * t[-1])
        assert codes(repaired(f=P.force_kN * saw)) == set()
    slip = np.round(P.displacement_mm / 2.0) * 2.0
    smooth = np.convolve(np.pad(slip, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    assert not {"held", "spikes", "jumps"} & codes(repaired(x=smooth))


def sliding(x: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Force of a rigid device that slides along."""
    way = np.convolve(x, np.ones(9) / 9, mode="same")
    return 80.0 * np.sign(np.gradient(way)) + rng.standard_normal(x.size)


HEALTHY_LOOPS = {
    "peaks of a breakaway": lambda x, f, rng: (x, f * (1 + 0.5 * np.exp(-np.abs(x - np.roll(x, 12))))),
    "heavy tails": lambda x, f, rng: (x, f + 1.5 * rng.standard_t(3, N)),
    "rigid": lambda x, f, rng: (x, sliding(x, rng)),
    "triangle": lambda x, f, rng: ((t := 48 * (4 * np.abs(P.time_s / 9 % 1 - 0.5) - 1)), sliding(t, rng)),
    "rounded": lambda x, f, rng: (np.round(x, 1), np.round(f)),
    "noisy": lambda x, f, rng: (x + 0.3 * rng.standard_normal(N), f + 5 * rng.standard_normal(N)),
    "backlash": lambda x, f, rng: (np.where(np.abs(x) < 0.4, 0.0, x - 0.4 * np.sign(x)), f),
}


@pytest.mark.parametrize("name", HEALTHY_LOOPS)
def test_healthy_look_alikes_lose_no_row(name):
    x, f = HEALTHY_LOOPS[name](P.displacement_mm, P.force_kN, np.random.default_rng(4))
    recording = repaired(x=x, f=f)
    assert not {"held", "spikes", "jumps", "few-points"} & codes(recording)
    assert recording.n_samples == N


@pytest.mark.parametrize("rate", [2.0, 5.0, 100.0])
def test_an_earthquake_loses_no_row(rate):
    t = np.arange(0.0, 60.0, 1 / rate)
    rng = np.random.default_rng(6)
    strong = np.exp(-(((t - 20) / 6) ** 2))
    waves = [rng.normal() * np.sin(2 * np.pi * w * t + rng.uniform(0, 6)) for w in np.arange(0.1, 0.6, 0.05)]
    x = 40 * strong * np.sum(waves, axis=0)
    f = 80 * np.tanh(8 * np.gradient(x, t)) + rng.standard_normal(t.size)
    recording = repaired(t, x, f)
    assert not {"held", "spikes", "jumps"} & codes(recording)


# --- too few points ---

TURNS = hysteresis(P.displacement_mm, 2.0)


def picked(per_half: int, *, along_force: bool = False) -> FloatArray:
    """Rows of so many points in each half-cycle, even in time, or along the loop as one digitises it."""
    rows = []
    for a, b in pairwise([0, *TURNS, N - 1]):
        force = np.convolve(np.pad(P.force_kN[a : b + 1], 2, mode="edge"), np.ones(5) / 5, mode="valid")
        way = np.arange(b - a + 1.0)
        if along_force:
            x = P.displacement_mm[a : b + 1]
            way = np.append(0.0, np.cumsum(np.hypot(np.diff(x) / np.ptp(x), np.diff(force) / 160.0)))
        rows.append(a + np.searchsorted(way, np.linspace(0.0, way[-1], per_half + 1)[:-1]))
    return np.unique(np.concatenate(rows))


@pytest.mark.parametrize(
    ("per_half", "along"), [(1, False), (2, False), (3, False), (6, False), (12, False), (20, True)]
)
def test_points_of_a_figure_that_do_not_show_the_reversals_are_refused(per_half, along):
    rows = picked(per_half, along_force=along)
    recording = repaired(P.time_s[rows], P.displacement_mm[rows], P.force_kN[rows])
    unusable = {finding.code for finding in recording.findings if finding.severity == "unusable"}
    assert "few-points" in unusable
    assert unusable <= {"few-points", "few-samples"}
    assert "at least 16 points in each half-cycle, at even steps of time" in message(recording, "few-points")


@pytest.mark.parametrize("stride", [1, 4, 10, 20])
def test_short_and_slowly_sampled_tests_pass(stride):
    rows = np.arange(0, N, stride)
    assert codes(repaired(P.time_s[rows], P.displacement_mm[rows], P.force_kN[rows])) <= {"coarse-sampling"}
    rows = np.arange(0, TURNS[4] + 15, 1 + stride // 8)
    assert codes(repaired(P.time_s[rows], P.displacement_mm[rows], P.force_kN[rows])) == set()
    rows = picked(16)  # what is advised
    assert "few-points" not in codes(repaired(P.time_s[rows], P.displacement_mm[rows], P.force_kN[rows]))


def test_noise_alone_is_no_motion_and_not_few_points():
    assert "no-motion" in codes(repaired(x=0.02 * np.random.default_rng(1).standard_normal(N)))


# --- advice: what is left of a channel says nothing of units and order ---


def test_half_a_channel_of_text_is_no_exchange_of_columns(tmp_path):
    rng, path = np.random.default_rng(3), tmp_path / "run.csv"
    cells = [[f"{value:.4f}" for value in row] for row in zip(P.time_s, P.displacement_mm, P.force_kN, strict=True)]
    for column in (1, 2):
        rows = [list(row) for row in cells]
        for row in rng.choice(N, N // 2, replace=False):
            rows[row][column] = "OVER"
        path.write_text("time;displacement;force\n" + "\n".join(";".join(row) for row in rows))
        found = {finding.code for finding in read(path).findings if finding.severity == "unusable"}
        assert found <= {"text-cells", "empty-cells"}


# --- a load cell at its limit ---


@pytest.mark.parametrize("limit", [75.0, 50.0])
def test_a_saturated_load_cell_has_no_lag(limit):
    recording = repaired(f=np.clip(P.force_kN, -limit, limit))
    assert codes(recording) == {"clipped"}


def test_a_held_force_has_no_lag():
    assert codes(repaired(f=latest(P.force_kN, 5))) == {"held"}


@pytest.mark.parametrize(("first", "n", "value"), [(1500, 60, None), (2700, 700, 0.0), (900, 30, -41.5)])
def test_a_force_channel_that_stops_is_no_evidence(first, n, value):
    force = P.force_kN.copy()
    force[first : first + n] = force[first] if value is None else value
    found = repaired(f=force)
    (said,) = [one for one in found.findings if one.code == "stopped"]
    assert said.count == min(n, force.size - first)
    assert not found.used[first : first + n].any()
    assert found.usable
    assert np.count_nonzero(~found.used) == said.count


def test_a_plateau_without_noise_has_not_stopped():
    time = np.arange(4000) / 20.0
    x = 20.0 * (2.0 / np.pi) * np.arcsin(np.sin(2 * np.pi * 0.05 * time))
    force = np.clip(np.cumsum(np.diff(x, prepend=0.0)) * 18.0, -80.0, 80.0)
    for k in range(1, force.size):  # elastic, plastic
        force[k] = np.clip(force[k - 1] + 18.0 * (x[k] - x[k - 1]), -80.0, 80.0)
    assert "stopped" not in {one.code for one in repaired(time, x, force).findings}


@pytest.mark.parametrize("value", [0.0, 0.05])
def test_times_that_are_zero_in_a_few_rows_begin_no_cycles(written, value):
    time = P.time_s.copy()
    rows = [300, 777, 1500, 2222, 3100]
    time[rows] = value
    found = written(t=time)
    assert codes(found) == {"time-jumps-back"}
    assert found.n_samples == N - len(rows)
    np.testing.assert_allclose(found.time_s, np.delete(P.time_s, rows))
