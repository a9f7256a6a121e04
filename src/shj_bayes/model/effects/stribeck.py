"""Extra friction at low sliding speed."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import MEMORIES, MEMORY, felt
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a exp(-(|v|/vs)^n); the exponential follows the speed over the memory.

    Contacts stick up to 1 + a, which they hold at rest.
    """
    share = (history.speed_mm_s / values["speed"]) ** values["shape"]
    sticks = base.sliding_from(1.0 + values["size"])
    return Contribution(clamping=1.0 + values["size"] * felt(np.exp(-share), history, sticks, values["memory"]))


EFFECT = Effect(
    id="stribeck",
    family="low_speed",
    title="Extra friction at low speed",
    statement="Friction is {size:.0%} higher at creep than when sliding, an extra that fades over {speed:.1f} mm/s.",
    equation="Fy -> Fy (1 + a h), L dh/ds + h = exp(-(|v|/vs)^n), s slid",
    cause="Static friction above sliding friction (Stribeck effect): surfaces weld or key when they move slowly.",
    shows="Ears at both ends of every stroke, wider in the larger amplitude blocks.",
    next_test="Triangular cycles at constant speed: the ears vanish, a breakaway peak stays; then slow blocks.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 1.0, "0 to 0.3 for metals, up to 1 for brake linings (NZSEE 1773)."),
        Prior("speed", "mm/s", "loguniform", 0.1, 10.0, "0.1 to 5 mm/s for dry contacts; twice that allowed."),
        Prior("shape", "1", "uniform", 0.5, 2.0, "Exponents of 0.5 to 2 are in use; 2 in most LuGre models."),
        MEMORY,
    ),
    act=act,
    acts=(("capacity", "speed"),),
    source="Brake-lining dampers (NZSEE repository, 1773); the exponent after Armstrong-Helouvry 1991.",
    start={"size": (0.1,), "speed": (0.5, 2.0), "shape": (1.0,), **MEMORIES},
)
