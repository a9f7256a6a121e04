"""Linear speed dependence, for a base law that runs without it."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Gamma of Eq. (2), where the base law runs without it."""
    return Contribution(gamma_s_per_mm=values["size"])


EFFECT = Effect(
    id="velocity",
    family="even_in_position",
    title="Linear speed dependence",
    statement="Sliding force changes by {size:+.2%} per mm/s of sliding speed (1/dep = {size:+.4f} s/mm).",
    equation="F -> F (1 + g |v|)",
    cause="Friction coefficient of the shim or coating that grows (or falls) with sliding speed.",
    shows="Every plateau arched around mid-stroke, by the same amount in every amplitude block of one peak speed.",
    next_test="Repeat one amplitude at a fifth and at five times the speed: the plateau then moves with the speed.",
    parameters=(
        Prior("size", "s/mm", "normal", 0.0, 0.02, "As gamma: Tables 3-7 of the paper, |1/dep| up to 0.033 s/mm."),
    ),
    act=act,
    acts=(("capacity", "speed"),),
    source="Eq. (2) of the paper, with 1/dep as the parameter.",
    start={"size": (0.005, -0.005)},
)
