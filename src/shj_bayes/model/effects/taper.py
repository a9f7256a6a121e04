"""Force grows towards one end of the slot."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c x/L."""
    return Contribution(clamping=1.0 + values["size"] * history.normal_position)


EFFECT = Effect(
    id="taper",
    family="odd_in_position",
    title="Force grows towards one end of the slot",
    statement="Sliding force is {size:+.0%} at the positive end of the stroke and the opposite at the other end.",
    equation="Fy -> Fy (1 + c x/L)",
    cause="Plates not parallel or not flat: a wedge tightens the bolts towards one end of the slot.",
    shows="Push and pull plateaus that open or close towards one end; sliding resistance, so both shrink with Fy.",
    next_test="Measure the plate thickness along the slot; or turn the cleat end for end and repeat one block.",
    parameters=(Prior("size", "1", "normal", 0.0, 0.15, "Within 10 % for plates of usual tolerance; either sign."),),
    act=act,
    acts=(("capacity", "position"),),
    source="Assumed form: a straight line over the position, which is what a wedge does to the bolts.",
    start={"size": (0.03,)},
)
