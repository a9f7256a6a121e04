"""A peak when sliding starts, decaying with slip, higher after a rest."""

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import slid_mm, slid_since_mm, sliding_mm_s
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

SIZE = Prior("size", "1", "uniform", 0.0, 1.0, "Static to kinetic ratio 1 to 2 (NZSEE 1773; spring-asperity bound).")
STATEMENT = "Sliding starts with a peak {size:.0%} above the plateau that is gone after {length:.1f} mm of sliding."


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a (1 + b log10(1 + rest/1 s)) exp(-slid/Dc); slid counts from where the force reaches Fy."""
    peak = values["size"] * (1.0 + values["growth"] * np.log10(1.0 + history.rest_s))
    return Contribution(clamping=1.0 + peak * np.exp(-slid_mm(history, base) / values["decay"]))


def _torn(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a max(0, 1 - (d/D)^n)."""
    share = np.clip(slid_mm(history, base) / values["length"], 0.0, 1.0)
    return Contribution(clamping=1.0 + values["size"] * (1.0 - share ** values["power"]))


def _linear(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a max(0, 1 - d/D)."""
    return _torn(history, {**values, "power": 1.0}, base)


@njit(cache=True)
def _ages(slips: FloatArray, rate: FloatArray, step: FloatArray, begin: float) -> FloatArray:
    """Age of the contact, dT/dt = 1 - v T/D, shape (n,), s; exact where it rests first and slides evenly afterwards.

    `slips` is the distance slid since the sample before, as a share of D; `rate` the speed of sliding, D/s; `step` the
    time since the sample before, s.
    """
    out = np.empty_like(slips)
    age = begin
    for i in range(slips.size):
        if slips[i] > 1e-9:
            slides = min(slips[i] / rate[i], step[i]) if rate[i] > 0.0 else 0.0
            keep = np.exp(-slips[i])
            age = (age + (step[i] - slides)) * keep + (1.0 - keep) * slides / slips[i]
        else:
            age += step[i]
        out[i] = age
    return out


def _aged(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a max(0, ln(v T/D)); the age T of the contact is D/v where it slides steadily."""
    step = np.diff(history.time_s, prepend=history.time_s[0])
    slips = slid_since_mm(history, base) / values["length"]
    # At the sample: where sliding begins within a step it is far more than the mean over the step.
    rate = sliding_mm_s(history, base) / values["length"]
    ages = _ages(slips, rate, step, values["rest"])
    return Contribution(clamping=1.0 + values["size"] * np.log(np.maximum(rate * ages, 1.0)))


_EXPONENTIAL = Effect(
    id="breakaway",
    family="start_of_stroke",
    title="Breakaway peak",
    statement="Sliding starts with a peak {size:.0%} above the plateau that decays within {decay:.1f} mm of sliding.",
    equation="Fy -> Fy (1 + a (1 + b log10(1 + rest/1 s)) exp(-d/Dc)), d slid since the reversal",
    cause="Contacts that strengthen while at rest and must be broken before sliding: ageing, debris, corrosion, paint.",
    shows="A peak at the start of each stroke only, fixed in millimetres of slip; highest after a pause.",
    next_test="Pauses of 1, 10, 100 and 1000 s at mid-run: the peak grows in step with the logarithm of the pause.",
    parameters=(
        SIZE,
        Prior("decay", "mm", "loguniform", 0.1, 15.0, "0.1 to 2 mm for worn coatings, debris; more if grips are soft."),
        Prior("growth", "1", "uniform", 0.0, 1.0, "Growth per decade of rest, as a share of the peak without rest."),
    ),
    act=act,
    acts=(("capacity", "slip"),),
    source="Ageing of contacts with the logarithm of rest (Hulikal, Bhattacharya and Lapusta, arXiv 1405.3643).",
    start={"size": (0.1,), "decay": (0.5, 2.0, 6.0), "growth": (0.2,)},
)
_WITH_LINEAR = _EXPONENTIAL.with_form(
    "linear",
    statement=STATEMENT,
    equation="Fy -> Fy (1 + a max(0, 1 - d/D)), d slid since the reversal",
    parameters=(
        SIZE,
        Prior("length", "mm", "loguniform", 0.3, 50.0, "Three times the decay length of the exponential form."),
    ),
    act=_linear,
    source="Linear slip weakening (Ida 1972, J. Geophys. Res. 77, 3796; Andrews 1976, J. Geophys. Res. 81, 3575).",
    start={"size": (0.1,), "length": (2.0, 6.0, 18.0)},
)
_WITH_TORN = _WITH_LINEAR.with_form(
    "torn",
    statement=STATEMENT,
    equation="Fy -> Fy (1 + a max(0, 1 - (d/D)^n)), d slid since the reversal",
    parameters=(
        SIZE,
        Prior("length", "mm", "loguniform", 0.3, 50.0, "Length of the longest junctions: as of the linear form."),
        Prior("power", "1", "lognormal", 1.5, 0.5, "1 is the linear form; above it junctions hold at first."),
    ),
    act=_torn,
    source="Assumed form: junctions torn one by one, none left beyond a length; linear where all lengths are as many.",
    start={"size": (0.1,), "length": (2.0, 6.0, 18.0), "power": (2.0,)},
)
EFFECT = _WITH_TORN.with_form(
    "aged",
    statement=(
        "Sliding starts with a peak {size:.1%} of the force higher for each e-fold of the time at rest; "
        "a few times {length:.1f} mm of sliding take it away."
    ),
    equation="Fy -> Fy (1 + a max(0, ln(v T/D))), dT/dt = 1 - v T/D, v speed of sliding",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.3, "For an e-fold of the age: 0.01 for rock and steel, more if worn."),
        Prior("length", "mm", "loguniform", 0.05, 15.0, "Slip that renews the contacts: debris, coatings, soft grips."),
        Prior("rest", "s", "loguniform", 1.0, 100000.0, "Age of the contact when a run begins: up to a day."),
    ),
    act=_aged,
    source="Rate and state friction whose steady value does not depend on speed (Dieterich 1979; Ruina 1983).",
    start={"size": (0.02,), "length": (0.3, 1.0, 3.0), "rest": (100.0, 3000.0)},
)
