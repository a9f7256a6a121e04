"""Devices of the development trials: the catalogue's own formulas, and others, on the paper's Table 1.

5 Hz, AR(1) noise of 1 kN, displacement noise of 0.02 mm. As they hold the formulas of the catalogue they set thresholds
and test code; they prove nothing (`shj_validation.proof` does).
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.device import force_with_effects
from shj_bayes.model.effects.effect import Base, Contribution, Effect, catalogue
from shj_bayes.model.history import History, histories
from shj_bayes.recording.motion import exact_motion, table_1
from shj_bayes.recording.recording import Recording

RATE_HZ = 5.0
Values = dict[str, dict[str, float]]
Shape = Callable[[History], FloatArray]

EFFECTS: Values = {
    "prying": {"size": 0.08, "power": 2.0},
    "centre_wear": {"size": 0.08, "width": 0.3},
    "velocity_law": {"size": 0.08},
    "stribeck": {"size": 0.12, "speed": 2.0},
    "breakaway": {"size": 0.15, "decay": 4.0, "growth": 0.3},
    "two_stage": {"size": 0.3, "delay": 3.0},
    "slack": {"size": 0.8, "softness": 0.1},
    "sensor_lag": {"size": 0.08},
    "end_bearing": {"size": 0.03, "contact": 0.9, "side": 0.0, "returned": 0.0},
    "wear": {"size": 0.02},
    "bedding_in": {"size": 0.1, "travel": 0.5},
    "thermal": {"size": 0.1, "cooling": 120.0},
    "tension_step": {"size": -0.08, "begin": 0.3, "length": 1.0, "side": 0.0},
    "amplitude": {"size": 0.03},
    "drift": {"size": 0.08},
    "asymmetry": {"size": 0.08},
    "load_offset": {"size": 0.08},
    "taper": {"size": 0.08},
    "restoring": {"size": 0.08},
    "friction_memory": {"size": 0.08},
    "stick_slip": {"size": 0.08, "wave": 8.0},
}
PAIRS = (("slack", "asymmetry"), ("wear", "prying"), ("breakaway", "taper"))
NOISES = ("white", "ar1 0.8", "ar1 0.95", "student", "heteroscedastic", "slow drift", "quantised")
OUTSIDE: dict[str, Shape] = {
    "screw ripple, 25 mm": lambda h: 0.08 * h.direction * np.sin(2 * np.pi * h.position_mm / 25.0),
    "bumps at two places": lambda h: (
        0.12 * h.direction * (np.exp(-(((h.position_mm - 30) / 6) ** 2)) - np.exp(-(((h.position_mm + 45) / 6) ** 2)))
    ),
    "mains wave, 40 s": lambda h: 0.08 * np.sin(2 * np.pi * h.time_s / 40.0),
    "kink at a quarter": lambda h: 0.1 * h.direction * (np.abs(h.position_mm - 24) < 12),
}


def simulate(
    values: Values,
    seed: int,
    *,
    noise: str = "ar1 0.8",
    shape: Shape | None = None,
    gamma: float | None = None,
    clamping: Shape | None = None,
) -> list[Recording]:
    """Two runs of Table 1 of a device drawn from the range of the published tables; gamma may be given.

    Parameters
    ----------
    values : mapping
        Effects of the catalogue with some of their parameters.
    seed : int
        Of the device and its noise.
    noise : str
        One of `NOISES`.
    shape : callable, optional
        Force that is added, of the first run's sliding force.
    gamma : float, optional
        s/mm.
    clamping : callable, optional
        Factor on the sliding force.
    """
    rng = np.random.default_rng(seed)
    stiffness, capacity = rng.uniform(8, 22), rng.uniform(50, 95)
    beta, ratio = float(rng.choice([10.0, 100.0])), rng.uniform(0.6, 0.95)
    drawn = float(rng.choice([-1.0, 0.0, 1.0])) / rng.uniform(30, 150)
    gamma = drawn if gamma is None else gamma
    time, motion = exact_motion(table_1(), RATE_HZ)
    known = catalogue()
    acting = [(known[name], _whole(known[name], given)) for name, given in values.items()]
    if clamping is not None:
        own = replace(known["wear"], id="clamping", act=lambda h, v, b: Contribution(clamping(h)))
        acting.append((own, {}))
    out = []
    for history in histories([time, time], [motion, motion]):
        base = Base(stiffness, capacity * (ratio if history.run == 2 else 1.0), beta, gamma, capacity)
        force = force_with_effects(history, base, acting)
        if shape is not None:
            force = force + capacity * shape(history)
        force = force + _noise(noise, motion.speed_mm_s, rng)
        if noise == "quantised":
            force = np.round(force / 2.0) * 2.0
        wobble = 0.02 * rng.standard_normal(time.size)
        out.append(Recording(time, motion.displacement_mm + wobble, force))
    return out


def _whole(effect: Effect, given: dict[str, float]) -> dict[str, float]:
    """Complete the parameters of an effect with the medians of their priors."""
    unknown = set(given) - set(effect.names)
    assert not unknown, f"{effect.id} has no {unknown}"
    return {p.name: given.get(p.name, float(p.distribution.median())) for p in effect.parameters}


def ar1(phi: float, n: int, rng: np.random.Generator, *, nu: float = np.inf) -> FloatArray:
    """Noise of 1 kN with correlation `phi` from sample to sample; its innovations follow Student's t."""
    draw = rng.standard_t(nu, n) if np.isfinite(nu) else rng.standard_normal(n)
    draw[0] /= np.sqrt(1 - phi**2)
    return np.asarray(lfilter([np.sqrt(1 - phi**2)], [1.0, -phi], draw))


def _noise(kind: str, speed: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Force noise of about 1 kN."""
    n = speed.size
    if kind == "white":
        return rng.standard_normal(n)
    if kind == "student":
        return ar1(0.8, n, rng, nu=4.0)
    series = ar1(0.95 if kind == "ar1 0.95" else 0.8, n, rng)
    if kind == "heteroscedastic":  # four times the variance near reversals, heavy tails
        return series + 1.7 * (speed < 4.0) * ar1(0.8, n, rng, nu=4.0)
    if kind == "slow drift":
        return series + ar1(0.99, n, rng)
    return series
