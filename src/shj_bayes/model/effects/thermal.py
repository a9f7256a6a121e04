"""Force falls with heating and recovers with cooling."""

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import slid_since_mm
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

N_MODES = 7  # the plate as a whole, and heat through its thickness; the next last a fiftieth of its time
STEEPEST = 1.55  # of the first mode's angle: at pi/2 the far face is held cold
STROKES = 60.0  # reference duration in half strokes at peak speed: about the paper's protocol, whatever the device


@njit(cache=True, fastmath={"contract", "reassoc", "nsz"})
def _temperature(heat: FloatArray, step: FloatArray, decays: FloatArray, weights: FloatArray) -> FloatArray:
    """Add up w T, T' + T / tau = P from cold, exactly for heat that comes evenly over each step, however uneven."""
    out, warm = np.zeros_like(heat), np.zeros_like(decays)
    left, kept = np.ones_like(decays), np.ones_like(decays)
    last = -1.0
    for i in range(1, heat.size):
        if abs(step[i - 1] - last) > 1e-9 * last:  # sampling is even for long stretches, and exponentials are dear
            last = step[i - 1]
            for k in range(N_MODES):
                share = last / decays[k]
                left[k] = np.exp(-share)
                kept[k] = (1.0 - left[k]) / share if share > 1e-5 else 1.0 - 0.5 * share
        total = 0.0
        for k in range(N_MODES):
            warm[k] = left[k] * warm[k] + kept[k] * heat[i]
            total += weights[k] * warm[k]
        out[i] = total
    return out


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c T/T_ref; T_ref is reached by sliding at peak speed and full force for the reference duration.

    The rubbed face of a plate that gives its heat off at the other face answers a unit of heat with
    sum w exp(-m^2 t / (pi^2 t_d)), w = 2 / (1 + sin 2m / 2m), over the roots of m tan m = Bi: the plate as a whole, and
    the modes in which heat spreads through its thickness (Carslaw and Jaeger 1959, Conduction of Heat in Solids,
    section 3.11). The first root follows from the cooling time, and Bi from the first root.
    """
    tau, spread, speed = values["cooling"], values["spread"], history.peak_speed_mm_s
    heat = base.Fy / base.Fy_first * slid_since_mm(history, base) / speed
    duration = STROKES * history.half_stroke_mm / speed
    roots = _roots(spread / tau)
    decays = tau * (roots[0] / roots) ** 2
    weights = 2.0 / (1.0 + np.sinc(2.0 * roots / np.pi))
    warmth = _temperature(heat, np.diff(history.time_s), decays, weights)
    reference = -float(np.sum(weights * decays * np.expm1(-duration / decays)))
    return Contribution(clamping=1.0 - values["size"] * warmth / reference)


@njit(cache=True)
def _roots(ratio: float) -> FloatArray:
    """Roots of m tan m = Bi for a given ratio of spreading to cooling time."""
    out = np.empty(N_MODES)
    out[0] = min(np.pi * np.sqrt(ratio), STEEPEST)
    biot = out[0] * np.tan(out[0])
    for k in range(1, N_MODES):
        low, high = np.pi * k, np.pi * (k + 0.5)
        sign = 1.0 if k % 2 == 0 else -1.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            if sign * (middle * np.sin(middle) - biot * np.cos(middle)) > 0.0:
                high = middle
            else:
                low = middle
        out[k] = 0.5 * (low + high)
    return out


EFFECT = Effect(
    id="thermal",
    family="slow_change",
    title="Force falls with heating",
    statement="Heating lowers the sliding force by {size:.0%} in a full test; it recovers in {cooling:.0f} s at rest.",
    equation="Fy -> Fy (1 - c T/T_ref), T = sum of w int |Fy v| exp(-m^2 (t - s) / (pi^2 t_d)) ds, m tan m = Bi",
    cause="Friction heat softens the surfaces and lengthens the bolts, so that clamping falls until the plates cool.",
    shows="A decline with dissipated energy that recovers in pauses, and within a stroke: hotter after mid-stroke.",
    next_test="Two pauses of 15 min: heating recovers, wear does not.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "40 K at 10 mm/s and 0.0005-0.003 per K: 2-12 %; faster, more."),
        Prior("cooling", "s", "loguniform", 5.0, 5000.0, "From thin shims (seconds) to whole plates (an hour)."),
        Prior("spread", "s", "loguniform", 0.02, 50.0, "Thickness^2 / (pi^2 x 14 mm^2/s): 2 to 80 mm of steel."),
    ),
    act=act,
    acts=(("capacity", "heat"),),
    source="Zimbru et al. 2018 (heat in friction joints); OpenSees FPBearingPTV for the idea of a temperature state.",
    start={"size": (0.1,), "cooling": (30.0, 300.0, 2000.0), "spread": (0.1, 3.0, 20.0)},
)
