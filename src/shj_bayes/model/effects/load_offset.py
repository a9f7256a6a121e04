"""Constant added to the force."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy_first."""
    return Contribution(added_kN=base.Fy_first * values["size"])


EFFECT = Effect(
    id="load_offset",
    family="even_in_direction",
    title="Constant added to the force",
    statement="A constant of {size:+.1%} of Fy is in the force throughout; if it is the load cell's zero, subtract it.",
    equation="F -> F + c Fy1",
    cause="Load cell not zeroed, weight of fixtures, or a preload.",
    shows="The whole loop shifted up or down, by the same number of kN in both runs, also while sticking.",
    next_test="Read the load cell unloaded before and after the run.",
    parameters=(
        Prior(
            "size", "1", "cauchy", 0.0, 0.03, "0.001-0.01 for a sound load cell; gas pressure on a seal, 10 and more."
        ),
    ),
    act=act,
    acts=(("added", "constant"),),
    source="Assumed form: a constant, which is what a load cell adds that was not zeroed.",
    start={"size": (0.02, 0.5, 5.0)},
)
