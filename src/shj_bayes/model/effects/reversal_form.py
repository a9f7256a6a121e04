"""The jump at reversals of Eq. (1) itself."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Share of the continuous reversal rule."""
    return Contribution(smooth_reversal=values["size"])


EFFECT = Effect(
    id="reversal_form",
    family="start_of_stroke",
    title="Reversals without the jump of Eq. (1)",
    statement="Reversals follow the continuous rule to {size:.0%}: use --model continuous, not Eq. (1) as published.",
    equation="F = F_Eq1 + s (e - F_Eq1) while the elastic force e opposes the motion",
    cause="Not the device: Eq. (1) drops the force by 2^(-1/beta) at each reversal, a real device unloads from F.",
    shows="The first millimetres after every reversal, up to where the force passes zero; nothing on the plateau.",
    next_test="None needed: refit with --model continuous and compare.",
    parameters=(Prior("size", "1", "uniform", 0.0, 1.0, "0 is Eq. (1) as published, 1 the continuous rule."),),
    act=act,
    acts=(("motion", "reversal"),),
    source="A Menegotto-Pinto branch is continuous (Menegotto and Pinto 1973); Eq. (1) of the paper is not.",
    start={"size": (0.5,)},
)
