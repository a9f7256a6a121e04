"""The compiled law against the paper's equations, written out sample by sample in plain Python."""

import math

import numpy as np
import pytest

from shj_bayes.model.law import force, force_of_laws
from shj_bayes.recording.motion import Motion, exact_motion, table_1

RATE_HZ = 20.0
TOLERANCE = 1e-10  # of Fy
BETAS = (1.0, 2.0, 10.0, 100.0, 500.0)
VARIANTS = ("published", "continuous")


def menegotto_pinto(e: float, fy: float, sign_v: float, beta: float) -> float:
    """Eq. (1), as printed."""
    try:
        return e / (1.0 + abs(e / (fy * sign_v)) ** beta) ** (1.0 / beta)
    except OverflowError:  # the same number with the large power taken out of the bracket
        size = abs(e / (fy * sign_v))
        return e / (size * (1.0 + size**-beta) ** (1.0 / beta))


def regime() -> list[tuple[float, float, float]]:
    """Table 1 in plain Python: displacement, velocity (signed) and x_reset at each sample."""
    samples = []
    begin, number, turns, x_reset = 0.0, 0, 0, 0.0
    for block in table_1():
        end = begin + block.n_cycles / block.frequency_Hz
        omega = 2 * math.pi * block.frequency_Hz
        turns = 0
        while number / RATE_HZ < end or (block is table_1()[-1] and number / RATE_HZ <= end):
            since = number / RATE_HZ - begin
            while since >= (2 * turns + 1) / (4 * block.frequency_Hz) and turns < 2 * block.n_cycles:
                x_reset = block.amplitude_mm * (1 if turns % 2 == 0 else -1)
                turns += 1
            samples.append(
                (
                    block.amplitude_mm * math.sin(omega * since),
                    block.amplitude_mm * omega * math.cos(omega * since),
                    x_reset,
                )
            )
            number += 1
        begin = end
    return samples


def transcription(
    *, K: float, Fy: float, beta: float, gamma: float, variant: str, start_force: float = 0.0
) -> tuple[list[float], list[float]]:
    """Displacement and force: Eq. (1) with Eq. (2) at every sample of Table 1."""
    xs, forces = [], []
    x_reset, f_reset, sign_v = 0.0, start_force, 1.0
    for x, v, new_reset in regime():
        if new_reset != x_reset:
            # F_reset is the force of Eq. (1) alone at the instant of the reversal, before Eq. (2) multiplies it
            e = K * (new_reset - x_reset) + f_reset
            saturates = variant == "published" or e * sign_v > 0
            f_reset = menegotto_pinto(e, Fy, sign_v, beta) if saturates else e
            x_reset, sign_v = new_reset, -sign_v
        e = K * (x - x_reset) + f_reset
        saturates = variant == "published" or e * sign_v > 0
        held = menegotto_pinto(e, Fy, sign_v, beta) if saturates else e
        xs.append(x)
        forces.append(held * (1.0 + gamma * abs(v)))
    return xs, forces


@pytest.fixture(scope="module")
def motion() -> Motion:
    """Table 1, exactly."""
    return exact_motion(table_1(), RATE_HZ)[1]


@pytest.mark.parametrize("start_force", [0.0, 35.0, -60.0])
@pytest.mark.parametrize("gamma", [0.0, 1 / 30, -1 / 30])
@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("variant", VARIANTS)
def test_law_is_the_printed_equation(
    motion: Motion, variant: str, beta: float, gamma: float, start_force: float
) -> None:
    x, expected = transcription(K=18.0, Fy=80.0, beta=beta, gamma=gamma, variant=variant, start_force=start_force)
    assert len(x) == motion.displacement_mm.size
    assert np.abs(np.array(x) - motion.displacement_mm).max() < 1e-10
    law = np.array([[18.0, 80.0, beta, gamma]])
    got = force_of_laws(motion, law, variant=variant, start_force_kN=start_force)[0]
    assert np.all(np.isfinite(got))
    assert np.abs(got - np.array(expected)).max() < TOLERANCE * 80.0


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(("K", "Fy"), [(1.0, 95.0), (18.0, 10.0), (500.0, 0.01), (1e-3, 1e3)])
@pytest.mark.parametrize("beta", BETAS)
def test_law_far_from_the_knee(motion: Motion, beta: float, K: float, Fy: float, variant: str) -> None:
    """Devices that hardly slide, and devices whose elastic branch runs a million times ahead of Fy."""
    law = {"K": K, "Fy": Fy, "beta": beta, "gamma": 0.02, "variant": variant}
    got = force(motion, **law)
    assert np.all(np.isfinite(got))
    assert np.abs(got - np.array(transcription(**law)[1])).max() < TOLERANCE * Fy


def unloading(n: int = 201) -> Motion:
    """One half-cycle downwards from x = 0."""
    x = -np.linspace(0.0, 50.0, n)
    return Motion(x, np.full(n, 10.0), np.array([0, n]), np.array([0.0]), np.array([-1]))


@pytest.mark.parametrize(("beta", "share"), [(2.0, 0.707), (10.0, 0.933), (100.0, 0.993)])
def test_jump_at_a_reversal_from_the_sliding_force(beta: float, share: float) -> None:
    law = np.array([[18.0, 80.0, beta, 0.0]])
    published, continuous = (
        force_of_laws(unloading(), law, variant=variant, start_force_kN=80.0)[0, 0] for variant in VARIANTS
    )
    assert published / 80.0 == pytest.approx(2.0 ** (-1.0 / beta), rel=1e-12)
    assert published / 80.0 == pytest.approx(share, abs=5e-4)
    assert continuous == 80.0


@pytest.mark.parametrize("beta", [2.0, 10.0, 100.0])
def test_continuous_law_has_no_jump_anywhere(beta: float) -> None:
    """Its largest step shrinks with the sampling interval; that of the published law does not."""
    steps = {}
    for variant in VARIANTS:
        for rate in (50.0, 500.0):
            fine = exact_motion(table_1()[3:4], rate)[1]
            steps[variant, rate] = np.abs(
                np.diff(force(fine, K=18.0, Fy=80.0, beta=beta, gamma=0.01, variant=variant))
            ).max()
    assert steps["continuous", 500.0] < 0.11 * steps["continuous", 50.0]
    assert steps["published", 500.0] > 0.9 * 80.0 * (1 - 2.0 ** (-1.0 / beta))


def triangle(speed: float = 10.0, amplitude: float = 20.0, n: int = 400) -> Motion:
    """Four half-cycles at constant speed, so that the speed is not zero at the reversals."""
    legs = [np.linspace(0, amplitude, n)]
    for k in range(3):
        top = amplitude * (-1) ** k
        legs.append(np.linspace(top, -top, 2 * n))
    x = np.concatenate(legs)
    turning = np.array([0.0, amplitude, -amplitude, amplitude])
    start = np.concatenate([[0], np.cumsum([leg.size for leg in legs])])
    return Motion(x, np.full(x.size, speed), start, turning, np.array([1, -1, 1, -1]))


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("gamma", [1 / 30, -1 / 30])
def test_force_at_the_reversal_is_carried_without_the_rate_factor(variant: str, gamma: float) -> None:
    """At constant speed Eq. (2) is one common factor; a rate-bearing F_reset would spoil it after the first turn."""
    law = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "variant": variant}
    still = force(triangle(), **law, gamma=0.0)
    moving = force(triangle(), **law, gamma=gamma)
    assert np.abs(moving - still * (1 + gamma * 10.0)).max() < TOLERANCE * 80.0


@pytest.mark.parametrize("variant", VARIANTS)
def test_push_and_pull_are_alike(motion: Motion, variant: str) -> None:
    """|v|, not v: the mirrored history gives the mirrored force, also with speed dependence."""
    mirrored = Motion(-motion.displacement_mm, motion.speed_mm_s, motion.start, -motion.turning_mm, -motion.direction)
    law = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "gamma": 1 / 30, "variant": variant}
    assert np.array_equal(force(mirrored, **law), -force(motion, **law))
    slides = np.abs(motion.displacement_mm) < 1.0
    late = slides & (np.arange(slides.size) > motion.start[-5])
    push = force(motion, **law)[late & (motion.direction[motion.half_cycle] > 0)]
    pull = force(motion, **law)[late & (motion.direction[motion.half_cycle] < 0)]
    assert push.mean() == pytest.approx(-pull.mean(), rel=1e-3)
    assert push.mean() == pytest.approx(80.0 * (1 + 10.0 / 30), rel=0.03)  # a signed v would give 0.67 in pull
