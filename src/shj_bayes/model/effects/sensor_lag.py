"""Delay between the displacement and force channels."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Force as it is; `Effect.delay` says how much later it is recorded."""
    return Contribution()


EFFECT = Effect(
    id="sensor_lag",
    family="start_of_stroke",
    title="Delay between the channels",
    statement="Force is {size:+.3f} s behind displacement (minus: ahead); where the recording is at fault, correct it.",
    equation="F_recorded(t) = F(t - tau)",
    cause="Filters or multiplexed sampling that treat the two channels differently.",
    shows="Reversals shifted along the stroke by tau times the speed there; grows with speed, unlike slack.",
    next_test="Cross-correlate the channels in a fast elastic cycle, or repeat one amplitude five times faster.",
    parameters=(Prior("size", "s", "normal", 0.0, 0.1, "0 to 0.1 s for unequal filters; either channel may be late."),),
    act=act,
    acts=(("motion", "delay"),),
    source="Assumed form: one constant delay, which is what unequal filters do to slow signals.",
    start={"size": (0.03, -0.03)},
    delay="size",
)
