"""What the rig and the law itself add: frame, mass, load cell, delay between the channels, the rule at reversals."""

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def _frame_compliance(history: History, values: Values, base: Base) -> Contribution:
    """Series compliance 1/K_f."""
    return Contribution(compliance_mm_per_kN=values["size"])


FRAME_COMPLIANCE = Effect(
    id="frame_compliance",
    family="start_of_stroke",
    title="Elastic frame or grip in series",
    statement="The frame or grip gives {size:.4f} mm per kN: the stiffness seen is not that of the connection alone.",
    equation="x_device = x - F/K_f",
    cause="The displacement was measured at the actuator: frame, grips and pins stretch along with the device.",
    shows="Slopes at every reversal softer than the device, bends at the knee sharper; almost wholly taken up by K.",
    next_test="Record displacement across the device and at the actuator: the difference against force gives K_f.",
    parameters=(
        Prior("size", "mm/kN", "lognormal", 0.01, 1.5, "K_f 100 kN/mm in the middle, 5 to 2000 kN/mm at two sd."),
    ),
    act=_frame_compliance,
    acts=(("motion", "compliance"),),
    source="Springs in series.",
    start={"size": (0.003, 0.03)},
)


KN_PER_KG_MM_S2 = 1e-6


def _inertia(history: History, values: Values, base: Base) -> Contribution:
    """Add m a."""
    return Contribution(added_kN=values["size"] * KN_PER_KG_MM_S2 * history.acceleration_mm_s2)


INERTIA = Effect(
    id="inertia",
    family="odd_in_position",
    title="Mass moving with the device",
    statement="A mass of {size:.0f} kg moves between device and load cell; subtract m a if it is known.",
    equation="F -> F + m a",
    cause="Fixtures or part of the actuator between the load cell and the sliding surface.",
    shows="Force against the displacement, most at reversals, growing with the square of the frequency.",
    next_test="Repeat one amplitude at half the frequency: the part due to mass falls to a quarter.",
    parameters=(Prior("size", "kg", "loguniform", 0.1, 2e4, "From a clamp to a heavy actuator with its beam."),),
    act=_inertia,
    acts=(("added", "acceleration"),),
    source="Newton's second law.",
    start={"size": (100.0,)},
)


def _load_offset(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy_first."""
    return Contribution(added_kN=base.Fy_first * values["size"])


LOAD_OFFSET = Effect(
    id="load_offset",
    family="even_in_direction",
    title="Constant added to the force",
    statement="A constant of {size:+.1%} of Fy is in the force throughout; if it is the load cell's zero, subtract it.",
    equation="F -> F + c Fy1",
    cause="Load cell not zeroed, weight of fixtures, or a preload.",
    shows="The whole loop shifted up or down, by the same number of kN in both runs, also while sticking.",
    next_test="Read the load cell unloaded before and after the run.",
    parameters=(
        Prior(
            "size", "1", "cauchy", 0.0, 0.03, "0.001-0.01 for a sound load cell; gas pressure on a seal, 10 and more."
        ),
    ),
    act=_load_offset,
    acts=(("added", "constant"),),
    source="Assumed form: a constant, which is what a load cell adds that was not zeroed.",
    start={"size": (0.02, 0.5, 5.0)},
)


def _drift(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy_first, growing with time, slower and slower, and going on from run to run."""
    clock, warming = (history.begun_s + history.time_s) / history.tested_s * history.n_runs, values["warming"]
    return Contribution(added_kN=base.Fy_first * values["size"] * np.expm1(-clock / warming) / np.expm1(-1.0 / warming))


def _zeroed(history: History, values: Values, base: Base) -> Contribution:
    """Add the same drift in each run: the load cell was zeroed before it."""
    clock, warming = history.time_s / history.tested_s * history.n_runs, values["warming"]
    return Contribution(added_kN=base.Fy_first * values["size"] * np.expm1(-clock / warming) / np.expm1(-1.0 / warming))


DRIFT = Effect(
    id="drift",
    family="slow_change",
    title="Force channel drifts",
    statement="The force reading drifts by {size:+.1%} of Fy in a run; if it is the load cell's, subtract it.",
    equation="F -> F + c Fy1 (1 - exp(-n/w))/(1 - exp(-1/w)), n = n_run - 1 + t/T; a straight line for w -> inf",
    cause="Warming amplifier or load cell, a slipping grip, or weight that shifts.",
    shows="Push and pull plateaus that move the same way with time, so that the loop travels up or down.",
    next_test="Read the load cell unloaded before and after the run.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.1, "In the first run, of Fy_first; a sound load cell drifts below 0.01."),
        Prior("warming", "1", "loguniform", 0.2, 50.0, "In runs: amplifiers warm up in minutes to an hour."),
    ),
    act=_drift,
    acts=(("added", "time"),),
    source="Assumed form: an exponential approach, the least that holds both a straight line and a warming-up.",
    start={"size": (0.02,), "warming": (0.5, 5.0)},
).with_form(
    "zeroed",
    statement="The force reading drifts by {size:+.1%} of Fy in each run, from zero.",
    equation="F -> F + c Fy1 (1 - exp(-t/(w T)))/(1 - exp(-1/w)) in each run",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.1, "In a run, of Fy_first; a sound load cell drifts below 0.01."),
        Prior("warming", "1", "loguniform", 0.2, 50.0, "In runs: amplifiers warm up in minutes to an hour."),
    ),
    act=_zeroed,
    source="A load cell that is zeroed before each run.",
    start={"size": (0.02,), "warming": (0.5, 5.0)},
)


def _sensor_lag(history: History, values: Values, base: Base) -> Contribution:
    """Force as it is; `Effect.delay` says how much later it is recorded."""
    return Contribution()


SENSOR_LAG = Effect(
    id="sensor_lag",
    family="start_of_stroke",
    title="Delay between the channels",
    statement="Force is {size:+.3f} s behind displacement (minus: ahead); where the recording is at fault, correct it.",
    equation="F_recorded(t) = F(t - tau)",
    cause="Filters or multiplexed sampling that treat the two channels differently.",
    shows="Reversals shifted along the stroke by tau times the speed there; grows with speed, unlike slack.",
    next_test="Cross-correlate the channels in a fast elastic cycle, or repeat one amplitude five times faster.",
    parameters=(Prior("size", "s", "normal", 0.0, 0.1, "0 to 0.1 s for unequal filters; either channel may be late."),),
    act=_sensor_lag,
    acts=(("motion", "delay"),),
    source="Assumed form: one constant delay, which is what unequal filters do to slow signals.",
    start={"size": (0.03, -0.03)},
    delay="size",
).with_form(
    "filtered",
    statement="Force is {size:.3f} s behind displacement, {share:.0%} of it by a filter that rounds corners.",
    equation="F_recorded(t) = h * F(t - (1 - s) tau), h(u) = u/T^2 exp(-u/T), T = s tau/2",
    parameters=(
        Prior("size", "s", "lognormal", 0.05, 1.0, "Two poles at 1 to 10 Hz are 0.03 to 0.3 s behind."),
        Prior("share", "1", "uniform", 0.0, 1.0, "The rest is multiplexed sampling or another clock."),
    ),
    act=_sensor_lag,
    source="Critically damped low-pass filter of second order, as in bridge amplifiers and anti-alias filters.",
    start={"size": (0.03, 0.1, 0.3), "share": (0.6,)},
    filtered="share",
)


def _reversal_form(history: History, values: Values, base: Base) -> Contribution:
    """Share of the continuous reversal rule."""
    return Contribution(smooth_reversal=values["size"])


REVERSAL_FORM = Effect(
    id="reversal_form",
    family="start_of_stroke",
    title="Reversals without the jump of Eq. (1)",
    statement="Reversals follow the continuous rule to {size:.0%}: use --model continuous, not Eq. (1) as published.",
    equation="F = F_Eq1 + s (e - F_Eq1) while the elastic force e opposes the motion",
    cause="Not the device: Eq. (1) drops the force by 2^(-1/beta) at each reversal, a real device unloads from F.",
    shows="The first millimetres after every reversal, up to where the force passes zero; nothing on the plateau.",
    next_test="None needed: refit with --model continuous and compare.",
    parameters=(Prior("size", "1", "uniform", 0.0, 1.0, "0 is Eq. (1) as published, 1 the continuous rule."),),
    act=_reversal_form,
    acts=(("motion", "reversal"),),
    source="A Menegotto-Pinto branch is continuous (Menegotto and Pinto 1973); Eq. (1) of the paper is not.",
    start={"size": (0.5,)},
)


EFFECTS = (FRAME_COMPLIANCE, INERTIA, LOAD_OFFSET, DRIFT, SENSOR_LAG, REVERSAL_FORM)
