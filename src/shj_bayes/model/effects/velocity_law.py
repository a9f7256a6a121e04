"""Speed dependence that is not linear."""

from collections.abc import Callable

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import MEMORIES, MEMORY, felt
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

SIZE = Prior("size", "1", "normal", 0.0, 0.15, "Largest departure from the linear law; either sign.")
CORNER = Prior("corner", "1", "loguniform", 5e-4, 2.0, "Of the peak speed: below it linear, above it logarithmic.")

BENT = "Speed dependence is bent: at low speed the sliding force is up to {size:+.0%} off a linear law."
BESIDE = "Fy -> Fy (1 + c h/max[b - u]), gamma |v| -> gamma |v| - c u/max[b - u], L dh/ds + h = b"
STARTS, CORNERS = {"size": (0.05, -0.05), **MEMORIES}, (0.01, 0.2)


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c b / max(b - u), b = ln(1 + u/u0) / ln(1 + 1/u0), u = |v|/v_peak; the straight part from gamma.

    b follows the speed over the memory.

    It is not taken from the clamping: gamma then made up for it, which by Eq. (2) acts on the elastic branches too (up
    to 0.6 kN of 65 wrong there).
    """
    corner = values["corner"]
    scale = np.log1p(1.0 / corner)
    return _beside_the_straight(lambda u: np.log1p(u / corner) / scale, 1.0 / scale - corner, history, values, base)


def _activated(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c b / max(b - u), b = asinh(u/u0) / asinh(1/u0); the straight part is taken from gamma."""
    corner = values["corner"]
    scale = float(np.arcsinh(1.0 / corner))
    steepest = np.sqrt(1.0 / scale**2 - corner**2)
    return _beside_the_straight(lambda u: np.arcsinh(u / corner) / scale, steepest, history, values, base)


def _power(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c (u^n - u), u = |v|/v_peak; the straight part is taken from gamma."""
    power = values["power"]
    place = power ** (1.0 / (1.0 - power))
    return _beside_the_straight(lambda u: np.maximum(u, 1e-9) ** power, place, history, values, base)


def _beside_the_straight(
    law: Callable[[FloatArray], FloatArray], place: float, history: History, values: Values, base: Base
) -> Contribution:
    """Clamping 1 + c h / max(b - u) for a law b(u), 1 at u = 1, and gamma less the straight part.

    h follows b over the memory; the law is furthest from the straight line at `place`, where its slope is 1.
    """
    size = values["size"] / (law(np.array(place)) - place)
    bent = felt(law(history.speed_mm_s / history.peak_speed_mm_s), history, base, values["memory"])
    return Contribution(clamping=1.0 + size * bent, gamma_s_per_mm=float(-size / history.peak_speed_mm_s))


EFFECT = (
    Effect(
        id="velocity_law",
        family="low_speed",
        title="Speed dependence that is not linear",
        statement=BENT,
        equation=f"{BESIDE}, b = ln(1 + u/u0)/ln(1 + 1/u0), u = |v|/v_peak, s slid",
        cause="Friction that follows the logarithm of speed or saturates, as most contacts do; a power law looks "
        "alike.",
        shows="Shoulders near both ends of every stroke, where the speed falls; flat around mid-stroke.",
        next_test="Triangular cycles at three or more speeds a factor of 5 apart: the law is then read off directly.",
        parameters=(SIZE, CORNER, MEMORY),
        act=act,
        acts=(("capacity", "speed"),),
        source="Rate-and-state friction with a cut-off: ln(1 + |v|/v0).",
        start=STARTS | {"corner": CORNERS},
    )
    .with_form(
        "power",
        statement="Sliding force follows the power {power:.2f} of the speed: {size:+.1%} off a linear law at most.",
        equation="Fy -> Fy (1 + c h/max[u^n - u]), gamma |v| -> gamma |v| - c u/max[u^n - u], L dh/ds + h = u^n, "
        "u = |v|/v_peak, s slid",
        parameters=(
            SIZE,
            Prior("power", "1", "loguniform", 0.05, 0.9, "Fluid films and lubricants: 0.1 to 0.8."),
            MEMORY,
        ),
        act=_power,
        source="Power law of viscous dampers: Constantinou and Symans (1993), F = C |v|^n sgn v.",
        start=STARTS | {"power": (0.2, 0.5)},
    )
    .with_form(
        "asinh",
        statement=BENT,
        equation=f"{BESIDE}, b = asinh(u/u0)/asinh(1/u0), u = |v|/v_peak, s slid",
        parameters=(SIZE, CORNER, MEMORY),
        act=_activated,
        source="Thermally activated sliding, regular at rest: Rice, Lapusta and Ranjith (2001), J. Mech. Phys. Solids.",
        start=STARTS | {"corner": CORNERS},
    )
)
