"""Formulas of an unknown misfit: the right one where a simple one holds, none in noise, and nothing executed."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from shj_bayes.mismatch.evolve import QUICK, evolve
from shj_bayes.mismatch.expression import (
    Factor,
    Term,
    apply,
    evaluate,
    n_numbers,
    number,
    sensible,
    tidy,
    times,
    variable,
)
from shj_bayes.mismatch.formula import find_formula
from shj_bayes.mismatch.formula_text import write_sum
from shj_bayes.mismatch.polish import freed, polish, shortened

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"
X = np.linspace(-1.0, 1.0, 64)
U = np.linspace(0.02, 1.0, 40)


@pytest.fixture(scope="module")
def trials():
    """The development trials, whose files import one another by their bare names."""
    before = {name: sys.modules.get(name) for name in ("mismatch", "mismatch_formula")}
    for name in before:
        spec = importlib.util.spec_from_file_location(name, BENCHMARKS / f"{name}.py")
        sys.modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(sys.modules[name])
    yield sys.modules["mismatch_formula"]
    for name, module in before.items():
        sys.modules.pop(name)
        if module is not None:
            sys.modules[name] = module


def fitted(x, y):
    """Shortest formula within 2 % of the best one."""
    found = evolve(x, y, np.full(x.size, 50.0), seed=1, effort=QUICK)
    limit = min(error for _, error in found) + 0.02 * 50.0 * float(np.sum((y - y.mean()) ** 2))
    return next(terms for terms, error in found if error <= limit)


def names(terms):
    return sorted(f.name for t in terms for f in t.factors)


def test_sums_say_the_same_as_numpy():
    line = variable(2.0, -0.5)
    product = times(line, line)
    assert_allclose(evaluate(product, X), (2 * X - 0.5) ** 2)
    assert_allclose(evaluate(apply("sin", line), X), np.sin(2 * X - 0.5))
    assert_allclose(evaluate(apply("exp", line), X), np.exp(2 * X - 0.5))
    assert_allclose(evaluate(apply("bell", line), X), np.exp(-((2 * X - 0.5) ** 2)))
    assert_allclose(evaluate(apply("step", line), X), (1 + np.tanh(2 * X - 0.5)) / 2)
    assert_allclose(evaluate(apply("abs", line), X), np.abs(2 * X - 0.5))
    assert tidy((*line, *times(number(-1.0), line))) == ()


def test_what_is_not_simple_is_refused():
    curve = times(variable(), variable())
    assert apply("sin", curve) is None
    assert times(times(curve, curve), variable()) is None
    wave = Term(1.0, 0, (Factor("sin", 1.0, 0.0),))
    assert not sensible((wave,), X, np.sin(X))  # less than one turn
    assert not sensible((Term(1.0, 0, (Factor("bell", 5.0, 20.0),)),), X, X)  # a bump outside the range
    assert not sensible((Term(90.0, 1), Term(-90.0, 3)), X, X)  # terms that cancel
    assert sensible((Term(1.0, 0, (Factor("sin", 8.0, 0.0),)),), X, X)


def test_polish_finds_the_numbers():
    y = 3.1 * np.sin(24.0 * X + 0.4) - 0.5
    start = freed((Term(1.0, 0, (Factor("sin", 23.5, 0.0),)),))
    terms, error = polish(start, X, y, np.ones_like(X))
    assert error < 1e-12
    assert_allclose(evaluate(terms, X), y, atol=1e-6)
    assert n_numbers(terms) == 4


def test_numbers_that_are_not_needed_are_dropped_last():
    y = 2.0 * np.sin(24.0 * X)
    ladder = shortened(freed((Term(1.0, 0, (Factor("sin", 23.8, 0.0),)),)), X, y, np.ones_like(X))
    assert [n_numbers(terms) for terms, _ in ladder] == [4, 3, 2]
    assert ladder[-1][1] < 1e-9


@pytest.mark.parametrize(
    ("x", "y", "kinds"),
    [
        (X, np.sin(24.0 * X + 0.7), ["sin"]),
        (X, X**3 - 0.6 * X, []),
        (X, np.exp(-(((X - 0.3) / 0.1) ** 2)), ["bell"]),
        (X, (X > 0.25) * 1.0, ["step"]),
        (X, (np.abs(X + 0.1) < 0.3) * 1.0, ["step", "step"]),
        (U, np.exp(-5.0 * U) - 0.2, ["exp"]),
        (X, np.abs(X - 0.2), ["abs"]),
    ],
    ids=["wave", "cubic", "bump", "step", "patch", "decay", "vee"],
)
def test_simple_shapes_are_found_again(x, y, kinds):
    rng = np.random.default_rng(5)
    assert names(fitted(x, y + 0.05 * rng.standard_normal(x.size))) == kinds


def test_same_seed_same_formula():
    y = np.sin(24.0 * X) + 0.1 * np.random.default_rng(2).standard_normal(X.size)
    assert fitted(X, y) == fitted(X, y)


def test_formulas_are_written_with_units():
    wave = Term(3.1, 0, (Factor("sin", 2 * np.pi * 95 / 24.8, 0.0),))
    assert write_sum((wave,), "x", 95.0, "mm") == "3.1 sin(2 pi x / 24.8 mm)"
    turned = Term(-2.0, 0, (Factor("sin", -2 * np.pi * 95 / 24.8, np.pi + 0.4),))
    text = write_sum((turned, Term(-0.25)), "x", 95.0, "mm")
    assert text == "-2 sin(2 pi x / 24.8 mm - 0.4) - 0.25"
    value = -2.0 * np.sin(-2 * np.pi * 95 / 24.8 * X + np.pi + 0.4)
    assert_allclose(value, -2 * np.sin(2 * np.pi * 95 * X / 24.8 - 0.4), atol=1e-9)
    bump = Term(4.0, 0, (Factor("bell", 9.5, -2.85),))
    assert write_sum((bump,), "x", 95.0, "mm") == "4 exp(-((x - 28.5 mm) / 10 mm)^2)"
    assert write_sum((Term(2.0, 0, (Factor("exp", -5.0, 0.0),)),), "s", 7.7, "m") == "2 exp(-s / 1.54 m)"
    assert write_sum((Term(-2.0, 3), Term(1.0, 1)), "x", 95.0, "mm") == "-2 (x / 95 mm)^3 + 1 x / 95 mm"
    step = Term(2.0, 0, (Factor("step", -50.0, 10.0),))
    assert write_sum((step,), "x", 100.0, "mm") == "2 step((20 mm - x) / 2 mm)"


def test_a_wave_over_position_gets_its_formula(trials):
    right, words = trials.shape_trial("wave over position", 21)
    assert right, words
    assert words.startswith("residual [kN] = q * ")
    assert "x is the position from mid-stroke" in words


def test_a_wave_of_the_clock_gets_its_formula(trials):
    right, words = trials.shape_trial("wave over time", 22)
    assert right, words
    assert "t is the time since the start of run" in words


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_noise_gets_no_formula(trials, phi):
    assert [trials.noise_trial(phi, seed) for seed in (31, 32, 33)] == ["none"] * 3


def test_a_shape_that_is_not_simple_gets_a_reason(trials):
    """Eight bumps of random height and place come again in every cycle, but no formula of a few numbers holds them."""
    rng = np.random.default_rng(3)
    places, heights = (
        np.linspace(-80, 80, 8) + rng.uniform(-8, 8, 8),
        rng.choice([-1.0, 1.0], 8) * rng.uniform(0.6, 1, 8),
    )
    shape = lambda h: (  # noqa: E731
        0.1
        * h.direction
        * sum(a * np.exp(-(((h.position_mm - p) / 5) ** 2)) for a, p in zip(heights, places, strict=True))
    )
    evidence = trials._evidence(sys.modules["mismatch"].simulate({}, 23, shape=shape))
    base = trials._fit(evidence)
    formula = find_formula(evidence, base.residual_kN, 70.0, trials.strongest_line(evidence, base), quick=True)
    assert formula.text is None
    assert formula.words.startswith("No formula: none of a few numbers takes up more than")
    assert formula.terms == ()
