"""Force falls with heating and recovers with cooling."""

from __future__ import annotations

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

MODES = 6  # of heat through the thickness; the next ones last a fiftieth of its time and hold little heat
STROKES = 60.0  # reference duration in half strokes at peak speed: about the paper's protocol, whatever the device


@njit(cache=True)
def _temperature(power: FloatArray, step: FloatArray, tau: float) -> FloatArray:
    """Solve tau T' + T = tau P from cold, exactly for power held over each step (uneven sampling is fine)."""
    out = np.zeros_like(power)
    for i in range(1, power.size):
        keep = np.exp(-step[i - 1] / tau)
        out[i] = keep * out[i - 1] + tau * (1.0 - keep) * power[i - 1]
    return out


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c T/T_ref; T_ref is reached by sliding at peak speed and full force for the reference duration.

    The rubbed face of an insulated plate answers a unit of heat with 1 + 2 sum exp(-n^2 t / t_d): the plate as a whole,
    and the modes in which heat spreads through its thickness (Carslaw and Jaeger 1959, Conduction of Heat in Solids,
    section 3.8). The whole then cools to its surroundings.
    """
    tau, spread, speed = values["cooling"], values["spread"], history.peak_speed_mm_s
    power = base.Fy / base.Fy_first * history.speed_mm_s / speed
    duration = STROKES * history.half_stroke_mm / speed
    warmth, reference = np.zeros_like(power), 0.0
    for mode in range(MODES + 1):
        decay = 1.0 / (1.0 / tau + mode**2 / spread)
        weight = 1.0 if mode == 0 else 2.0
        warmth += weight * _temperature(power, np.diff(history.time_s), decay)
        reference += -weight * decay * np.expm1(-duration / decay)
    return Contribution(clamping=1.0 - values["size"] * warmth / reference)


EFFECT = Effect(
    id="thermal",
    family="slow_change",
    title="Force falls with heating",
    statement="Heating lowers the sliding force by {size:.0%} in a full test; it recovers in {cooling:.0f} s at rest.",
    equation="Fy -> Fy (1 - c T/T_ref), T = sum of w_n int |Fy v| exp(-(1/tau + n^2/t_d) (t - s)) ds, w = 1, 2, 2..",
    cause="Friction heat softens the surfaces and lengthens the bolts, so that clamping falls until the plates cool.",
    shows="A decline with dissipated energy that recovers in pauses, and within a stroke: hotter after mid-stroke.",
    next_test="Two pauses of 15 min: heating recovers, wear does not.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "40 K at 10 mm/s and 0.0005-0.003 per K: 2-12 %; faster, more."),
        Prior("cooling", "s", "loguniform", 5.0, 5000.0, "From thin shims (seconds) to whole plates (an hour)."),
        Prior("spread", "s", "loguniform", 0.02, 50.0, "Thickness^2 / (pi^2 x 14 mm^2/s): 2 to 80 mm of steel."),
    ),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E05; OpenSees FPBearingPTV for the idea of a temperature state.",
    start={"size": (0.1,), "cooling": (30.0, 300.0, 2000.0), "spread": (0.1, 3.0)},
)
