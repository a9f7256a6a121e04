"""Formulas of an unknown misfit: each shape of the list is found beside noise, and none in noise alone."""

import numpy as np
import pytest
from scipy.signal import lfilter

from shj_bayes.inference.run import Run
from shj_bayes.mismatch.calibrate import Line
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.formula import CONSTANT, SHAPES, SINE_OF_PERIOD, find_formula
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.kinematics import motion_of

QUIET = Line(p_value=1.0, run=1, period_s=0.0, amplitude_kN=0.0)
SEEDS = range(20)


@pytest.fixture(scope="module")
def evidence():
    """Two runs of Table 1; only the motion matters here."""
    recordings = simulate_device(Truth(), seed=1, rate_Hz=5.0)
    return evidence_of([Run(r, motion_of(r)) for r in recordings], 4000)


def noise(evidence, seed, phi=0.8):
    """1 kN, correlated from sample to sample."""
    drawn = np.random.default_rng(seed).standard_normal(evidence.force_kN.size)
    return lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], drawn) * evidence.weight


def formula_of(evidence, shape, seed=3, line=QUIET, scatter=1.0, phi=0.8):
    """Formula of a shape of x (mm), d (mm), s (m), v (mm/s), t (s) and q, beside noise."""
    names = {"x": "position_mm", "d": "slip_mm", "s": "travel_m", "v": "speed_mm_s", "t": "time_s", "q": "direction"}
    residual = shape(**{letter: evidence.stack(name) for letter, name in names.items()}) * evidence.weight
    return find_formula(evidence, residual + scatter * noise(evidence, seed, phi), line)


# name, coordinate, mode, length or place (None: it has none), shape
CASES = {
    "line over position": ("line", "position", "friction", None, lambda x, q, **_: q * 4 * x / 95),
    "line over speed": ("line", "speed", "friction", None, lambda v, q, **_: q * 6 * (v / 10 - 0.6)),
    "line over travel": ("line", "travel", "force", None, lambda s, **_: 1.5 * (s - 3)),
    "parabola over position": ("parabola", "position", "friction", None, lambda x, q, **_: q * 5 * (x / 95) ** 2),
    "V in pull": ("modulus", "position", "pull", 30.0, lambda x, q, **_: 8 * np.abs(x - 30) / 95 * (q < 0)),
    "step over position": ("step", "position", "friction", -25.0, lambda x, q, **_: q * 4.0 * (x > -25)),
    "step with travel": ("step", "travel", "friction", 4.0, lambda s, q, **_: q * 4.0 * (s > 4)),
    "decay with slip": (
        "exponential",
        "slip since reversal",
        "friction",
        8.0,
        lambda d, q, **_: q * 6 * np.exp(-d / 8),
    ),
    "rise with travel": ("exponential", "travel", "friction", 1.5, lambda s, q, **_: q * 6 * (1 - np.exp(-s / 1.5))),
    "wave over position": (
        "sine",
        "position",
        "friction",
        24.8,
        lambda x, q, **_: q * 3 * np.sin(2 * np.pi * x / 24.8),
    ),
    "wave over slip": ("sine", "slip since reversal", "push", 31.0, lambda d, q, **_: 4 * np.cos(d / 4.934) * (q > 0)),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("seed", [3, 4, 5])
def test_each_shape_is_found_over_its_coordinate(evidence, case, seed):
    name, coordinate, mode, length, shape = CASES[case]
    found = formula_of(evidence, shape, seed)
    assert found.text is not None, found.words
    assert (found.fitted.shape.name, found.coordinate, found.fitted.mode) == (name, coordinate, mode)
    if length is not None:
        near = {"sine": 0.02 * length, "exponential": 0.2 * length}.get(name, 0.03 * found.scale)
        assert found.fitted.length * found.scale == pytest.approx(length, abs=near)
    assert 0.85 < found.share < 1.15
    assert 0.25 < found.part < 1.0


def test_each_direction_has_its_own_constant(evidence):
    found = formula_of(evidence, lambda q, **_: np.where(q > 0, 3.0, -1.0))
    assert found.fitted.shape is CONSTANT
    assert found.fitted.sizes == pytest.approx([3.0, -1.0], abs=0.3)
    assert found.text.startswith("residual [kN] = ")
    assert found.text.endswith(" in pull")


def test_a_wave_of_the_clock_is_a_sine_of_its_period(evidence):
    line = Line(p_value=1e-6, run=2, period_s=40.4, amplitude_kN=5.0)
    second = evidence.run == 2
    found = formula_of(evidence, lambda t, **_: 5 * np.sin(2 * np.pi * t / 40.0) * second, line=line)
    assert (found.coordinate, found.fitted.shape.name, found.fitted.mode) == ("time", "sine", "force")
    assert found.fitted.shape is SINE_OF_PERIOD
    assert found.scale == pytest.approx(40.0, rel=0.01)
    assert f"sin(2 pi t / {found.scale:.3g} s" in found.text
    assert "t is the time since the start of run 2" in found.text


@pytest.mark.parametrize("phi", [0.0, 0.9])
def test_noise_gets_no_formula(evidence, phi):
    found = [find_formula(evidence, noise(evidence, seed, phi), QUIET) for seed in SEEDS]
    assert [formula.text for formula in found] == [None] * len(SEEDS)
    assert all(formula.words.startswith("No formula: ") for formula in found)


def test_every_shape_of_the_list_is_tried_here():
    assert {case[0] for case in CASES.values()} | {CONSTANT.name} == {shape.name for shape in SHAPES}


def test_a_shape_that_is_not_on_the_list_gets_a_reason(evidence):
    """Eight bumps of random height and place come again in every cycle, but no curve of a few numbers holds them."""
    rng = np.random.default_rng(3)
    places = np.linspace(-80, 80, 8) + rng.uniform(-8, 8, 8)
    heights = rng.choice([-1.0, 1.0], 8) * rng.uniform(5, 8, 8)
    bumps = [lambda x, a=a, p=p: a * np.exp(-(((x - p) / 5) ** 2)) for a, p in zip(heights, places, strict=True)]
    found = formula_of(evidence, lambda x, q, **_: q * sum(bump(x) for bump in bumps))
    assert found.text is None
    assert found.words.startswith("No formula: none of a few numbers takes up more than")


def test_a_small_part_of_what_is_left_gets_no_formula(evidence):
    """The wave comes again and its formula is right, but it explains too little of what the reader sees."""
    wave = CASES["wave over position"][-1]
    found = formula_of(evidence, lambda **c: wave(**c) / 4, phi=0.0)
    assert found.text is None
    assert "takes up only" in found.words
    assert found.fitted.shape.name == "sine"


def test_a_curve_that_follows_a_simple_one_closely_gets_the_simple_one(evidence):
    """A decay much longer than the test is a straight line to anyone who reads it."""
    found = formula_of(evidence, lambda s, **_: 60 * (np.exp(-s / 40) - 0.9), scatter=0.3)
    assert found.fitted.shape.name == "line"


@pytest.mark.parametrize(
    ("shape", "text"),
    [
        (lambda x, q, **_: q * 3 * x / 95, "q * 3 x / 95 mm; "),
        (lambda x, q, **_: q * (5 * (x / 95) ** 2 - 1), "q * (5 (x / 95 mm)^2 - 1); "),
        (lambda x, **_: 4.0 * (x > 20) - 1, "4 step(x - 20"),
        (lambda s, **_: 6 * np.exp(-s / 1.5), "6 exp(-s / 1.5 m); "),
        (lambda s, **_: 2 + 6 * (1 - np.exp(-s / 1.5)), "6 (1 - exp(-s / 1.5 m)) + 2; "),
        (
            lambda x, q, **_: q * (3 * np.sin(2 * np.pi * x / 24.8 - 0.4) - 0.5),
            "q * (3 sin(2 pi x / 24.8 mm - 0.4) - 0.5)",
        ),
    ],
    ids=["line", "parabola", "step", "decay", "rise", "sine"],
)
def test_formulas_are_written_with_numbers_and_units(evidence, shape, text):
    found = formula_of(evidence, shape, scatter=0.0)
    assert found.text.startswith("residual [kN] = " + text)
