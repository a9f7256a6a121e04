"""Force lower around mid-stroke."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c exp(-(x/w)^2), w a share of the half stroke."""
    return Contribution(clamping=1.0 - values["size"] * np.exp(-((history.normal_position / values["width"]) ** 2)))


def _track(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c exp(-|x/w|^m)."""
    away = np.abs(history.normal_position) / values["width"]
    return Contribution(clamping=1.0 - values["size"] * np.exp(-(away ** values["edge"])))


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
    act=act,
    acts=(("capacity", "distance"),),
    source="Assumed form: a bell around mid-stroke, where every cycle passes.",
    start={"size": (0.08,), "width": (0.25, 0.6)},
).with_form(
    "track",
    statement="Sliding force is {size:.0%} lower on a track of even depth around mid-stroke.",
    equation="Fy -> Fy (1 - c exp(-|x/(w L)|^m))",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "As of the bell."),
        Prior("width", "1", "loguniform", 0.1, 1.0, "Half width as a share of the half stroke: 10 to 95 mm of 95 mm."),
        Prior("edge", "1", "loguniform", 2.0, 20.0, "From the bell to a track with a step; pads round it."),
    ),
    act=_track,
    source="Assumed form: a track that the small cycles of a test have rubbed, under a pad that rounds its ends.",
    start={"size": (0.08,), "width": (0.25, 0.5), "edge": (5.0,)},
)
