"""Each check on a recording broken on purpose; the clean one passes all of them."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.errors import RecordingError
from shj_bayes.recording.checks import inspect, repair, resampled
from shj_bayes.recording.clock import longest_increasing
from shj_bayes.recording.motion import blind_stretches, motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.readings import clipped, not_readings
from shj_bayes.recording.recording import Recording


def arrays(clean):
    return clean.time.copy(), clean.displacement.copy(), clean.force.copy()


def run(t, x, f):
    """Repair and inspect; findings by code, and the recording."""
    t, x, f, used, findings = repair(t, x, f, "run.csv")
    recording = Recording(t, x, f, used)
    findings = (*findings, *inspect(recording))
    return {finding.code: finding for finding in findings}, replace(recording, findings=findings)


def test_a_clean_recording_has_no_findings(clean):
    found, recording = run(*arrays(clean))
    assert found == {}
    assert recording.used.all()
    np.testing.assert_array_equal(recording.force_kN, clean.force)


# --- time ---


def test_time_repeats_and_jumps_back(clean):
    t, x, f = arrays(clean)
    t[500] = t[499]
    t[900] = t[880]
    found, recording = run(t, x, f)
    assert found["time-jumps-back"].severity == "repaired"
    assert found["time-jumps-back"].count == 2
    assert recording.n_samples == clean.time.size - 2


def test_repeats_alone_are_named_so(clean):
    t, x, f = arrays(clean)
    t[500] = t[499]
    assert set(run(t, x, f)[0]) == {"time-repeats"}


def test_one_time_far_ahead_costs_one_row(clean):
    t, x, f = arrays(clean)
    t[500] = 1e6
    found, recording = run(t, x, f)
    assert found["time-jumps-back"].count == 1
    assert recording.n_samples == clean.time.size - 1


def test_a_broken_clock_is_refused(clean):
    t, x, f = arrays(clean)
    with pytest.raises(RecordingError, match=r"time repeats in .* too few digits.*--rate"):
        repair(np.round(t), x, f, "run.csv")
    with pytest.raises(RecordingError, match=r"time jumps back 1 times.*one file for each run"):
        repair(np.concatenate([t, t]), np.tile(x, 2), np.tile(f, 2), "run.csv")
    with pytest.raises(RecordingError, match="0 rows have a time"):
        repair(t * np.nan, x, f, "run.csv")


def test_longest_increasing_is_longest():
    values = np.array([0.0, 1.0, 9.0, 2.0, 2.0, 3.0, 1.5, 4.0])
    kept = longest_increasing(values)
    assert values[kept].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]


def test_jitter_is_noted(clean):
    t, x, f = arrays(clean)
    found, recording = run(t + 0.004 * np.random.default_rng(1).uniform(-1, 1, t.size), x, f)
    assert set(found) == {"jitter"}
    assert motion_of(recording).n_half == 41


def test_gap_is_noted_and_restarts(clean):
    t, x, f = arrays(clean)
    keep = (t < 300) | (t > 300.5)
    found, recording = run(t[keep], x[keep], f[keep])
    assert {code: (g.severity, g.count) for code, g in found.items()} == {"gaps": ("note", 1)}
    assert np.flatnonzero(recording.restarts).tolist() == [0, np.count_nonzero(t < 300)]
    assert recording.rate_Hz == pytest.approx(20.0, rel=1e-6)


def test_gap_with_much_motion_is_a_warning(clean):
    t, x, f = arrays(clean)
    keep = (t < 300) | (t > 306)
    assert run(t[keep], x[keep], f[keep])[0]["gaps"].severity == "warning"


def test_rows_without_time_are_left_out(clean):
    t, x, f = arrays(clean)
    t[10:12] = np.nan
    assert run(t, x, f)[0]["time-missing"].count == 2


# --- cells ---


def test_empty_cells_are_bridged_but_are_no_evidence(clean):
    t, x, f = arrays(clean)
    f[1000:1004] = np.nan
    x[2000] = np.nan
    found, recording = run(t, x, f)
    assert found["empty-cells"].severity == "repaired"
    assert np.flatnonzero(~recording.used).tolist() == [1000, 1001, 1002, 1003, 2000]
    assert abs(recording.displacement_mm[2000] - clean.motion.displacement_mm[2000]) < 0.1


def test_long_holes_become_gaps_and_empty_ends_go(clean):
    t, x, f = arrays(clean)
    f[1000:1030] = np.nan
    f[-50:] = np.nan
    found, recording = run(t, x, f)
    assert found["holes"].severity == "warning"
    assert found["holes"].count == 30
    assert found["empty-ends"].count == 50
    assert "gaps" in found
    assert recording.n_samples == t.size - 80


def test_too_many_empty_cells_are_unusable(clean):
    t, x, f = arrays(clean)
    f[::10] = np.nan
    found, recording = run(t, x, f)
    assert found["empty-cells"].severity == "unusable"
    assert not recording.usable


def test_a_column_without_numbers_is_refused(clean):
    t, x, f = arrays(clean)
    with pytest.raises(RecordingError, match=r"force column holds no number.*--columns force"):
        repair(t, x, f * np.nan, "run.csv")


def test_dropouts_of_the_displacement_are_bridged(clean):
    t, x, f = arrays(clean)
    x[[3000, 7000]] = 500.0
    found, recording = run(t, x, f)
    assert found["spikes"].count == 2
    assert recording.displacement_mm.max() < 96
    assert motion_of(recording).n_half == 41
    assert "spikes" not in run(*arrays(clean))[0]


@pytest.mark.parametrize("rate", [1.0, 5.0, 100.0])
def test_corners_and_coarse_sampling_are_no_dropouts(clean, rate):
    _, x, f = arrays(clean)
    t = np.arange(0.0, 80.0, 1 / rate)
    noise = 0.01 * np.random.default_rng(1).standard_normal(t.size)
    triangle = np.interp(t % 8.0, [0, 4, 8], [0, 40, 0])
    cases = [(triangle + noise, np.sign(np.gradient(triangle))), *((x[::k], f[::k]) for k in (2, 10, 60, 100))]
    for place, force in cases:
        *bad, jumps = not_readings(np.arange(place.size) / rate, place, force)
        assert not np.any(bad)
        assert jumps == []


@pytest.mark.parametrize("limit", [75.0, 60.0])
def test_clipped_force(clean, limit):
    t, x, f = arrays(clean)
    found, recording = run(t, x, np.clip(f, -limit, None))
    assert "clipped at -" in found["clipped"].message
    np.testing.assert_array_equal(recording.used, f > -limit)


def test_clipped_displacement(clean):
    t, x, f = arrays(clean)
    assert "displacement is clipped at 80" in run(t, np.clip(x, None, 80.0), f)[0]["clipped"].message


def test_rounded_and_noise_free_channels_are_not_clipped(clean):
    assert not clipped(np.round(clean.force), clean.displacement).any()
    smooth = 80 * np.tanh(clean.motion.displacement_mm)  # saturates to exactly 80.0, but gradually
    assert not clipped(smooth, clean.displacement).any()


# --- the loop ---


def test_force_of_80000_kilonewtons_is_a_wrong_unit(clean):
    t, x, f = arrays(clean)
    found, recording = run(t, x, 1000 * f)
    assert found["force-unit"].severity == "unusable"
    assert "8" in found["force-unit"].message
    assert "--units force=N" in found["force-unit"].message
    assert not recording.usable


def test_displacement_units(clean):
    t, x, f = arrays(clean)
    assert run(t, 1e3 * x, f)[0]["displacement-unit"].severity == "unusable"
    assert run(t, 1e-4 * x, f)[0]["displacement-flat"].severity == "unusable"
    assert run(t, x, 1e-8 * f)[0]["force-flat"].severity == "unusable"
    assert run(1000 * 20 * t, x, f)[0]["time-unit"].severity == "warning"


def test_sign_flipped_force_is_turned_round(clean):
    t, x, f = arrays(clean)
    found, recording = run(t, x, -f)
    assert {code: g.severity for code, g in found.items()} == {"force-sign": "repaired"}
    np.testing.assert_array_equal(recording.force_kN, f)


@pytest.mark.parametrize(("factor", "word"), [(-1.0, "sign"), (10.0, "scale"), (1e-3, "scale"), (0.2, "scale")])
def test_a_force_whose_sign_or_scale_changes_is_refused_and_not_turned_round(clean, factor, word):
    t, x, f = arrays(clean)
    for at in (4250, 8000):  # in the middle of a half-cycle, where work tells
        f[at:] *= factor
        found, recording = run(t, x, f)
        said = found["force-changes"]
        assert said.severity == "unusable"
        assert f"changes its {word}" in said.message
        assert float(said.message.partition("about ")[2].partition(" s")[0]) == pytest.approx(t[at], abs=1.0)
        assert "force-sign" not in found
        np.testing.assert_array_equal(recording.force_kN, f)
        f[at:] /= factor


@pytest.mark.parametrize("left", [0.4, 2.5])
def test_a_lost_bolt_and_a_tightened_one_are_no_change_of_the_scale(clean, left):
    t, x, f = arrays(clean)
    f[8000:] *= left
    assert "force-changes" not in run(t, x, f)[0]


def test_a_force_that_stops_again_and_again_is_no_evidence(clean):
    t, x, f = arrays(clean)
    stuck = np.zeros(t.size, dtype=bool)
    for k in range(300, t.size - 60, 1000):
        f[k : k + 25] = f[k]
        stuck[k : k + 25] = True
    found, recording = run(t, x, f)
    assert "times, first from 15 s" in found["stopped"].message
    assert found["stopped"].count >= 0.8 * stuck.sum()  # not those in which the device hardly moves
    assert not recording.used[stuck].all()
    assert recording.used[~stuck].all()
    assert "stopped" not in run(t, x, np.round(f))[0]


def test_swapped_columns_are_named_and_not_changed(clean):
    t, x, f = arrays(clean)
    found, recording = run(t, f, x)
    assert found["swapped-columns"].severity == "unusable"
    np.testing.assert_array_equal(recording.displacement_mm, f)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_chattering_force_taken_for_the_displacement_is_refused(clean, tmp_path, sign):
    """Stick-slip makes the force as bursty as the stroke; roughness and half-cycles tell them apart."""
    t, x, f = arrays(clean)
    chatter = f + 25 * np.sin(2 * np.pi * 3.1 * t) * (np.abs(f) > 60)
    path = tmp_path / "run.csv"
    np.savetxt(
        path,
        np.column_stack([t, sign * chatter, x]),
        header="time_s,displacement_mm,force_kN",
        delimiter=",",
        comments="",
    )
    findings = {finding.code: finding for finding in read(path).findings}
    assert findings["swapped-columns"].severity == "unusable"
    assert "force-sign" not in findings
    assert "swapped-columns" not in run(t, x, sign * chatter)[0]


def test_swapped_columns_come_with_the_options_that_exchange_them(clean, tmp_path):
    t, x, f = arrays(clean)
    path = tmp_path / "run.csv"
    header = "time_s,displacement_mm,force_kN"
    np.savetxt(path, np.column_stack([t, f, x]), header=header, delimiter=",", comments="")
    (said,) = [finding.message for finding in read(path).findings if finding.code == "swapped-columns"]
    columns, units = said.partition("--columns ")[2].split(" --units ")
    assert read(path, columns=columns, units=units).usable


def test_an_unlikely_unit_comes_with_those_that_would_be_usual(clean, tmp_path):
    t, x, f = arrays(clean)
    path = tmp_path / "run.csv"
    np.savetxt(path, np.column_stack([1e3 * t, x, f]), header="time,stroke_mm,force_kN", delimiter=",", comments="")
    (said,) = [finding.message for finding in read(path).findings if finding.code == "unit-unlikely"]
    assert said.endswith("(it would be usual in ms)")


def test_an_unusual_size_in_a_unit_of_the_header_is_a_warning_until_an_option_states_it(clean, tmp_path):
    t, x, f = arrays(clean)
    path = tmp_path / "run.csv"
    rows = np.column_stack([t, x, f])
    for head, role, usual in (("time_ms,x_mm,F_kN", "time", "s or min"), ("time_s,x_mm,F_N", "force", "kN")):
        np.savetxt(path, rows, header=head, delimiter=",", comments="")
        read_as = {"columns": "displacement=2,force=3"}
        (said,) = [g for g in read(path, **read_as).findings if g.code == "unit-unusual"]
        assert said.severity == "warning"
        assert said.message.endswith(f"(it would be usual in {usual})")
        option = said.message.partition("--units ")[2].split()[0]
        assert option.startswith(role)
        assert "unit-unusual" not in {g.code for g in read(path, units=option, **read_as).findings}


def test_after_a_gap_in_which_the_device_may_have_turned_samples_are_no_evidence(clean):
    t, x, f = arrays(clean)
    turns = t[clean.motion.start[1:-1]]
    # From within one half-cycle to within the next but one: two reversals are gone.
    lost = (t > 0.5 * (turns[30] + turns[31])) & (t < 0.5 * (turns[32] + turns[33]) - 1.0)
    found, recording = run(t[~lost], x[~lost], f[~lost])
    assert found["gap-turns"].severity == "warning"
    motion = motion_of(recording)
    first = int(np.flatnonzero(recording.restarts)[1])
    last = first + found["gap-turns"].count
    assert recording.time_s[last] == pytest.approx(turns[34], abs=0.2)
    assert motion.unsure[first:last].all()
    # Half a second on the way, and a pause of the logger while the device rests, hide no reversal.
    on_the_way = (t > turns[30] + 2.0) & (t < turns[30] + 2.5)
    assert "gap-turns" not in run(t[~on_the_way], x[~on_the_way], f[~on_the_way])[0]
    later = t + 60.0 * (np.arange(t.size) >= clean.motion.start[31])
    assert "gap-turns" not in run(later, x, f)[0]


def test_gaps_that_hide_reversals_are_told_from_those_that_do_not(clean):
    """Gaps of 0.5 to 100 s at random: with rates of 4 and 25 %, 15 and 45 % have a chance below 0.001."""
    rng = np.random.default_rng(11)
    t, x = clean.time[::2], clean.displacement[::2]
    turns = clean.time[clean.motion.start[1:-1]]
    hiding, plain = [], []
    for _ in range(120):
        length = 10 ** rng.uniform(-0.3, 2.0)
        begin = rng.uniform(5.0, t[-1] - 10.0 - length)
        kept = (t < begin) | (t > begin + length)
        cut = Recording(t[kept], x[kept], np.zeros(np.count_nonzero(kept)))
        hidden = np.any((turns > begin) & (turns < begin + length))
        (hiding if hidden else plain).append(bool(blind_stretches(cut, motion_of(cut))))
    assert min(len(hiding), len(plain)) > 45
    assert np.mean(hiding) > 0.85
    assert np.mean(plain) < 0.45


def interpolated(clean, factor, digits=None):
    """Arrays of a recording of `factor` times the rate, whose samples lie on lines between those of this one."""
    t, x, f = arrays(clean)
    dense = np.linspace(t[0], t[-1], round(factor * (t.size - 1)) + 1)
    channels = [np.interp(dense, t, values) for values in (x, f)]
    if digits:
        channels = [np.array([float(f"{value:.{digits}g}") for value in values]) for values in channels]
    return dense, *channels


@pytest.mark.parametrize("digits", [None, 6])
@pytest.mark.parametrize("factor", [4.0, 10.24, 51.2])
def test_what_was_interpolated_to_a_higher_rate_is_told_with_the_factor(clean, factor, digits):
    found = run(*interpolated(clean, factor, digits))[0]["resampled"]
    assert found.severity == "warning"
    assert "force: " in found.message
    assert f"{factor:.3g} times as many" in found.message
    assert f"every {round(factor)}th row" in found.message


def test_what_was_interpolated_between_uneven_times_is_told(clean):
    """Two loggers, joined at the times of the faster one; the clock of the slower one varies by a tenth of its step."""
    t, x, f = arrays(clean)
    rng = np.random.default_rng(4)
    uneven = t + 0.1 * (t[1] - t[0]) * rng.uniform(-0.5, 0.5, t.size)
    dense = np.linspace(t[0], t[-1], 12 * t.size) + rng.uniform(0.0, 1e-4, 12 * t.size)
    found = run(dense, np.interp(dense, uneven, x), np.interp(dense, uneven, f))[0]["resampled"]
    assert "12 times as many" in found.message


@pytest.mark.parametrize("count", [0.0, 1e-4, 0.05, 0.5, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.1, 2.0])
def test_counts_held_and_averaged_channels_are_not_called_interpolated(clean, count, noise):
    t, x, _ = arrays(clean)
    rng = np.random.default_rng(5)
    triangle = 50.0 * (4.0 * np.abs(t / 8.0 % 1.0 - 0.5) - 1.0)
    for motion in (x, clean.motion.displacement_mm, triangle):
        raw = 80.0 * np.tanh(np.gradient(motion, t)) + noise * rng.standard_normal(t.size)
        force = np.round(raw / count) * count if count else raw
        place = np.round(motion / 0.01) * 0.01 if count else motion
        held, mean = np.repeat(force[::4], 4)[: t.size], np.convolve(force, np.full(4, 0.25), mode="same")
        for values in (place, force, held, mean):
            assert resampled(Recording(t, place, values), values, 40) is None


def test_offsets(clean):
    t, x, f = arrays(clean)
    assert {c: g.severity for c, g in run(t, x + 10, f + 15)[0].items()} == {
        "displacement-offset": "note",
        "force-offset": "note",
    }


def test_force_at_rest_before_the_start(clean):
    t, x, f = arrays(clean)
    rng = np.random.default_rng(2)
    t = np.concatenate([np.arange(40) * 0.05, t + 2.0])
    x = np.concatenate([0.02 * rng.standard_normal(40), x])
    f = np.concatenate([0.5 * rng.standard_normal(40), f])
    assert run(t, x, f)[0] == {}
    assert "rest-offset" in run(t, x, f + 12)[0]


@pytest.mark.parametrize("samples", [4, 8])
def test_lag_is_estimated(clean, samples):
    t, x, f = arrays(clean)
    lag = run(t[samples:], x[samples:], f[:-samples])[0]["lag"]
    assert lag.severity == "warning"
    assert abs(float(lag.message.split("(")[1].split()[0]) - samples) <= 1.0
    early = run(t[:-samples], x[:-samples], f[samples:])[0]
    assert "lag" not in early


def test_too_few_cycles_and_samples(clean):
    t, x, f = arrays(clean)
    assert run(t[:80], x[:80], f[:80])[0]["few-cycles"].severity == "warning"
    quarter = run(t[:15], x[:15], f[:15])[0]
    assert quarter["few-cycles"].severity == "unusable"
    assert quarter["few-samples"].severity == "unusable"
    assert set(run(t[::60], x[::60], f[::60])[0]) == {"coarse-sampling"}
    found, recording = run(t, 0.02 * np.random.default_rng(1).standard_normal(t.size), f)
    assert found["no-motion"].severity == "unusable"
    assert not recording.usable
