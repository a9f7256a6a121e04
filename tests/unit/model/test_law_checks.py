"""What the law refuses, how it treats batches, and its compiled logarithm and exponential."""

import math
import re

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.model import law as kernel
from shj_bayes.model.law import force, force_of_laws
from shj_bayes.recording.motion import Block, exact_motion

MOTION = exact_motion((Block(12.0, 0.13, 2),), 10.0)[1]
GOOD = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "gamma": 0.01}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": 0.0}, "K = 0 kN/mm: allowed is above 0 kN/mm"),
        ({"K": -3.0}, "K = -3 kN/mm: allowed is above 0 kN/mm"),
        ({"K": math.nan}, "K = nan kN/mm"),
        ({"Fy": math.inf}, "Fy = inf kN: allowed is above 0 kN"),
        ({"Fy": -1.0}, "Fy = -1 kN: allowed is above 0 kN"),
        ({"beta": 0.99}, "beta = 0.99: allowed is 1 to 500"),
        ({"beta": 501.0}, "beta = 501: allowed is 1 to 500"),
        ({"gamma": math.nan}, "gamma = nan s/mm"),
        ({"variant": "smooth"}, "model 'smooth' is not known; choose one of published, continuous"),
    ],
)
def test_parameters_outside_their_range(change: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=re.escape(message)):
        force(MOTION, **(GOOD | change))


def test_a_start_force_must_be_a_number() -> None:
    with pytest.raises(ModelError, match="start force = nan kN: it must be a finite number"):
        force_of_laws(MOTION, np.array([list(GOOD.values())]), start_force_kN=math.nan)


def test_shapes_are_checked() -> None:
    with pytest.raises(ModelError, match=re.escape("laws has shape (2, 3); it needs (m, 4)")):
        force_of_laws(MOTION, np.ones((2, 3)))


@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_batch_is_one_by_one_to_the_bit(variant: str) -> None:
    rng = np.random.default_rng(1)
    m = 9
    laws = np.stack(
        [rng.uniform(5, 30, m), rng.uniform(20, 95, m), 10 ** rng.uniform(0, 2.69, m), rng.normal(0, 0.02, m)], 1
    )
    batch = force_of_laws(MOTION, laws, variant=variant)
    for row, law in zip(batch, laws, strict=True):
        assert np.array_equal(row, force_of_laws(MOTION, law[None], variant=variant)[0])


def test_logarithm_and_exponential_of_the_kernel() -> None:
    rng = np.random.default_rng(2)
    for u in 10.0 ** rng.uniform(-290, 290, 4000):
        assert kernel.log2(u) == pytest.approx(math.log2(u), rel=1e-15, abs=4e-16)
    for u in 1.0 + rng.uniform(-0.4, 0.6, 4000):  # through 1, where the logarithm changes sign
        assert kernel.log2(u) == pytest.approx(math.log2(u), rel=1e-14, abs=4e-16)
    for t in rng.uniform(-1000, 1000, 4000):
        assert kernel.exp2(t) == pytest.approx(2.0**t, rel=1e-15)


@pytest.mark.parametrize("beta", [1.0, 2.5, 33.0, 500.0])
def test_saturation_is_odd_bounded_and_rising(beta: float) -> None:
    above = np.geomspace(1e-12, 1e8, 800)
    e = np.concatenate([-above[::-1], [0.0], above])
    knee = kernel.knee_of(beta)
    held = np.array([kernel.held_at(v, 0.0, 80.0, beta, knee) for v in e])
    assert np.array_equal(held, -held[::-1])
    assert np.all(np.abs(held) <= np.minimum(np.abs(e), 80.0) * (1 + 1e-14))
    assert np.all(np.diff(held) >= -1e-13 * 80.0)
    assert abs(held[-1]) == pytest.approx(80.0, rel=1e-3 if beta > 1 else 1e-5)
