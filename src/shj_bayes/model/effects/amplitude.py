"""Force depends on the amplitude block."""

from __future__ import annotations

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c log2(A/A_max); amplitudes below a hundredth of the largest count as that."""
    share = np.maximum(history.amplitude_mm / history.half_stroke_mm, 0.01)
    return Contribution(clamping=1.0 + values["size"] * np.log2(share))


EFFECT = Effect(
    id="amplitude",
    family="slow_change",
    title="Force depends on the amplitude",
    statement="Each doubling of the amplitude changes the sliding force by {size:+.1%}.",
    equation="Fy -> Fy (1 + c log2(A/A_max))",
    cause="Longer strokes clear more debris from the contact, heat more or load the bolts more; or partial sliding.",
    shows="A step in the plateau from block to block, none within a block.",
    next_test="Repeat the smallest blocks at the end of the run: an amplitude effect comes back, wear does not.",
    parameters=(
        Prior(
            "size", "1", "normal", 0.0, 0.04, "Per doubling; 16 % from the smallest to the largest block of Table 1."
        ),
    ),
    neutral={"size": 0.0},
    act=act,
    acts=(("capacity", "amplitude"),),
    source="DOMAIN E18.",
    start={"size": (0.02, -0.02)},
)
