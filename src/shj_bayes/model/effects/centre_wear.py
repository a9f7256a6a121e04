"""Force lower around mid-stroke."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c exp(-(x/w)^2), w a share of the half stroke."""
    return Contribution(
        clamping=1.0 - values["size"] * np.exp(-((history.normal_position / values["width"]) ** 2)),
    )


EFFECT = Effect(
    id="centre_wear",
    family="even_in_position",
    title="Worn or powdered centre of the stroke",
    statement="Sliding force is {size:.0%} lower at mid-stroke, where the surfaces have been rubbed most.",
    equation="Fy -> Fy (1 - c exp(-(x/(w L))^2))",
    cause="Coating worn through or powder collected where every cycle passes; or plates crowned by earlier tests.",
    shows="Plateaus dished around mid-stroke; in small amplitude blocks the whole plateau is low.",
    next_test="A small block 60 mm off centre; or one amplitude at a fifth and at five times the speed.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "A tenth to a third would explain the coated rows of Tables 4-7."),
        Prior("width", "1", "loguniform", 0.1, 1.0, "Half width as a share of the half stroke: 10 to 95 mm of 95 mm."),
    ),
    neutral={"size": 0.0},
    act=act,
    acts=(("capacity", "distance"),),
    source="Assumed form: a bell around mid-stroke, where every cycle passes.",
    start={"size": (0.08,), "width": (0.25, 0.6)},
)
