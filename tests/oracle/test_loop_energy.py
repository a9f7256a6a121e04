"""Energy of steady loops against their closed forms."""

import math

import numpy as np
import pytest

from shj_bayes.model.law import force
from shj_bayes.recording.motion import Block, exact_motion

RIGID = 1e6  # kN/mm: the knee is a ten-thousandth of a millimetre wide
# dep in mm/s and the factor on the energy at a peak speed of 10 mm/s
FACTORS = {30: 1.2618, 60: 1.1309, -30: 0.7382, -60: 0.8691, -90: 0.9127, -120: 0.9346, -150: 0.9476}
VARIANTS = ("published", "continuous")


def steady_energy(*, amplitude: float, speed: float = 10.0, n: int = 40_000, **law: float | str) -> float:
    """Work done in the last full cycle from one upper reversal to the next, kN mm."""
    frequency = speed / (2 * math.pi * amplitude)
    _, motion = exact_motion((Block(amplitude, frequency, 3),), n * frequency)
    loop = force(motion, **law)
    # From the middle of one half-cycle to the middle of the one after next: no integration across the ends.
    x = motion.displacement_mm
    a, b = (
        int(np.argmin(np.abs(x[i:j]))) + i
        for i, j in ((motion.start[3], motion.start[4]), (motion.start[5], motion.start[6]))
    )
    middle = 0.5 * (loop[a + 1 : b + 1] + loop[a:b])
    # Samples on both sides of a reversal belong to different branches: the step there is exact to second order only.
    return float(np.sum(middle * np.diff(x[a : b + 1])))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("K", "Fy", "amplitude"), [(18.0, 80.0, 95.0), (10.0, 60.0, 24.0), (18.0, 80.0, 6.0)])
def test_elastoplastic_loop(K: float, Fy: float, amplitude: float, variant: str) -> None:
    energy = steady_energy(amplitude=amplitude, K=K, Fy=Fy, beta=500.0, variant=variant)
    exact = 4 * Fy * (amplitude - Fy / K)
    # beta = 500 rounds the knee off by about Fy^2/(K beta); 0.3 % of the stroke-limited loop is more than that
    assert energy == pytest.approx(exact, rel=3e-3)
    stiffness = 2 * Fy / (2 * amplitude)
    damping = (2 / math.pi) * energy / (stiffness * (2 * amplitude) ** 2)
    assert damping == pytest.approx((2 / math.pi) * (1 - Fy / (K * amplitude)), rel=3e-3)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("dep", "factor"), FACTORS.items())
def test_speed_factor_of_a_rigid_device(dep: float, factor: float, variant: str) -> None:
    law = {"K": RIGID, "Fy": 80.0, "beta": 500.0, "variant": variant}
    energy = steady_energy(amplitude=95.0, gamma=1.0 / dep, **law)
    plain = 4 * 95.0 * 80.0
    assert energy / plain == pytest.approx(1 + math.pi / 4 * 10.0 / dep, abs=1e-4)
    assert energy / plain == pytest.approx(factor, abs=1.5e-4)


def test_rigid_plastic_damping_is_two_over_pi() -> None:
    energy = steady_energy(amplitude=95.0, K=RIGID, Fy=80.0, beta=500.0)
    assert (2 / math.pi) * energy / (80.0 / 95.0 * (2 * 95.0) ** 2) == pytest.approx(0.63662, abs=5e-5)


def test_rounder_knee_dissipates_less() -> None:
    """Not a closed form, but the order that the wrong exponent (1/beta left out) would break."""
    energies = [
        steady_energy(amplitude=24.0, K=18.0, Fy=80.0, beta=beta, variant="continuous") for beta in (1, 2, 10, 100)
    ]
    assert energies == sorted(energies)
    assert energies[-1] == pytest.approx(4 * 80 * (24 - 80 / 18), rel=2e-2)
