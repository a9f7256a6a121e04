"""Force depends on the amplitude block."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import remembered_through
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

SIZE = Prior("size", "1", "normal", 0.0, 0.04, "Per doubling; 16 % from the smallest to the largest block of Table 1.")


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c log2(A/A_max)."""
    return Contribution(clamping=1.0 + values["size"] * _doublings(history, history.amplitude_mm))


def _gradual(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c m, m the doublings log2(A/A_max) that the contact has got used to over a distance slid."""
    late = remembered_through(lambda run: _doublings(run, run.amplitude_mm), history, base, values["length"])
    return Contribution(clamping=1.0 + values["size"] * late)


def _doublings(history: History, amplitude_mm: FloatArray) -> FloatArray:
    """Binary logarithm of A/A_max; amplitudes below a hundredth of the largest count as that."""
    return np.asarray(np.log2(np.maximum(amplitude_mm / history.half_stroke_mm, 0.01)))


EFFECT = Effect(
    id="amplitude",
    family="slow_change",
    title="Force depends on the amplitude",
    statement="Each doubling of the amplitude changes the sliding force by {size:+.1%}.",
    equation="Fy -> Fy (1 + c log2(A/A_max))",
    cause="Longer strokes clear more debris from the contact, heat more or load the bolts more; or partial sliding.",
    shows="A step in the plateau from block to block, none within a block.",
    next_test="Repeat the smallest blocks at the end of the run: an amplitude effect comes back, wear does not.",
    parameters=(SIZE,),
    act=act,
    acts=(("capacity", "amplitude"),),
    source="Assumed form: one change for each doubling, because most blocks of Table 1 double the one before.",
    start={"size": (0.02, -0.02)},
).with_form(
    "gradual",
    statement="Each doubling of the amplitude changes the sliding force by {size:+.1%}, {length:.0f} mm of slip late.",
    equation="Fy -> Fy (1 + c m), L dm/ds + m = log2(A/A_max), s slid",
    parameters=(
        SIZE,
        Prior("length", "mm", "loguniform", 1.0, 3000.0, "From a part of a stroke to all strokes of a block."),
    ),
    act=_gradual,
    source="Debris is swept out stroke by stroke: the film follows with a slip length, as in rate and state friction.",
    start={"size": (0.02, -0.02), "length": (60.0, 300.0, 1000.0)},
)
