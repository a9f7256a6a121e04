"""Clamping that changes with time: suddenly at one moment, or in a swing."""

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

RAMP = 0.005  # of the testing time: sudden for an engineer, smooth enough for a search
FAR = 37.0  # ramps from its middle, where a logistic function is 0 or 1 to double precision


@njit(cache=True)
def _window(clock: FloatArray, begin: float, end: float) -> FloatArray:
    """Rise from 0 to 1 at the beginning and fall at the end, both as logistic functions."""
    out = np.empty_like(clock)
    for i in range(clock.size):
        rise, fall = (clock[i] - begin) / RAMP, (end - clock[i]) / RAMP
        out[i] = 0.0 if min(rise, fall) < -FAR else 1.0
        if abs(rise) < FAR:
            out[i] /= 1.0 + np.exp(-rise)
        if abs(fall) < FAR:
            out[i] /= 1.0 + np.exp(-fall)
    return out


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c (1 + side q) from a moment on, for a time; both as shares of the testing time of all runs."""
    clock = np.minimum((history.begun_s + history.time_s) / history.tested_s, 1.0)  # after the tests it stays as it is
    window = _window(clock, values["begin"], values["begin"] + values["length"])
    return Contribution(clamping=1.0 + values["size"] * (1.0 + values["side"] * history.direction) * window)


def _swing(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c sin(2 pi (t/p + phase))."""
    turns = (history.begun_s + history.time_s) / (values["period"] * history.tested_s) + values["phase"]
    return Contribution(clamping=1.0 + values["size"] * np.sin(2.0 * np.pi * turns))


EFFECT = Effect(
    id="tension_step",
    family="slow_change",
    title="Clamping changes with time",
    statement="Clamping changes by {size:+.0%} at {begin:.0%} of the testing time, for {length:.0%} of it.",
    equation="Fy -> Fy (1 + c (1 + side q)) for begin < (n_run - 1 + t/T)/N < begin + length",
    cause="A bolt loosened, cracked, yielded or was re-tightened; or the clamping was adjusted during the test.",
    shows="All plateaus between two moments higher or lower, with steady plateaus before and after.",
    next_test="A load washer under the bolt head: it shows the change without any model.",
    parameters=(
        Prior(
            "size", "1", "normal", 0.0, 0.25, "From the slip of a bolt to the loss of one of two; mean of directions."
        ),
        Prior("begin", "1", "uniform", 0.0, 1.0, "Share of the testing time: any moment."),
        Prior("length", "1", "loguniform", 0.02, 2.0, "Share of the testing time: from about a cycle to its end."),
        Prior("side", "1", "uniform", -1.0, 1.0, "1 while displacement grows only, -1 while it falls only, 0 both."),
    ),
    act=act,
    acts=(("capacity", "time"),),
    source="brfd-lehigh ds4_step, where the band was moved in one direction only; a bolt that breaks does the same.",
    start={
        "size": (0.1,),
        "begin": tuple(round(0.03 + 0.04 * i, 2) for i in range(24)),
        "length": (0.05, 0.15, 0.3, 1.5),
        "side": (-0.9, 0.0, 0.9),
    },
).with_form(
    "swing",
    statement="Clamping swings by {size:.1%} up and down, once in {period:.2f} of the testing time.",
    equation="Fy -> Fy (1 + c sin(2 pi (t/(p T) + phase))), T the testing time of all runs",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.5, "Temperature of the hall, or a clamping that is controlled."),
        Prior("period", "1", "loguniform", 0.02, 2.0, "Share of the testing time."),
        Prior("phase", "1", "uniform", -0.2, 1.2, "Turns at the beginning."),
    ),
    act=_swing,
    source="brfd-lehigh ds4_harmonic: a band whose force follows a sine.",
    start={
        "size": (0.05,),
        "period": tuple(round(0.025 * 1.12**i, 4) for i in range(36)),
        "phase": (0.1, 0.35, 0.6, 0.85),
    },
)
