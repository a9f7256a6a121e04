"""Force rises with travel."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import slid_m
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + b (1 - exp(-s/s1)); the distance slid s goes on from run to run."""
    return Contribution(clamping=1.0 + values["size"] * (1.0 - np.exp(-slid_m(history, base) / values["travel"])))


def _hyperbolic(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + b s/(s + s1)."""
    slid = slid_m(history, base)
    return Contribution(clamping=1.0 + values["size"] * slid / (slid + values["travel"]))


EFFECT = Effect(
    id="bedding_in",
    family="slow_change",
    title="Force rises with travel",
    statement="Sliding force rises by {size:.0%} over the first {travel:.2f} m of sliding: the surfaces bed in.",
    equation="Fy -> Fy (1 + b (1 - exp(-s/s1)))",
    cause="Surfaces bed in: mill scale, paint or grease is rubbed off, or the plates gall.",
    shows="The first cycles, which are also the smallest amplitudes; the plateaus level off later.",
    next_test="Repeat the smallest block at the end of the run: bedding in stays, amplitude dependence goes back.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 1.0, "Rises of up to 0.3 are expected; galling reaches more."),
        Prior("travel", "m", "loguniform", 0.02, 5.0, "The first cycles: 0.05 to 2 m."),
    ),
    act=act,
    acts=(("capacity", "travel"),),
    source="Assumed form: an exponential approach, the least that rises with the first travel and levels off.",
    start={"size": (0.1,), "travel": (0.1, 0.5, 2.0)},
).with_form(
    "hyperbolic",
    statement="Sliding force rises by {size:.0%} in all, half of it within {travel:.2f} m: the surfaces bed in.",
    equation="Fy -> Fy (1 + b s/(s + s1))",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 1.5, "Rises of up to 0.3 are expected; galling reaches more."),
        Prior("travel", "m", "loguniform", 0.02, 20.0, "Half of the rise: from the first cycle to beyond the test."),
    ),
    act=_hyperbolic,
    source="Growth of the contact area that slows down with its size.",
    start={"size": (0.1,), "travel": (0.1, 0.5, 3.0)},
)
