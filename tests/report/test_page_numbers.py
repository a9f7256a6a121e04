"""Numbers behind the figures against hand calculation."""

import re
from types import SimpleNamespace
from urllib.parse import unquote

import numpy as np
import pytest

from shj_bayes.model.law import force, work_between
from shj_bayes.recording.motion import Block, exact_motion, one_peak_speed
from shj_bayes.report import campaign, numbers, words
from shj_bayes.report.device import freed_words
from shj_bayes.report.figures import device as loops
from shj_bayes.results.device import RunData

K, FY, AMPLITUDE = 20.0, 80.0, 40.0


def run_of(time: np.ndarray, x: np.ndarray, half: np.ndarray, f: np.ndarray, speed: np.ndarray) -> RunData:
    draws = np.tile(f, (8, 1))
    return RunData(1, time, x, speed, f, np.ones(x.size, dtype=bool), half, draws, draws)


@pytest.fixture(scope="module")
def elastoplastic() -> RunData:
    time, motion = exact_motion((Block(AMPLITUDE, 0.05, 4),), 50.0)
    f = force(motion, K=K, Fy=FY, beta=500.0, variant="continuous")
    return run_of(time, motion.displacement_mm, motion.half_cycle, f, motion.speed_mm_s)


def test_energy_of_an_elastoplastic_loop(elastoplastic: RunData) -> None:
    energy = numbers.cycles_of(elastoplastic, elastoplastic.force_kN)
    closed_form = 4 * FY * (AMPLITUDE - FY / K)
    assert energy.measured_J.size == 4
    assert energy.measured_J[1:] == pytest.approx(closed_form, rel=2e-3)
    # The first cycle starts from rest, not from sliding: its first quarter lacks the triangle Fy^2 / 2K.
    assert energy.measured_J[0] == pytest.approx(closed_form - FY * FY / (2 * K), rel=2e-3)


def test_work_between_is_the_area_of_a_triangle() -> None:
    x = np.array([0.0, 1.0, 2.0, 3.0])
    assert work_between(2 * x, x, np.array([0.0, 3.0])) == pytest.approx([9.0])
    assert work_between(np.ones(4), x, np.array([0.5, 1.25, 3.0])) == pytest.approx([0.75, 1.75])


def test_cycles_and_peak_speed(elastoplastic: RunData) -> None:
    energy = numbers.cycles_of(elastoplastic, elastoplastic.force_kN)
    assert energy.amplitude_mm == pytest.approx([AMPLITUDE] * 4, rel=1e-3)
    assert one_peak_speed(energy.peak_speed_mm_s) == pytest.approx(2 * np.pi * 0.05 * AMPLITUDE, rel=0.01)


def test_two_peak_speeds_are_not_one() -> None:
    time, motion = exact_motion((Block(20.0, 0.05, 3), Block(20.0, 0.2, 3)), 50.0)
    run = run_of(time, motion.displacement_mm, motion.half_cycle, motion.displacement_mm, motion.speed_mm_s)
    assert one_peak_speed(numbers.cycles_of(run, run.force_kN).peak_speed_mm_s) is None


def test_cycles_of_a_block_change_and_of_nothing() -> None:
    time, motion = exact_motion((Block(6.0, 0.27, 3), Block(12.0, 0.13, 3)), 20.0)
    run = run_of(time, motion.displacement_mm, motion.half_cycle, motion.displacement_mm, motion.speed_mm_s)
    energy = numbers.cycles_of(run, run.force_kN)
    assert energy.amplitude_mm == pytest.approx([6, 6, 6, 12, 12, 12], rel=0.02)
    assert energy.measured_J == pytest.approx(np.zeros(6), abs=1.0)  # a spring gives back what it took
    ramp = np.linspace(0.0, 5.0, 30)
    still = run_of(np.arange(30.0), ramp, np.zeros(30, dtype=np.int64), ramp, np.ones(30))
    assert numbers.cycles_of(still, still.force_kN).measured_J.size == 0
    assert numbers.pick_cycle(still) == slice(0, 30)


def test_band_of_known_noise() -> None:
    rng = np.random.default_rng(3)
    n = 4000
    law = np.zeros((100, n))
    predicted = rng.standard_normal((100, n))
    x = np.sin(np.arange(n) / 50)
    run = RunData(
        1, np.arange(float(n)), x, np.ones(n), predicted[0], np.ones(n, bool), np.zeros(n, int), law, predicted
    )
    band = numbers.force_band(run)
    assert band.median == pytest.approx(np.zeros(n))
    assert np.median(band.force_high) == pytest.approx(1.645, abs=0.05)
    assert np.median(band.force_low) == pytest.approx(-1.645, abs=0.05)


def made_run(force_of) -> RunData:
    """Six sine cycles of 40 mm with a given force of (displacement, direction)."""
    n = 2401
    t = np.linspace(0, 6, n)
    x = 40 * np.sin(2 * np.pi * t)
    speed = 80 * np.pi * np.abs(np.cos(2 * np.pi * t))
    half = np.floor(2 * t + 0.5).astype(np.int64)
    force = force_of(x, np.sign(np.cos(2 * np.pi * t)))
    return RunData(1, t, x, speed, force, np.ones(n, bool), half, np.tile(force, (4, 1)), np.tile(force, (4, 1)))


def test_shape_of_cycles_is_that_of_the_loop_they_were_made_from() -> None:
    """A rectangle has an equivalent damping of 2/pi; sliding forces in push and pull and the envelope are read off."""
    run = made_run(lambda x, sign: np.where(sign > 0, 50.0, -40.0) + (np.abs(x) > 39) * 10.0 * sign)
    shape = numbers.cycles_of(run, run.force_kN)
    assert shape.push_sliding_kN == pytest.approx(np.full(shape.push_kN.size, 50.0))
    assert shape.pull_sliding_kN == pytest.approx(np.full(shape.push_kN.size, -40.0))
    assert (shape.push_kN.max(), shape.pull_kN.min()) == (60.0, -50.0)
    flat = made_run(lambda _, sign: 50.0 * np.where(sign >= 0, 1, -1))
    shape = numbers.cycles_of(flat, flat.force_kN)
    assert shape.damping_percent == pytest.approx(np.full(shape.push_kN.size, 200 / np.pi), rel=0.01)
    elastic = made_run(lambda x, _: 2.0 * x)
    shape = numbers.cycles_of(elastic, elastic.force_kN)
    assert np.isnan(shape.push_sliding_kN).all()  # nothing slides
    assert shape.damping_percent == pytest.approx(np.zeros(shape.push_kN.size), abs=0.5)


def test_backbone_is_the_force_where_cycles_turn() -> None:
    """Friction of 50 kN and a spring of 0.5 kN/mm meet 20 kN more at the ends of a 40 mm stroke, either way."""
    run = made_run(lambda x, sign: 0.5 * x + np.where(np.abs(x) > 39.9, 50.0 * np.sign(x), 50.0 * sign))
    shape = numbers.cycles_of(run, 2 * run.force_kN)
    assert np.abs(shape.turn_mm) == pytest.approx(np.full(shape.turn_mm.size, 40.0), abs=0.01)
    assert shape.turn_kN == pytest.approx(np.sign(shape.turn_mm) * 70.0, abs=0.01)
    assert shape.model_turn_kN == pytest.approx(2 * shape.turn_kN)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.0168, 0.0172, "dep between +58.1 and +59.5 mm/s"),
        (-0.0125, -0.0100, "dep between -100 and -80 mm/s"),
        (-0.001, 0.002, "dep has no bound: the force may not depend on speed at all; if there is any"),
        (0.0, 0.002, "dep has no bound"),
    ],
)
def test_dep_is_said_beside_gamma(low: float, high: float, expected: str) -> None:
    assert expected in words.dep_words(low, high)


def test_unbounded_dep_says_where_it_could_be() -> None:
    assert "below -1000 or above +500 mm/s" in words.dep_words(-0.001, 0.002)


@pytest.mark.parametrize(
    ("value", "spread", "expected"),
    [
        (17.97122, 0.01578, "17.971"),
        (0.875477, 0.00041, "0.87548"),
        (331.2, 94.0, "331"),
        (2.0, 0.0, "2"),
        (5.0, float("inf"), "5"),
    ],
)
def test_digits_follow_the_spread(value: float, spread: float, expected: str) -> None:
    assert words.rounded(value, spread) == expected


def test_freed_parameters_are_answered_in_words() -> None:
    """Each run's own K, beta, gamma: the page says whether the interval of the change holds no change."""
    rng = np.random.default_rng(1)
    first, spread = rng.normal(18.0, 0.1, 4000), rng.normal(0.0, 0.1, 4000)
    device = SimpleNamespace(
        draws={"K": first, "gamma": first / 1800, "K_2": first + spread, "gamma_2": first / 1800 + 0.004}
    )
    same, changed = freed_words(device)  # type: ignore[arg-type]
    assert same.startswith("K, run 2 over run 1: 90 % interval 0.99")
    assert "does not show that K changed" in same
    assert changed.startswith("gamma, run 2 less run 1: 90 % interval 0.004 to 0.004 s/mm")
    assert "gamma changed between the runs" in changed


@pytest.mark.parametrize("n_runs", [1, 3, 6])
def test_the_key_of_the_energy_picture_has_room_for_every_run(elastoplastic: RunData, n_runs: int) -> None:
    energy = numbers.cycles_of(elastoplastic, elastoplastic.force_kN)
    picture = unquote(loops.energy([energy._replace(run=number) for number in range(1, n_runs + 1)]))
    width, height = map(float, re.findall(r'<svg width="(\d+)" height="(\d+)"', picture)[0])
    assert height > 0.4 * width
    assert picture.count(": model, 90 %") == n_runs


@pytest.mark.parametrize(
    ("counts", "tail"),
    [
        ((2,), ""),
        ((1, 7), " 1 of the 2 sets here rests on one"),
        ((2, 2, 4), " 2 of the 3 sets here rest"),
    ],
)
def test_sets_of_few_devices_are_counted_in_english(counts: tuple[int, ...], tail: str) -> None:
    result = SimpleNamespace(sets=[SimpleNamespace(devices=range(n)) for n in counts])
    text = campaign._few(result)
    assert tail in text
    assert ("sets here" in text) == bool(tail)
