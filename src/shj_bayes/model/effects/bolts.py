"""What bolts and plates do: clamping over position, direction and time, clearances, ends of the slot, springs."""

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def _taper(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c x/L."""
    return Contribution(clamping=1.0 + values["size"] * history.normal_position)


TAPER = Effect(
    id="taper",
    family="odd_in_position",
    title="Force grows towards one end of the slot",
    statement="Sliding force is {size:+.0%} at the positive end of the stroke and the opposite at the other end.",
    equation="Fy -> Fy (1 + c x/L)",
    cause="Plates not parallel or not flat: a wedge tightens the bolts towards one end of the slot.",
    shows="Push and pull plateaus that open or close towards one end; sliding resistance, so both shrink with Fy.",
    next_test="Measure the plate thickness along the slot; or turn the cleat end for end and repeat one block.",
    parameters=(Prior("size", "1", "normal", 0.0, 0.15, "Within 10 % for plates of usual tolerance; either sign."),),
    act=_taper,
    acts=(("capacity", "position"),),
    source="Assumed form: a straight line over the position, which is what a wedge does to the bolts.",
    start={"size": (0.03,)},
)


def _prying(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p (|x|/L)^m."""
    off_centre = np.maximum(np.abs(history.normal_position), 1e-9)
    return Contribution(clamping=1.0 - values["size"] * np.exp(values["power"] * np.log(off_centre)))


def _beyond_a_gap(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p <|x|/L - g>+ / (1 - g)."""
    gap = values["gap"]
    beyond = np.maximum(np.abs(history.normal_position) - gap, 0.0) / (1.0 - gap)
    return Contribution(clamping=1.0 - values["size"] * beyond)


PRYING = Effect(
    id="prying",
    family="even_in_position",
    title="Clamping lost away from mid-stroke",
    statement="Clamping falls away from mid-stroke: {size:.0%} lower at full stroke than at the centre.",
    equation="Fy -> Fy (1 - p (|x|/L)^m)",
    cause="Prying: the plates rotate or bend as the bolts leave mid-slot and the bolts lose tension.",
    shows="Plateaus that droop towards both ends, most in the largest amplitude blocks (a speed law: alike in all).",
    next_test="Repeat one amplitude at a fifth and at five times the speed; or a small block 60 mm off centre.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "Up to 0.3 expected in AFC column bases; twice that allowed."),
        Prior("power", "1", "uniform", 0.8, 3.0, "1 is a V (tilting plates), 2 a U (bending plates)."),
    ),
    act=_prying,
    acts=(("capacity", "distance"),),
    source="Column-base AFC studies cited by the paper [14, 15]. Assumed form: V (tilting) to U (bending).",
    start={"size": (0.08,), "power": (1.2, 2.2)},
).with_form(
    "gap",
    statement="Clamping is lost beyond {gap:.0%} of the stroke, up to {size:.0%} at its end: prying.",
    equation="Fy -> Fy (1 - p <|x|/L - g>+/(1 - g))",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "Up to 0.3 expected in AFC column bases; twice that allowed."),
        Prior("gap", "1", "uniform", 0.0, 0.9, "The plates may tilt freely at first."),
    ),
    act=_beyond_a_gap,
    source="Lever of the plates once a gap has closed.",
    start={"size": (0.08,), "gap": (0.2, 0.5)},
)


def _asymmetry(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a q."""
    return Contribution(clamping=1.0 + values["size"] * history.direction)


def _shift(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy of the run: what every contact does by itself moves the loop as a whole."""
    return Contribution(added_kN=base.Fy * values["size"])


ASYMMETRY = Effect(
    id="asymmetry",
    family="even_in_direction",
    title="Push and pull differ",
    statement="Sliding force is {size:+.0%} off the mean while displacement grows, and the opposite while it falls.",
    equation="Fy -> Fy (1 + a q), q = sign(v)",
    cause="Lever or band action, bolts that lean one way, or plates that pinch in one direction.",
    shows="One plateau level for each direction; the difference shrinks with Fy in the second run.",
    next_test="Read the load cell unloaded: a reading of zero leaves asymmetry, anything else is an offset.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "0-15 % in friction connections, more in band brakes; either sign."),
    ),
    act=_asymmetry,
    acts=(("capacity", "direction"),),
    source="Assumed form: one factor for each direction, the least that makes push and pull differ.",
    start={"size": (0.05,)},
).with_form(
    "shift",
    statement="The whole loop is shifted by {size:+.0%} of Fy: each contact slides later in one direction.",
    equation="F -> F + a Fy, Fy that of the run",
    parameters=(Prior("size", "1", "normal", 0.0, 0.15, "As where capacity follows the direction at once."),),
    act=_shift,
    source="Masing's rule for contacts in parallel, each of which slides at 1 + a in push and at 1 - a in pull.",
    start={"size": (0.05,)},
)


RAMP = 0.005  # of the testing time: sudden for an engineer, smooth enough for a search
FAR = 37.0  # ramps from its middle, where a logistic function is 0 or 1 to double precision


@njit(cache=True)
def _window(clock: FloatArray, begin: float, end: float) -> FloatArray:
    """Rise from 0 to 1 at the beginning and fall at the end, both as logistic functions."""
    out = np.empty_like(clock)
    for i in range(clock.size):
        rise, fall = (clock[i] - begin) / RAMP, (end - clock[i]) / RAMP
        out[i] = 0.0 if min(rise, fall) < -FAR else 1.0
        if abs(rise) < FAR:
            out[i] /= 1.0 + np.exp(-rise)
        if abs(fall) < FAR:
            out[i] /= 1.0 + np.exp(-fall)
    return out


def _tension_step(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c (1 + side q) from a moment on, for a time; both as shares of the testing time of all runs."""
    clock = np.minimum((history.begun_s + history.time_s) / history.tested_s, 1.0)  # after the tests it stays as it is
    window = _window(clock, values["begin"], values["begin"] + values["length"])
    return Contribution(clamping=1.0 + values["size"] * (1.0 + values["side"] * history.direction) * window)


def _swing(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c sin(2 pi (t/p + phase))."""
    turns = (history.begun_s + history.time_s) / (values["period"] * history.tested_s) + values["phase"]
    return Contribution(clamping=1.0 + values["size"] * np.sin(2.0 * np.pi * turns))


TENSION_STEP = Effect(
    id="tension_step",
    family="slow_change",
    title="Clamping changes with time",
    statement="Clamping changes by {size:+.0%} at {begin:.0%} of the testing time, for {length:.0%} of it.",
    equation="Fy -> Fy (1 + c (1 + side q)) for begin < (n_run - 1 + t/T)/N < begin + length",
    cause="A bolt loosened, cracked, yielded or was re-tightened; or the clamping was adjusted during the test.",
    shows="All plateaus between two moments higher or lower, with steady plateaus before and after.",
    next_test="A load washer under the bolt head: it shows the change without any model.",
    parameters=(
        Prior(
            "size", "1", "normal", 0.0, 0.25, "From the slip of a bolt to the loss of one of two; mean of directions."
        ),
        Prior("begin", "1", "uniform", 0.0, 1.0, "Share of the testing time: any moment."),
        Prior("length", "1", "loguniform", 0.02, 2.0, "Share of the testing time: from about a cycle to its end."),
        Prior("side", "1", "uniform", -1.0, 1.0, "1 while displacement grows only, -1 while it falls only, 0 both."),
    ),
    act=_tension_step,
    acts=(("capacity", "time"),),
    source="brfd-lehigh ds4_step, where the band was moved in one direction only; a bolt that breaks does the same.",
    start={
        "size": (0.1,),
        "begin": tuple(round(0.03 + 0.04 * i, 2) for i in range(24)),
        "length": (0.05, 0.15, 0.3, 1.5),
        "side": (-0.9, 0.0, 0.9),
    },
).with_form(
    "swing",
    statement="Clamping swings by {size:.1%} up and down, once in {period:.2f} of the testing time.",
    equation="Fy -> Fy (1 + c sin(2 pi (t/(p T) + phase))), T the testing time of all runs",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.5, "Temperature of the hall, or a clamping that is controlled."),
        Prior("period", "1", "loguniform", 0.02, 2.0, "Share of the testing time."),
        Prior("phase", "1", "uniform", -0.2, 1.2, "Turns at the beginning."),
    ),
    act=_swing,
    source="brfd-lehigh ds4_harmonic: a band whose force follows a sine.",
    start={
        "size": (0.05,),
        "period": tuple(round(0.025 * 1.12**i, 4) for i in range(36)),
        "phase": (0.1, 0.35, 0.6, 0.85),
    },
)


def _slack(history: History, values: Values, base: Base) -> Contribution:
    """Free travel at zero force, then a contact that closes over a distance."""
    size = values["size"]
    return Contribution(slack_mm=size, take_up_mm=values["softness"] * size, open_at_start=values["start"])


SLACK = Effect(
    id="slack",
    family="start_of_stroke",
    title="Free travel at reversals",
    statement="The connection moves {size:.1f} mm without load at every reversal before it picks up again.",
    equation="F = 0 over a distance g once the force has unloaded to zero; then 0.4 K over s g, then K",
    cause="Clearance of bolts, pins or the grips: backlash in series with the sliding surfaces.",
    shows="A flat step at zero force in every reversal, of one width in all amplitudes, speeds and clamping levels.",
    next_test="Two slow small cycles at low clamping, or a displacement gauge across the device itself.",
    parameters=(
        Prior("size", "mm", "uniform", 0.0, 10.0, "Standard holes give 2 mm a side; brfd-lehigh has 3 mm."),
        Prior(
            "softness", "1", "loguniform", 0.02, 5.0, "Bolts with unlike clearances meet one after another: s about 1."
        ),
        Prior("start", "1", "uniform", 0.0, 1.0, "Which side of its clearance the device rests against is chance."),
    ),
    act=_slack,
    acts=(("motion", "slack"),),
    source="The paper's brass shim ('slid rigidly back to zero').",
    start={"size": (0.5, 2.0, 6.0), "softness": (0.1, 1.0, 4.0), "start": (0.2, 0.8)},
    initial=("start",),
)


def _two_stage(history: History, values: Values, base: Base) -> Contribution:
    """Put a share of stiffness and capacity behind a clearance (mm) that is crossed at zero force."""
    return Contribution(second_surface=(values["size"], values["delay"], values["bolts"]))


TWO_STAGE = Effect(
    id="two_stage",
    family="start_of_stroke",
    title="Second sliding surface",
    statement="{size:.0%} of the sliding force comes from a second surface that follows {delay:.1f} mm later.",
    equation="F = (1 - s) F_MP + s F_MP with a gap of d0 at zero force",
    cause="Asymmetric connection: the cap-plate side slides only once the bolts have leaned over.",
    shows="A knee part-way up every reversal at a fixed distance, the same in all amplitudes and speeds.",
    next_test="A displacement gauge on the cap plate: it stands still for the first few millimetres.",
    parameters=(
        Prior(
            "size", "1", "uniform", 0.0, 0.6, "Half for two equal surfaces, the cap-plate side being the weaker one."
        ),
        Prior("delay", "mm", "loguniform", 0.3, 15.0, "1 to 5 mm for M16 bolts with 2 mm hole clearance."),
        Prior("bolts", "1", "uniform", 0.1, 1.0, "Stiffness over its share of K: bolts that bend make it softer."),
    ),
    act=_two_stage,
    acts=(("motion", "second surface"),),
    source="MacRae et al. 2010, Bulletin NZSEE 43(3), 202: the bolts of asymmetric friction connections.",
    start={"size": (0.3,), "delay": (1.0, 3.0, 8.0), "bolts": (0.8,)},
)


def _end_bearing(history: History, values: Values, base: Base) -> Contribution:
    """Add a force k (1 + side s) <|x| - x_g>+ s, s = sign(x), of which a share comes back; k is in Fy_first per mm."""
    end = np.sign(history.position_mm)
    into = np.maximum(np.abs(history.position_mm) - values["contact"] * history.half_stroke_mm, 0.0)
    held = np.where(history.direction == end, 1.0, values["returned"])
    return Contribution(added_kN=base.Fy_first * values["size"] * (end + values["side"]) * into * held)


END_BEARING = Effect(
    id="end_bearing",
    family="end_of_stroke",
    title="Bolt meets the end of the slot",
    statement="Beyond {contact:.0%} of the stroke the bolt bears on the slot end: {size:.1%} of Fy more per mm.",
    equation="F -> F + k (1 + side s) <|x| - x_g>+ s, s = sign(x); times r while moving back (k: mean of both ends)",
    cause="Slot shorter than the stroke, assembly off centre, or debris and coating piled up at the slot end.",
    shows="The last millimetres of the largest strokes, often at one end only.",
    next_test="Look at the slot ends and measure the clearance; repeat the largest block 10 mm smaller.",
    parameters=(
        Prior("size", "1/mm", "lognormal", 0.05, 1.3, "4 kN/mm of 80 kN; tight bolt bearing reaches 20-300 kN/mm."),
        Prior("contact", "1", "uniform", 0.5, 1.0, "Where contact starts, as a share of the half stroke."),
        Prior("side", "1", "uniform", -1.0, 1.0, "1 is the positive end only, -1 the negative end only, 0 both alike."),
        Prior("returned", "1", "uniform", 0.0, 1.0, "0 a crushed contact that lets go at once, 1 an elastic one."),
    ),
    act=_end_bearing,
    acts=(("added", "position"),),
    source="Gap elements of OpenSees and suanPan; the slot of the paper, 220 mm, leaves 7 mm behind a stroke of 95 mm.",
    start={"size": (0.03,), "contact": (0.75, 0.92), "side": (-0.7, 0.0, 0.7), "returned": (0.2,)},
)


def _restoring(history: History, values: Values, base: Base) -> Contribution:
    """Add k [(1 - c) u + c u^3] as a share of Fy_first, u = x/L."""
    u, cubic = history.normal_position, values["stiffening"]
    return Contribution(added_kN=base.Fy_first * values["size"] * u * (1.0 - cubic + cubic * u * u))


RESTORING = Effect(
    id="restoring",
    family="odd_in_position",
    title="Elastic stiffness after sliding",
    statement="A spring works beside the friction: {size:+.0%} of Fy at full stroke (positive pulls to mid-stroke).",
    equation="F -> F + k Fy1 [(1 - c) u + c u^3], u = x/L",
    cause="Bending of plates and columns, leaning bolts, ring springs or gravity.",
    shows="Both plateaus tilted the same way, through mid-stroke; the tilt is the same in both runs.",
    next_test="Loosen the bolts and push through one slow stroke: what force is left is the spring.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "0-0.1 kN/mm over 95 mm at 80 kN; negative with gravity."),
        Prior("stiffening", "1", "uniform", 0.0, 0.6, "Cubic share: plates and columns stiffen as they bend."),
    ),
    act=_restoring,
    acts=(("added", "position"),),
    source="Assumed form: a linear and a cubic spring, the least that is odd in the position and stiffens.",
    start={"size": (0.03,), "stiffening": (0.1,)},
)


EFFECTS = (TAPER, PRYING, ASYMMETRY, TENSION_STEP, SLACK, TWO_STAGE, END_BEARING, RESTORING)
