"""Clamping lost away from mid-stroke."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p (|x|/L)^m."""
    off_centre = np.maximum(np.abs(history.normal_position), 1e-9)
    return Contribution(clamping=1.0 - values["size"] * np.exp(values["power"] * np.log(off_centre)))


def _beyond_a_gap(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p <|x|/L - g>+ / (1 - g)."""
    gap = values["gap"]
    beyond = np.maximum(np.abs(history.normal_position) - gap, 0.0) / (1.0 - gap)
    return Contribution(clamping=1.0 - values["size"] * beyond)


EFFECT = Effect(
    id="prying",
    family="even_in_position",
    title="Clamping lost away from mid-stroke",
    statement="Clamping falls away from mid-stroke: {size:.0%} lower at full stroke than at the centre.",
    equation="Fy -> Fy (1 - p (|x|/L)^m)",
    cause="Prying: the plates rotate or bend as the bolts leave mid-slot and the bolts lose tension.",
    shows="Plateaus that droop towards both ends, most in the largest amplitude blocks (a speed law: alike in all).",
    next_test="Repeat one amplitude at a fifth and at five times the speed; or a small block 60 mm off centre.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "Up to 0.3 expected in AFC column bases; twice that allowed."),
        Prior("power", "1", "uniform", 0.8, 3.0, "1 is a V (tilting plates), 2 a U (bending plates)."),
    ),
    act=act,
    acts=(("capacity", "distance"),),
    source="Column-base AFC studies cited by the paper [14, 15]. Assumed form: V (tilting) to U (bending).",
    start={"size": (0.08,), "power": (1.2, 2.2)},
).with_form(
    "gap",
    statement="Clamping is lost beyond {gap:.0%} of the stroke, up to {size:.0%} at its end: prying.",
    equation="Fy -> Fy (1 - p <|x|/L - g>+/(1 - g))",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "Up to 0.3 expected in AFC column bases; twice that allowed."),
        Prior("gap", "1", "uniform", 0.0, 0.9, "The plates may tilt freely at first."),
    ),
    act=_beyond_a_gap,
    source="Lever of the plates once a gap has closed.",
    start={"size": (0.08,), "gap": (0.2, 0.5)},
)
