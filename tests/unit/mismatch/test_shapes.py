"""Formulas for curves that nobody has named."""

import re

import numpy as np
import pytest

from shj_bayes.mismatch.regions import formula_of


def formula(curve: np.ndarray, at: np.ndarray, half: float = 0.3, name: str = "x", unit: str = "mm") -> str | None:
    return formula_of(at, curve, curve - half, curve + half, name, unit)


X = np.linspace(-95.0, 95.0, 61)
T = np.linspace(0.0, 600.0, 61)


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"[-+]?[0-9.]+(?:e[-+]?[0-9]+)?", text)]


def test_a_wave_has_its_length() -> None:
    found = formula(8.0 * np.sin(2 * np.pi * T / 40.0 + 0.5), T, name="t", unit="s")
    assert found is not None
    size, _, length = numbers(found)[:3]
    assert (size, length) == (pytest.approx(8.0, rel=0.05), pytest.approx(40.0, rel=0.02))
    assert "sin(2 pi t /" in found


@pytest.mark.parametrize("place", [-40.0, 0.0, 30.0])
def test_a_step_has_its_place(place: float) -> None:
    """As a smooth curve shows it."""
    found = formula(5.0 / (1.0 + np.exp(-(X - place) / 2.0)), X)
    assert found is not None
    step = re.search(r"^([-+0-9.e]+) step\(x - ([-+0-9.e]+) mm\)", found)
    assert step is not None, found
    assert float(step[1]) == pytest.approx(5.0, rel=0.1)
    assert float(step[2]) == pytest.approx(place, abs=2.5)


def test_a_line_is_a_line() -> None:
    found = formula(3.0 * T / 600.0 - 1.0, T, name="t", unit="s")
    assert found == "3 t/range -1"


def test_a_line_begins_where_its_range_does() -> None:
    found = formula(4.0 * (X + 95.0) / 190.0, X)
    assert found is not None
    assert found.startswith("4 (x - -95 mm)/range")


def test_a_decay_has_its_length() -> None:
    found = formula(10.0 * np.exp(-T / 100.0), T, name="t", unit="s", half=0.2)
    assert found is not None
    length = re.search(r"^[0-9.]+ exp\(-t / ([0-9.e+]+) s\)", found)
    assert length is not None, found
    assert float(length[1]) == pytest.approx(100.0, rel=0.15)


def test_a_bend_has_its_place() -> None:
    found = formula(0.1 * np.abs(X - 20.0), X)
    assert found is not None
    assert "|x - 2" in found
    assert "|/range" in found


def test_the_simplest_within_the_band_is_taken() -> None:
    """What bends by less than matters is a line."""
    bent = 3.0 * T / 600.0 + 0.4 * (T / 600.0) ** 2
    assert "^2" not in (formula(bent, T, name="t", unit="s") or "^2")
    assert "^2" in (formula(bent + 9.0 * (T / 600.0) ** 2, T, name="t", unit="s") or "")


def test_two_bumps_have_no_formula_of_a_few_numbers() -> None:
    bumps = 12.0 * (np.exp(-(((X - 30) / 6) ** 2)) - 0.5 * np.exp(-(((X + 45) / 9) ** 2)))
    assert formula(bumps, X) is None
