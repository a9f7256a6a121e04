"""Speed dependence that is not linear."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import MEMORIES, MEMORY, felt
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c b / max(b - u), b = ln(1 + u/u0) / ln(1 + 1/u0), u = |v|/v_peak; the straight part from gamma.

    b follows the speed over the memory.

    It is not taken from the clamping: gamma then made up for it, which by Eq. (2) acts on the elastic branches too (up
    to 0.6 kN of 65 wrong there).
    """
    corner = values["corner"]
    scale = np.log1p(1.0 / corner)
    speed = history.speed_mm_s / history.peak_speed_mm_s
    steepest = 1.0 / scale - corner  # where the slope of b is 1
    largest = np.log1p(steepest / corner) / scale - steepest
    size = values["size"] / largest
    bent = felt(np.log1p(speed / corner) / scale, history, base, values["memory"])
    return Contribution(clamping=1.0 + size * bent, gamma_s_per_mm=-size / history.peak_speed_mm_s)


def _power(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c (u^n - u), u = |v|/v_peak; the straight part is taken from gamma."""
    speed = np.maximum(history.speed_mm_s / history.peak_speed_mm_s, 1e-9)
    power = values["power"]
    place = power ** (1.0 / (1.0 - power))
    size = values["size"] / (place**power - place)
    bent = felt(speed**power, history, base, values["memory"])
    return Contribution(clamping=1.0 + size * bent, gamma_s_per_mm=-size / history.peak_speed_mm_s)


EFFECT = Effect(
    id="velocity_law",
    family="low_speed",
    title="Speed dependence that is not linear",
    statement="Speed dependence is bent: at low speed the sliding force is up to {size:+.0%} off a linear speed law.",
    equation="Fy -> Fy (1 + c h/max[b - u]), gamma |v| -> gamma |v| - c u/max[b - u], L dh/ds + h = b, "
    "b = ln(1 + u/u0)/ln(1 + 1/u0), u = |v|/v_peak, s slid",
    cause="Friction that follows the logarithm of speed or saturates, as most contacts do; a power law looks alike.",
    shows="Shoulders near both ends of every stroke, where the speed falls; flat around mid-stroke.",
    next_test="Triangular cycles at three or more speeds a factor of 5 apart: the law is then read off directly.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "Largest departure from the linear law; either sign."),
        Prior("corner", "1", "loguniform", 5e-4, 2.0, "Of the peak speed: below it linear, above it logarithmic."),
        MEMORY,
    ),
    act=act,
    acts=(("capacity", "speed"),),
    source="Rate-and-state friction with a cut-off: ln(1 + |v|/v0).",
    start={"size": (0.05, -0.05), "corner": (0.01, 0.2), **MEMORIES},
).with_form(
    "power",
    statement="Sliding force follows the power {power:.2f} of the speed: {size:+.1%} beside the linear law at most.",
    equation="Fy -> Fy (1 + c h/max[u^n - u]), gamma |v| -> gamma |v| - c u/max[u^n - u], L dh/ds + h = u^n, "
    "u = |v|/v_peak, s slid",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "Largest departure from the linear law; either sign."),
        Prior("power", "1", "loguniform", 0.05, 0.9, "Fluid films and lubricants: 0.1 to 0.8."),
        MEMORY,
    ),
    act=_power,
    source="Power law of viscous dampers: Constantinou and Symans (1993), F = C |v|^n sgn v.",
    start={"size": (0.05, -0.05), "power": (0.2, 0.5), **MEMORIES},
)
