"""Speed dependence that is not linear."""

from __future__ import annotations

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c [b(u) - u] / max(b - u), b = ln(1 + u/u0) / ln(1 + 1/u0), u = |v|/v_peak: bent beside straight."""
    corner = values["corner"]
    scale = np.log1p(1.0 / corner)
    speed = history.speed_mm_s / history.peak_speed_mm_s
    steepest = 1.0 / scale - corner  # where the slope of b is 1
    largest = np.log1p(steepest / corner) / scale - steepest
    return Contribution(clamping=1.0 + values["size"] / largest * (np.log1p(speed / corner) / scale - speed))


EFFECT = Effect(
    id="velocity_law",
    family="low_speed",
    title="Speed dependence that is not linear",
    statement="Speed dependence is bent: at low speed the sliding force is up to {size:+.0%} off a linear speed law.",
    equation="Fy -> Fy (1 + c [b - u] / max[b - u]), b = ln(1 + u/u0)/ln(1 + 1/u0), u = |v|/v_peak",
    cause="Friction that follows the logarithm of speed or saturates, as most contacts do; a power law looks alike.",
    shows="Shoulders near both ends of every stroke, where the speed falls; flat around mid-stroke.",
    next_test="Triangular cycles at three or more speeds a factor of 5 apart: the law is then read off directly.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "Largest departure from the linear law; either sign."),
        Prior("corner", "1", "loguniform", 5e-4, 2.0, "Of the peak speed: below it linear, above it logarithmic."),
    ),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E13: ln(1 + |v|/v0), rate-and-state friction with a cut-off.",
    start={"size": (0.05, -0.05), "corner": (0.01, 0.2)},
)
