"""Speed dependence that is not linear."""

from __future__ import annotations

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c [u^n - u] / max(u^n - u), u = |v|/v0: what a power law adds to the straight line."""
    n = values["power"]
    speed = history.speed_mm_s / history.peak_speed_mm_s
    bend = np.exp(n * np.log(np.maximum(speed, 1e-9))) - speed
    largest = n ** (n / (1 - n)) * (1 - n)
    return Contribution(clamping=1.0 + values["size"] / largest * bend)


EFFECT = Effect(
    id="velocity_law",
    family="low_speed",
    title="Speed dependence that is not linear",
    statement="Speed dependence is bent: at low speed the sliding force is up to {size:+.0%} off a linear speed law.",
    equation="Fy -> Fy (1 + c [u^n - u] / max[u^n - u]), u = |v|/v_peak; n -> 0 is the logarithmic law",
    cause="Friction that follows the power or the logarithm of speed, or saturates, as most contacts do.",
    shows="Shoulders near both ends of every stroke, where the speed falls; flat around mid-stroke.",
    next_test="Triangular cycles at three or more speeds a factor of 5 apart: the law is then read off directly.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "Largest departure from the linear law; either sign."),
        Prior("power", "1", "uniform", 0.05, 0.9, "Power laws of 0.1 to 0.5 are common; the log law is the limit 0."),
    ),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E13; OpenSees VelDependent friction (saturating form).",
    start={"size": (0.05, -0.05), "power": (0.3,)},
)
