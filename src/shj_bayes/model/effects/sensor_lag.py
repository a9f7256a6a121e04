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
).with_form(
    "filtered",
    statement="Force is {size:.3f} s behind displacement, {share:.0%} of it by a filter that rounds corners.",
    equation="F_recorded(t) = h * F(t - (1 - s) tau), h(u) = u/T^2 exp(-u/T), T = s tau/2",
    parameters=(
        Prior("size", "s", "lognormal", 0.05, 1.0, "Two poles at 1 to 10 Hz are 0.03 to 0.3 s behind."),
        Prior("share", "1", "uniform", 0.0, 1.0, "The rest is multiplexed sampling or another clock."),
    ),
    act=act,
    source="Critically damped low-pass filter of second order, as in bridge amplifiers and anti-alias filters.",
    start={"size": (0.03, 0.1, 0.3), "share": (0.6,)},
    filtered="share",
)
