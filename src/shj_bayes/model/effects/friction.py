"""How friction follows slip and speed: at the start of sliding, at low speed, while the speed changes."""

from collections.abc import Callable

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import (
    MEMORIES,
    MEMORY,
    felt,
    remembered_through,
    slid_mm,
    slid_since_mm,
    sliding_mm_s,
)
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def _velocity(history: History, values: Values, base: Base) -> Contribution:
    """Gamma of Eq. (2), where the base law runs without it."""
    return Contribution(gamma_s_per_mm=values["size"])


VELOCITY = Effect(
    id="velocity",
    family="even_in_position",
    title="Linear speed dependence",
    statement="Sliding force changes by {size:+.2%} per mm/s of sliding speed (1/dep = {size:+.4f} s/mm).",
    equation="F -> F (1 + g |v|)",
    cause="Friction coefficient of the shim or coating that grows (or falls) with sliding speed.",
    shows="Every plateau arched around mid-stroke, by the same amount in every amplitude block of one peak speed.",
    next_test="Repeat one amplitude at a fifth and at five times the speed: the plateau then moves with the speed.",
    parameters=(
        Prior("size", "s/mm", "normal", 0.0, 0.02, "As gamma: Tables 3-7 of the paper, |1/dep| up to 0.033 s/mm."),
    ),
    act=_velocity,
    acts=(("capacity", "speed"),),
    source="Eq. (2) of the paper, with 1/dep as the parameter.",
    start={"size": (0.005, -0.005)},
)


DEPARTURE = Prior("size", "1", "normal", 0.0, 0.15, "Largest departure from the linear law; either sign.")
CORNER = Prior("corner", "1", "loguniform", 5e-4, 2.0, "Of the peak speed: below it linear, above it logarithmic.")

BENT = "Speed dependence is bent: at low speed the sliding force is up to {size:+.0%} off a linear law."
BESIDE = "Fy -> Fy (1 + c h/max[b - u]), gamma |v| -> gamma |v| - c u/max[b - u], L dh/ds + h = b"
STARTS, CORNERS = {"size": (0.05, -0.05), **MEMORIES}, (0.01, 0.2)


def _velocity_law(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c b / max(b - u), b = ln(1 + u/u0) / ln(1 + 1/u0), u = |v|/v_peak; the straight part from gamma.

    b follows the speed over the memory.

    It is not taken from the clamping: gamma then made up for it, which by Eq. (2) acts on the elastic branches too (up
    to 0.6 kN of 65 wrong there).
    """
    corner = values["corner"]
    scale = np.log1p(1.0 / corner)
    return _beside_the_straight(lambda u: np.log1p(u / corner) / scale, 1.0 / scale - corner, history, values, base)


def _activated(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c b / max(b - u), b = asinh(u/u0) / asinh(1/u0); the straight part is taken from gamma."""
    corner = values["corner"]
    scale = float(np.arcsinh(1.0 / corner))
    steepest = np.sqrt(1.0 / scale**2 - corner**2)
    return _beside_the_straight(lambda u: np.arcsinh(u / corner) / scale, steepest, history, values, base)


def _power(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c (u^n - u), u = |v|/v_peak; the straight part is taken from gamma."""
    power = values["power"]
    place = power ** (1.0 / (1.0 - power))
    return _beside_the_straight(lambda u: np.maximum(u, 1e-9) ** power, place, history, values, base)


def _beside_the_straight(
    law: Callable[[FloatArray], FloatArray], place: float, history: History, values: Values, base: Base
) -> Contribution:
    """Clamping 1 + c h / max(b - u) for a law b(u), 1 at u = 1, and gamma less the straight part.

    h follows b over the memory; the law is furthest from the straight line at `place`, where its slope is 1.
    """
    size = values["size"] / (law(np.array(place)) - place)
    bent = felt(law(history.speed_mm_s / history.peak_speed_mm_s), history, base, values["memory"])
    return Contribution(clamping=1.0 + size * bent, gamma_s_per_mm=float(-size / history.peak_speed_mm_s))


VELOCITY_LAW = (
    Effect(
        id="velocity_law",
        family="low_speed",
        title="Speed dependence that is not linear",
        statement=BENT,
        equation=f"{BESIDE}, b = ln(1 + u/u0)/ln(1 + 1/u0), u = |v|/v_peak, s slid",
        cause="Friction that follows the logarithm of speed or saturates, as most contacts do; a power law looks "
        "alike.",
        shows="Shoulders near both ends of every stroke, where the speed falls; flat around mid-stroke.",
        next_test="Triangular cycles at three or more speeds a factor of 5 apart: the law is then read off directly.",
        parameters=(DEPARTURE, CORNER, MEMORY),
        act=_velocity_law,
        acts=(("capacity", "speed"),),
        source="Rate-and-state friction with a cut-off: ln(1 + |v|/v0).",
        start=STARTS | {"corner": CORNERS},
    )
    .with_form(
        "power",
        statement="Sliding force follows the power {power:.2f} of the speed: {size:+.1%} off a linear law at most.",
        equation="Fy -> Fy (1 + c h/max[u^n - u]), gamma |v| -> gamma |v| - c u/max[u^n - u], L dh/ds + h = u^n, "
        "u = |v|/v_peak, s slid",
        parameters=(
            DEPARTURE,
            Prior("power", "1", "loguniform", 0.05, 0.9, "Fluid films and lubricants: 0.1 to 0.8."),
            MEMORY,
        ),
        act=_power,
        source="Power law of viscous dampers: Constantinou and Symans (1993), F = C |v|^n sgn v.",
        start=STARTS | {"power": (0.2, 0.5)},
    )
    .with_form(
        "asinh",
        statement=BENT,
        equation=f"{BESIDE}, b = asinh(u/u0)/asinh(1/u0), u = |v|/v_peak, s slid",
        parameters=(DEPARTURE, CORNER, MEMORY),
        act=_activated,
        source="Thermally activated sliding, regular at rest: Rice, Lapusta and Ranjith (2001), J. Mech. Phys. Solids.",
        start=STARTS | {"corner": CORNERS},
    )
)


def _stribeck(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a exp(-(|v|/vs)^n); the exponential follows the speed over the memory.

    Contacts stick up to 1 + a, which they hold at rest.
    """
    share = (history.speed_mm_s / values["speed"]) ** values["shape"]
    sticks = base.sliding_from(1.0 + values["size"])
    return Contribution(clamping=1.0 + values["size"] * felt(np.exp(-share), history, sticks, values["memory"]))


STRIBECK = Effect(
    id="stribeck",
    family="low_speed",
    title="Extra friction at low speed",
    statement="Friction is {size:.0%} higher at creep than when sliding, an extra that fades over {speed:.1f} mm/s.",
    equation="Fy -> Fy (1 + a h), L dh/ds + h = exp(-(|v|/vs)^n), s slid",
    cause="Static friction above sliding friction (Stribeck effect): surfaces weld or key when they move slowly.",
    shows="Ears at both ends of every stroke, wider in the larger amplitude blocks.",
    next_test="Triangular cycles at constant speed: the ears vanish, a breakaway peak stays; then slow blocks.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 1.0, "0 to 0.3 for metals, up to 1 for brake linings (NZSEE 1773)."),
        Prior("speed", "mm/s", "loguniform", 0.1, 10.0, "0.1 to 5 mm/s for dry contacts; twice that allowed."),
        Prior("shape", "1", "uniform", 0.5, 2.0, "Exponents of 0.5 to 2 are in use; 2 in most LuGre models."),
        MEMORY,
    ),
    act=_stribeck,
    acts=(("capacity", "speed"),),
    source="Brake-lining dampers (NZSEE repository, 1773); the exponent after Armstrong-Helouvry 1991.",
    start={"size": (0.1,), "speed": (0.5, 2.0), "shape": (1.0,), **MEMORIES},
)


def _friction_memory(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c m and gamma + c/v_peak, m the speed u = |v|/v_peak that the contact remembers while it slides.

    At a steady speed both cancel. The speed of the moment acts as Eq. (2) does, on the elastic branches as well.
    """
    peak = history.peak_speed_mm_s
    slides = base.sliding_from(1.0 - values["size"] * float(np.mean(history.speed_mm_s)) / peak)
    late = remembered_through(lambda run: run.speed_mm_s, history, slides, values["length"], begin=0.0) / peak
    return Contribution(clamping=1.0 - values["size"] * late, gamma_s_per_mm=values["size"] / peak)


FRICTION_MEMORY = Effect(
    id="friction_memory",
    family="odd_in_position",
    title="Friction remembers the speed",
    statement="Friction follows the speed {length:.0f} mm late: {size:+.0%} per unit of peak speed while speeding up.",
    equation="Fy -> Fy (1 - c m), gamma |v| -> gamma |v| + c u, L dm/ds + m = u, u = |v|/v_peak, s slid",
    cause="Friction follows speed with a delay (debris or lubricant film needs some slip to adapt).",
    shows="Plateaus tilted along the motion in every block alike; the push and pull tilts oppose each other in time.",
    next_test="Triangular cycles at constant speed: the tilt vanishes, that of a spring stays.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.3, "Of the part of the friction that depends on speed; either sign."),
        Prior("length", "mm", "loguniform", 0.5, 60.0, "0.5 to 5 mm for contacts, more for films and debris."),
    ),
    act=_friction_memory,
    acts=(("capacity", "acceleration"),),
    source="KU Leuven, Lubricants 2023, 11, 326 (sinusoidal motion). Assumed form: a memory of first order over slip.",
    start={"size": (0.1,), "length": (3.0, 15.0)},
)


PEAK = Prior("size", "1", "uniform", 0.0, 1.0, "Static to kinetic ratio 1 to 2 (NZSEE 1773; spring-asperity bound).")
PEAK_ENDS = "Sliding starts with a peak {size:.0%} above the plateau that is gone after {length:.1f} mm of sliding."


def _breakaway(history: History, values: Values, base: Base) -> Contribution:
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
        PEAK,
        Prior("decay", "mm", "loguniform", 0.1, 15.0, "0.1 to 2 mm for worn coatings, debris; more if grips are soft."),
        Prior("growth", "1", "uniform", 0.0, 1.0, "Growth per decade of rest, as a share of the peak without rest."),
    ),
    act=_breakaway,
    acts=(("capacity", "slip"),),
    source="Ageing of contacts with the logarithm of rest (Hulikal, Bhattacharya and Lapusta, arXiv 1405.3643).",
    start={"size": (0.1,), "decay": (0.5, 2.0, 6.0), "growth": (0.2,)},
)
_WITH_LINEAR = _EXPONENTIAL.with_form(
    "linear",
    statement=PEAK_ENDS,
    equation="Fy -> Fy (1 + a max(0, 1 - d/D)), d slid since the reversal",
    parameters=(
        PEAK,
        Prior("length", "mm", "loguniform", 0.3, 50.0, "Three times the decay length of the exponential form."),
    ),
    act=_linear,
    source="Linear slip weakening (Ida 1972, J. Geophys. Res. 77, 3796; Andrews 1976, J. Geophys. Res. 81, 3575).",
    start={"size": (0.1,), "length": (2.0, 6.0, 18.0)},
)
_WITH_TORN = _WITH_LINEAR.with_form(
    "torn",
    statement=PEAK_ENDS,
    equation="Fy -> Fy (1 + a max(0, 1 - (d/D)^n)), d slid since the reversal",
    parameters=(
        PEAK,
        Prior("length", "mm", "loguniform", 0.3, 50.0, "Length of the longest junctions: as of the linear form."),
        Prior("power", "1", "lognormal", 1.5, 0.5, "1 is the linear form; above it junctions hold at first."),
    ),
    act=_torn,
    source="Assumed form: junctions torn one by one, none left beyond a length; linear where all lengths are as many.",
    start={"size": (0.1,), "length": (2.0, 6.0, 18.0), "power": (2.0,)},
)
BREAKAWAY = _WITH_TORN.with_form(
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


FALL = 0.15  # of a wave length: slow loading, fast drop


def _stick_slip(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a saw(slid/wave); slid counts from where the force reaches Fy, the wave starts at its middle."""
    slid = slid_mm(history, base)
    phase = slid / values["wave"] + 0.5 * (1.0 - FALL)
    phase -= np.floor(phase)
    saw = np.minimum(2.0 / (1.0 - FALL) * phase - 1.0, 2.0 / FALL * (1.0 - phase) - 1.0)
    return Contribution(clamping=1.0 + values["size"] * np.where(slid > 0.0, saw, 0.0))


STICK_SLIP = Effect(
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
    act=_stick_slip,
    acts=(("motion", "stick-slip"),),
    source="The paper reports stick-slip of zinc 100. Assumed form: teeth of one length in slip.",
    start={"size": (0.03,), "wave": tuple(round(0.5 * 1.03**i, 3) for i in range(130))},
)


EFFECTS = (VELOCITY, VELOCITY_LAW, STRIBECK, FRICTION_MEMORY, BREAKAWAY, STICK_SLIP)
