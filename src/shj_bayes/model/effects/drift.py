"""Force channel drifts with time."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy_first, growing with time, slower and slower, and going on from run to run."""
    clock, warming = (history.begun_s + history.time_s) / history.tested_s * history.n_runs, values["warming"]
    return Contribution(added_kN=base.Fy_first * values["size"] * np.expm1(-clock / warming) / np.expm1(-1.0 / warming))


def _zeroed(history: History, values: Values, base: Base) -> Contribution:
    """Add the same drift in each run: the load cell was zeroed before it."""
    clock, warming = history.time_s / history.tested_s * history.n_runs, values["warming"]
    return Contribution(added_kN=base.Fy_first * values["size"] * np.expm1(-clock / warming) / np.expm1(-1.0 / warming))


EFFECT = Effect(
    id="drift",
    family="slow_change",
    title="Force channel drifts",
    statement="The force reading drifts by {size:+.1%} of Fy in a run; if it is the load cell's, subtract it.",
    equation="F -> F + c Fy1 (1 - exp(-n/w))/(1 - exp(-1/w)), n = n_run - 1 + t/T; a straight line for w -> inf",
    cause="Warming amplifier or load cell, a slipping grip, or weight that shifts.",
    shows="Push and pull plateaus that move the same way with time, so that the loop travels up or down.",
    next_test="Read the load cell unloaded before and after the run.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.1, "In the first run, of Fy_first; a sound load cell drifts below 0.01."),
        Prior("warming", "1", "loguniform", 0.2, 50.0, "In runs: amplifiers warm up in minutes to an hour."),
    ),
    act=act,
    acts=(("added", "time"),),
    source="Assumed form: an exponential approach, the least that holds both a straight line and a warming-up.",
    start={"size": (0.02,), "warming": (0.5, 5.0)},
).with_form(
    "zeroed",
    statement="The force reading drifts by {size:+.1%} of Fy in each run, from zero.",
    equation="F -> F + c Fy1 (1 - exp(-t/(w T)))/(1 - exp(-1/w)) in each run",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.1, "In a run, of Fy_first; a sound load cell drifts below 0.01."),
        Prior("warming", "1", "loguniform", 0.2, 50.0, "In runs: amplifiers warm up in minutes to an hour."),
    ),
    act=_zeroed,
    source="A load cell that is zeroed before each run.",
    start={"size": (0.02,), "warming": (0.5, 5.0)},
)
