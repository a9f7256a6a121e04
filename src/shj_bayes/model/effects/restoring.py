"""Elastic stiffness after sliding."""

from __future__ import annotations

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add k x/L as a share of Fy_first."""
    return Contribution(added_kN=base.Fy_first * values["size"] * history.normal_position)


EFFECT = Effect(
    id="restoring",
    family="odd_in_position",
    title="Elastic stiffness after sliding",
    statement="A spring works beside the friction: {size:+.0%} of Fy at full stroke (positive pulls to mid-stroke).",
    equation="F -> F + k Fy1 x/L",
    cause="Bending of plates and columns, leaning bolts, ring springs or gravity.",
    shows="Both plateaus tilted the same way, through mid-stroke; the tilt is the same in both runs.",
    next_test="Loosen the bolts and push through one slow stroke: what force is left is the spring.",
    parameters=(Prior("size", "1", "normal", 0.0, 0.15, "0-0.1 kN/mm over 95 mm at 80 kN; negative with gravity."),),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E20.",
    start={"size": (0.03,)},
)
