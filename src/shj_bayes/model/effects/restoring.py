"""Elastic stiffness after sliding."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add k [(1 - c) u + c u^3] as a share of Fy_first, u = x/L."""
    u, cubic = history.normal_position, values["stiffening"]
    return Contribution(added_kN=base.Fy_first * values["size"] * u * (1.0 - cubic + cubic * u * u))


EFFECT = Effect(
    id="restoring",
    family="odd_in_position",
    title="Elastic stiffness after sliding",
    statement="A spring works beside the friction: {size:+.0%} of Fy at full stroke (positive pulls to mid-stroke).",
    equation="F -> F + k Fy1 [(1 - c) u + c u^3], u = x/L",
    cause="Bending of plates and columns, leaning bolts, ring springs or gravity.",
    shows="Both plateaus tilted the same way, through mid-stroke; the tilt is the same in both runs.",
    next_test="Loosen the bolts and push through one slow stroke: what force is left is the spring.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "0-0.1 kN/mm over 95 mm at 80 kN; negative with gravity."),
        Prior("stiffening", "1", "uniform", 0.0, 0.6, "Cubic share: plates and columns stiffen as they bend."),
    ),
    act=act,
    acts=(("added", "position"),),
    source="Assumed form: a linear and a cubic spring, the least that is odd in the position and stiffens.",
    start={"size": (0.03,), "stiffening": (0.1,)},
)
