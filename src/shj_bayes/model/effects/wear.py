"""Force falls with travel."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import slid_m
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping exp(-w s); the distance slid s goes on from run to run."""
    return Contribution(clamping=np.exp(-values["size"] * slid_m(history, base)))


def _saturating(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p (1 - exp(-s/s0))."""
    return Contribution(clamping=1.0 + values["size"] * np.expm1(-slid_m(history, base) / values["travel"]))


def _power(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p (s/S)^n, S the travel in all tests."""
    share = np.maximum(slid_m(history, base) / history.tested_m, 1e-9)
    return Contribution(clamping=1.0 - values["size"] * share ** values["power"])


EFFECT = (
    Effect(
        id="wear",
        family="slow_change",
        title="Force falls with travel",
        statement="Sliding force falls by {size:.1%} per metre slid: part of the degradation happens within the run.",
        equation="Fy -> Fy exp(-w s)",
        cause="Wear of shim or coating relaxes the bolts: 0.03 mm of thickness is a tenth of an M16 bolt's tension.",
        shows="Every plateau a little lower than the one before, alike in position and speed; the second run goes on.",
        next_test="Repeat the first blocks at the end (against amplitude); two pauses of 15 min (against heating).",
        parameters=(
            Prior(
                "size", "1/m", "lognormal", 0.05, 1.5, "Losses of 8-80 % over 3.84 m (Tables 3-7) are 0.02-0.4 per m."
            ),
        ),
        act=act,
        acts=(("capacity", "travel"),),
        source="Archard wear with the bolt as a spring: its tension falls with the thickness, and with it the wear.",
        start={"size": (0.02,)},
    )
    .with_form(
        "saturating",
        statement="Sliding force falls by {size:.1%} in all, most of it within {travel:.2f} m of sliding.",
        equation="Fy -> Fy (1 - p (1 - exp(-s/s0)))",
        parameters=(
            Prior("size", "1", "uniform", 0.0, 0.9, "A coating that is rubbed off takes its share of the friction."),
            Prior("travel", "m", "loguniform", 0.1, 30.0, "From the first cycles to far more than is tested."),
        ),
        act=_saturating,
        source="Running-in law of wear: Blau (2005), Tribol. Int. 38, 1007, exponential approach to a steady state.",
        start={"size": (0.1,), "travel": (0.5, 2.0, 8.0)},
    )
    .with_form(
        "power",
        statement="Sliding force falls by {size:.1%} over the tests, with the power {power:.2f} of the distance slid.",
        equation="Fy -> Fy (1 - p (s/S)^n), S the travel in all tests",
        parameters=(
            Prior("size", "1", "uniform", 0.0, 0.9, "Losses of 8 to 80 % in Tables 3-7 of the paper."),
            Prior("power", "1", "loguniform", 0.2, 5.0, "Below 1 it wears off, above 1 a worn surface wears faster."),
        ),
        act=_power,
        source="Power law of wear with travel, as fitted to coated plates.",
        start={"size": (0.1,), "power": (0.5, 1.0, 2.0)},
    )
)
