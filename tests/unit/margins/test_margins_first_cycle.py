"""First cycle over third, off made recordings: the truth is known."""

import numpy as np
import pytest

from shj_bayes.margins.first_cycle import by_set, first_over_third, ratios
from shj_bayes.margins.pair import Bounds
from shj_bayes.margins.row import HIGH, LOW
from shj_bayes.margins.sheet import margins
from shj_bayes.population.posterior import ANY_SET


def made(first, amplitudes=(6.0, 48.0, 95.0), cycles=3):
    """A rigid 80 kN friction device with a knee of 12 mm: the very first cycle at 48 mm has ``first`` times that."""
    phase = np.arange(0, cycles, 0.002)
    x = np.concatenate([a * np.sin(2 * np.pi * phase) for a in amplitudes])
    turn = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1
    half = np.searchsorted(turn, np.arange(x.size), side="right")
    force = np.empty_like(x)
    for h in np.unique(half):
        of_it = half == h
        away = np.abs(x[of_it] - x[of_it][0])
        force[of_it] = np.sign(x[of_it][-1] - x[of_it][0]) * 80.0 * np.clip(away / 12.0 - 1.0 + (h == 0), -1.0, 1.0)
    block = np.repeat(np.arange(len(amplitudes)), phase.size)
    early = (block == 1) & (np.tile(phase, len(amplitudes)) < 1.25)
    return x, np.where(early, first * force, force), half, np.ones_like(x)


@pytest.mark.parametrize("first", [1.25, 1.0, 0.8])
def test_the_first_cycle_is_read_off(first):
    assert list(ratios(*made(first))) == pytest.approx([first], abs=0.01)


def test_nothing_is_said_without_three_cycles_that_slide():
    assert list(ratios(*made(1.2, cycles=2))) == []
    assert list(ratios(*made(1.2, amplitudes=(6.0,)))) in ([], pytest.approx([1.0], abs=0.01))


def test_a_folder_that_holds_no_recording_says_nothing(tmp_path):
    assert first_over_third(tmp_path) is None
    assert by_set([("a", tmp_path)]) == {}


def test_the_outermost_device_of_a_set_counts(monkeypatch, tmp_path):
    found = iter([Bounds(1.0, 1.05), Bounds(0.97, 1.0), None])
    monkeypatch.setattr("shj_bayes.margins.first_cycle.first_over_third", lambda folder: next(found))
    assert by_set([("a", tmp_path), ("a", tmp_path), ("b", tmp_path)]) == {
        "a": Bounds(0.97, 1.05),
        ANY_SET: Bounds(0.97, 1.05),
    }


def test_a_measured_first_cycle_moves_the_upper_bounds(population):
    """First cycle 1.25 times the third: every upper bound that rests on delivered force rises by a quarter."""
    plain, raised = (margins(population, first_cycles=cycles) for cycles in (None, {"Zinc 70": Bounds(1.0, 1.25)}))
    for kind in ("EN 15129 UBDP, importance class II", "phi_o equivalent", "lambda_test,max"):
        before, after = (s.get("Zinc 70", "Fy", kind, HIGH) for s in (plain, raised))
        assert after.value == pytest.approx(1.25 * before.value, rel=1e-6)
        assert "first cycle / third 1.000 to 1.250 as measured" in after.inputs
        assert "first cycle / third not measured" in before.inputs
    low = "EN 15129 LBDP, importance class II"
    assert raised.get("Zinc 70", "Fy", low, LOW).value == plain.get("Zinc 70", "Fy", low, LOW).value
