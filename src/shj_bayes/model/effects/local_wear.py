"""Force falls where the surface has been rubbed."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import passes
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping exp(-w n); n counts the passes over the place, through all runs."""
    return Contribution(clamping=np.exp(-values["size"] * passes(history, base, values["width"])))


EFFECT = Effect(
    id="local_wear",
    family="slow_change",
    title="Force falls where the surface has been rubbed",
    statement="Sliding force falls by {size:.2%} with each pass over a place: a track wears in around mid-stroke.",
    equation="Fy -> Fy exp(-w n), n = passes over the place, averaged over a pad of width b L",
    cause="Coating or shim wears where it is rubbed, most where most cycles pass; the bolts follow the thickness.",
    shows="Plateaus that are alike at first, and more and more dished around mid-stroke with each cycle.",
    next_test="A small block off centre at the end of the test: a place that was rubbed less holds more force.",
    parameters=(
        Prior("size", "1", "lognormal", 0.002, 1.5, "Mid-stroke is passed about 40 times in a run: 0.4 to 30 % a run."),
        Prior("width", "1", "loguniform", 0.05, 0.6, "Pad under the bolts as a share of the half stroke: 5 to 57 mm."),
    ),
    act=act,
    acts=(("capacity", "passes"),),
    source="Archard wear at each place of the slot, with the bolt as a spring.",
    start={"size": (0.001, 0.005), "width": (0.12, 0.25)},
)
