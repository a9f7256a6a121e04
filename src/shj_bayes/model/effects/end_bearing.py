"""Stiffening as the bolt meets the end of the slot."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add a force k (1 + side s) <|x| - x_g>+ s, s = sign(x), of which a share comes back; k is in Fy_first per mm."""
    end = np.sign(history.position_mm)
    into = np.maximum(np.abs(history.position_mm) - values["contact"] * history.half_stroke_mm, 0.0)
    held = np.where(history.direction == end, 1.0, values["returned"])
    return Contribution(added_kN=base.Fy_first * values["size"] * (end + values["side"]) * into * held)


EFFECT = Effect(
    id="end_bearing",
    family="end_of_stroke",
    title="Bolt meets the end of the slot",
    statement="Beyond {contact:.0%} of the stroke the bolt bears on the slot end: {size:.1%} of Fy more per mm.",
    equation="F -> F + k (1 + side s) <|x| - x_g>+ s, s = sign(x); times r while moving back (k: mean of both ends)",
    cause="Slot shorter than the stroke, assembly off centre, or debris and coating piled up at the slot end.",
    shows="The last millimetres of the largest strokes, often at one end only.",
    next_test="Look at the slot ends and measure the clearance; repeat the largest block 10 mm smaller.",
    parameters=(
        Prior("size", "1/mm", "lognormal", 0.05, 1.3, "4 kN/mm of 80 kN; tight bolt bearing reaches 20-300 kN/mm."),
        Prior("contact", "1", "uniform", 0.5, 1.0, "Where contact starts, as a share of the half stroke."),
        Prior("side", "1", "uniform", -1.0, 1.0, "1 is the positive end only, -1 the negative end only, 0 both alike."),
        Prior("returned", "1", "uniform", 0.0, 1.0, "0 a crushed contact that lets go at once, 1 an elastic one."),
    ),
    act=act,
    acts=(("added", "position"),),
    source="Gap elements of OpenSees and suanPan; the slot of the paper, 220 mm, leaves 7 mm behind a stroke of 95 mm.",
    start={"size": (0.03,), "contact": (0.75, 0.92), "side": (-0.7, 0.0, 0.7), "returned": (0.2,)},
)
