"""Sawtooth on the plateau."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import slid_mm
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior

FALL = 0.15  # of a wave length: slow loading, fast drop


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a saw(slid/wave); slid counts from where the force reaches Fy, the wave starts at its middle."""
    slid = slid_mm(history, base)
    phase = slid / values["wave"] + 0.5 * (1.0 - FALL)
    phase -= np.floor(phase)
    saw = np.minimum(2.0 / (1.0 - FALL) * phase - 1.0, 2.0 / FALL * (1.0 - phase) - 1.0)
    return Contribution(clamping=1.0 + values["size"] * np.where(slid > 0.0, saw, 0.0))


EFFECT = Effect(
    id="stick_slip",
    family="oscillation",
    title="Stick-slip",
    statement="The plateau saws by {size:.1%} of Fy up and down, one tooth every {wave:.1f} mm of sliding.",
    equation="Fy -> Fy (1 + a saw(d/w)), d slid since the reversal",
    cause="Friction that falls with speed against a soft frame: the surfaces stick, load up and jump.",
    shows="Teeth on every plateau, slow rise and fast drop, at the same slip in every stroke.",
    next_test="Another speed or a stiffer grip: the teeth change; sample at 20 times the tooth frequency or faster.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "Half the peak-to-peak force; zinc 100 of the paper shows it."),
        Prior("wave", "mm", "loguniform", 0.3, 30.0, "Twice the force drop over the frame stiffness, and much longer."),
    ),
    act=act,
    acts=(("motion", "stick-slip"),),
    source="The paper reports stick-slip of zinc 100. Assumed form: teeth of one length in slip.",
    start={"size": (0.03,), "wave": tuple(round(0.5 * 1.03**i, 3) for i in range(130))},
)
