"""Friction differs while speeding up and slowing down."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import remembered_through
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c m and gamma + c/v_peak, m the speed u = |v|/v_peak that the contact remembers while it slides.

    At a steady speed both cancel. The speed of the moment acts as Eq. (2) does, on the elastic branches as well.
    """
    peak = history.peak_speed_mm_s
    slides = base.sliding_from(1.0 - values["size"] * float(np.mean(history.speed_mm_s)) / peak)
    late = remembered_through(lambda run: run.speed_mm_s, history, slides, values["length"], begin=0.0) / peak
    return Contribution(clamping=1.0 - values["size"] * late, gamma_s_per_mm=values["size"] / peak)


EFFECT = Effect(
    id="friction_memory",
    family="odd_in_position",
    title="Friction remembers the speed",
    statement="Friction follows the speed {length:.0f} mm late: {size:+.0%} per unit of peak speed while speeding up.",
    equation="Fy -> Fy (1 - c m), gamma |v| -> gamma |v| + c u, L dm/ds + m = u, u = |v|/v_peak, s slid",
    cause="Friction follows speed with a delay (debris or lubricant film needs some slip to adapt).",
    shows="Plateaus tilted along the motion in every block alike; the push and pull tilts oppose each other in time.",
    next_test="Triangular cycles at constant speed: the tilt vanishes, that of a spring stays.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.3, "Of the part of the friction that depends on speed; either sign."),
        Prior("length", "mm", "loguniform", 0.5, 60.0, "0.5 to 5 mm for contacts, more for films and debris."),
    ),
    act=act,
    acts=(("capacity", "acceleration"),),
    source="KU Leuven, Lubricants 2023, 11, 326 (sinusoidal motion). Assumed form: a memory of first order over slip.",
    start={"size": (0.1,), "length": (3.0, 15.0)},
)
