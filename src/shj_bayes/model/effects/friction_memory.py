"""Friction differs while speeding up and slowing down."""

from __future__ import annotations

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c r, r = a q A / (v^2 + |a| A): 1 at the start of a sine stroke, 0 at its middle, -1 at its end."""
    change = history.acceleration_mm_s2 * history.direction * history.amplitude_mm
    # The floor keeps noise in a pause, where speed and acceleration are both nothing, from deciding the sign.
    scale = history.speed_mm_s**2 + np.abs(change) + (0.05 * history.peak_speed_mm_s) ** 2
    return Contribution(clamping=1.0 + values["size"] * change / scale)


EFFECT = Effect(
    id="friction_memory",
    family="odd_in_position",
    title="Friction remembers the speed",
    statement="Friction is {size:+.0%} while the device speeds up and the opposite while it slows down.",
    equation="Fy -> Fy (1 + c r), r = q a A / (v^2 + |a| A), from 1 (start of a stroke) to -1 (end)",
    cause="Friction follows speed with a delay (debris or lubricant film needs some slip to adapt).",
    shows="Plateaus tilted along the motion in every block alike; the push and pull tilts oppose each other in time.",
    next_test="Triangular cycles at constant speed: the tilt vanishes, that of a spring stays.",
    parameters=(Prior("size", "1", "normal", 0.0, 0.15, "A few per cent in rough lubricated contacts; either sign."),),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E14; KU Leuven, Lubricants 2023, 11, 326 (sinusoidal motion).",
    start={"size": (0.03,)},
)
