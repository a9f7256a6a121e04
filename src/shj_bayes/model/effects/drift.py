"""Force channel drifts with time."""

from __future__ import annotations

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy_first, growing with time and going on from run to run."""
    clock = history.run - 1 + history.time_s / history.time_s[-1]
    return Contribution(added_kN=base.Fy_first * values["size"] * clock)


EFFECT = Effect(
    id="drift",
    family="slow_change",
    title="Force channel drifts",
    statement="The force reading drifts by {size:+.1%} of Fy per run; zero the load cell and subtract the drift.",
    equation="F -> F + c Fy1 (n_run - 1 + t/T)",
    cause="Warming amplifier or load cell, a slipping grip, or weight that shifts.",
    shows="Push and pull plateaus that move the same way with time, so that the loop travels up or down.",
    next_test="Read the load cell unloaded before and after the run.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.1, "Per run, share of Fy_first; a sound load cell drifts below 0.01."),
    ),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E17.",
    start={"size": (0.02,)},
)
