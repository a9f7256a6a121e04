"""What rubbing and heat do to the surfaces, and how far a stroke goes over them."""

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.coordinates import STROKES
from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.effects.sliding import passes, remembered_through, slid_m, slid_since_mm
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def _wear(history: History, values: Values, base: Base) -> Contribution:
    """Clamping exp(-w s); the distance slid s goes on from run to run."""
    return Contribution(clamping=np.exp(-values["size"] * slid_m(history, base)))


def _saturating(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p (1 - exp(-s/s0))."""
    return Contribution(clamping=1.0 + values["size"] * np.expm1(-slid_m(history, base) / values["travel"]))


def _power(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - p (s/S)^n, S the travel in all tests."""
    share = np.maximum(slid_m(history, base) / history.tested_m, 1e-9)
    return Contribution(clamping=1.0 - values["size"] * share ** values["power"])


WEAR = (
    Effect(
        id="wear",
        family="slow_change",
        title="Force falls with travel",
        statement="Sliding force falls by {size:.1%} per metre slid: part of the degradation happens within the run.",
        equation="Fy -> Fy exp(-w s)",
        cause="Wear of shim or coating relaxes the bolts: 0.03 mm of thickness is a tenth of an M16 bolt's tension.",
        shows="Every plateau a little lower than the one before, alike in position and speed; the second run goes on.",
        next_test="Repeat the first blocks at the end (against amplitude); two pauses of 15 min (against heating).",
        parameters=(
            Prior(
                "size", "1/m", "lognormal", 0.05, 1.5, "Losses of 8-80 % over 3.84 m (Tables 3-7) are 0.02-0.4 per m."
            ),
        ),
        act=_wear,
        acts=(("capacity", "travel"),),
        source="Archard wear with the bolt as a spring: its tension falls with the thickness, and with it the wear.",
        start={"size": (0.02,)},
    )
    .with_form(
        "saturating",
        statement="Sliding force falls by {size:.1%} in all, most of it within {travel:.2f} m of sliding.",
        equation="Fy -> Fy (1 - p (1 - exp(-s/s0)))",
        parameters=(
            Prior("size", "1", "uniform", 0.0, 0.9, "A coating that is rubbed off takes its share of the friction."),
            Prior("travel", "m", "loguniform", 0.1, 30.0, "From the first cycles to far more than is tested."),
        ),
        act=_saturating,
        source="Running-in law of wear: Blau (2005), Tribol. Int. 38, 1007, exponential approach to a steady state.",
        start={"size": (0.1,), "travel": (0.5, 2.0, 8.0)},
    )
    .with_form(
        "power",
        statement="Sliding force falls by {size:.1%} over the tests, with the power {power:.2f} of the distance slid.",
        equation="Fy -> Fy (1 - p (s/S)^n), S the travel in all tests",
        parameters=(
            Prior("size", "1", "uniform", 0.0, 0.9, "Losses of 8 to 80 % in Tables 3-7 of the paper."),
            Prior("power", "1", "loguniform", 0.2, 5.0, "Below 1 it wears off, above 1 a worn surface wears faster."),
        ),
        act=_power,
        source="Power law of wear with travel, as fitted to coated plates.",
        start={"size": (0.1,), "power": (0.5, 1.0, 2.0)},
    )
)


def _bedding_in(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + b (1 - exp(-s/s1)); the distance slid s goes on from run to run."""
    return Contribution(clamping=1.0 + values["size"] * (1.0 - np.exp(-slid_m(history, base) / values["travel"])))


def _hyperbolic(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + b s/(s + s1)."""
    slid = slid_m(history, base)
    return Contribution(clamping=1.0 + values["size"] * slid / (slid + values["travel"]))


BEDDING_IN = Effect(
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
    act=_bedding_in,
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


def _local_wear(history: History, values: Values, base: Base) -> Contribution:
    """Clamping exp(-w n); n counts the passes over the place, through all runs."""
    return Contribution(clamping=np.exp(-values["size"] * passes(history, base, values["width"])))


LOCAL_WEAR = Effect(
    id="local_wear",
    family="slow_change",
    title="Force falls where the surface has been rubbed",
    statement="Sliding force falls by {size:.2%} with each pass over a place: a track wears in around mid-stroke.",
    equation="Fy -> Fy exp(-w n), n = passes over the place, averaged over a pad of width b L",
    cause="Coating or shim wears where it is rubbed, most where most cycles pass; the bolts follow the thickness.",
    shows="Plateaus that are alike at first, and more and more dished around mid-stroke with each cycle.",
    next_test="A small block off centre at the end of the test: a place that was rubbed less holds more force.",
    parameters=(
        Prior("size", "1", "lognormal", 0.002, 1.5, "Mid-stroke is passed about 40 times in a run: 0.4 to 30 % a run."),
        Prior("width", "1", "loguniform", 0.05, 0.6, "Pad under the bolts as a share of the half stroke: 5 to 57 mm."),
    ),
    act=_local_wear,
    acts=(("capacity", "passes"),),
    source="Archard wear at each place of the slot, with the bolt as a spring.",
    start={"size": (0.001, 0.005), "width": (0.12, 0.25)},
)


def _centre_wear(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c exp(-(x/w)^2), w a share of the half stroke."""
    return Contribution(clamping=1.0 - values["size"] * np.exp(-((history.normal_position / values["width"]) ** 2)))


def _track(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c exp(-|x/w|^m)."""
    away = np.abs(history.normal_position) / values["width"]
    return Contribution(clamping=1.0 - values["size"] * np.exp(-(away ** values["edge"])))


CENTRE_WEAR = Effect(
    id="centre_wear",
    family="even_in_position",
    title="Worn or powdered centre of the stroke",
    statement="Sliding force is {size:.0%} lower at mid-stroke, where the surfaces have been rubbed most.",
    equation="Fy -> Fy (1 - c exp(-(x/(w L))^2))",
    cause="Coating worn through or powder collected where every cycle passes; or plates crowned by earlier tests.",
    shows="Plateaus dished around mid-stroke; in small amplitude blocks the whole plateau is low.",
    next_test="A small block 60 mm off centre; or one amplitude at a fifth and at five times the speed.",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "A tenth to a third would explain the coated rows of Tables 4-7."),
        Prior("width", "1", "loguniform", 0.1, 1.0, "Half width as a share of the half stroke: 10 to 95 mm of 95 mm."),
    ),
    act=_centre_wear,
    acts=(("capacity", "distance"),),
    source="Assumed form: a bell around mid-stroke, where every cycle passes.",
    start={"size": (0.08,), "width": (0.25, 0.6)},
).with_form(
    "track",
    statement="Sliding force is {size:.0%} lower on a track of even depth around mid-stroke.",
    equation="Fy -> Fy (1 - c exp(-|x/(w L)|^m))",
    parameters=(
        Prior("size", "1", "uniform", 0.0, 0.6, "As of the bell."),
        Prior("width", "1", "loguniform", 0.1, 1.0, "Half width as a share of the half stroke: 10 to 95 mm of 95 mm."),
        Prior("edge", "1", "loguniform", 2.0, 20.0, "From the bell to a track with a step; pads round it."),
    ),
    act=_track,
    source="Assumed form: a track that the small cycles of a test have rubbed, under a pad that rounds its ends.",
    start={"size": (0.08,), "width": (0.25, 0.5), "edge": (5.0,)},
)


PER_DOUBLING = Prior(
    "size", "1", "normal", 0.0, 0.04, "Per doubling; 16 % from the smallest to the largest block of Table 1."
)


def _amplitude(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c log2(A/A_max)."""
    return Contribution(clamping=1.0 + values["size"] * _doublings(history, history.amplitude_mm))


def _gradual(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + c m, m the doublings log2(A/A_max) that the contact has got used to over a distance slid."""
    late = remembered_through(lambda run: _doublings(run, run.amplitude_mm), history, base, values["length"])
    return Contribution(clamping=1.0 + values["size"] * late)


def _doublings(history: History, amplitude_mm: FloatArray) -> FloatArray:
    """Binary logarithm of A/A_max; amplitudes below a hundredth of the largest count as that."""
    return np.asarray(np.log2(np.maximum(amplitude_mm / history.half_stroke_mm, 0.01)))


AMPLITUDE = Effect(
    id="amplitude",
    family="slow_change",
    title="Force depends on the amplitude",
    statement="Each doubling of the amplitude changes the sliding force by {size:+.1%}.",
    equation="Fy -> Fy (1 + c log2(A/A_max))",
    cause="Longer strokes clear more debris from the contact, heat more or load the bolts more; or partial sliding.",
    shows="A step in the plateau from block to block, none within a block.",
    next_test="Repeat the smallest blocks at the end of the run: an amplitude effect comes back, wear does not.",
    parameters=(PER_DOUBLING,),
    act=_amplitude,
    acts=(("capacity", "amplitude"),),
    source="Assumed form: one change for each doubling, because most blocks of Table 1 double the one before.",
    start={"size": (0.02, -0.02)},
).with_form(
    "gradual",
    statement="Each doubling of the amplitude changes the sliding force by {size:+.1%}, {length:.0f} mm of slip late.",
    equation="Fy -> Fy (1 + c m), L dm/ds + m = log2(A/A_max), s slid",
    parameters=(
        PER_DOUBLING,
        Prior("length", "mm", "loguniform", 1.0, 3000.0, "From a part of a stroke to all strokes of a block."),
    ),
    act=_gradual,
    source="Debris is swept out stroke by stroke: the film follows with a slip length, as in rate and state friction.",
    start={"size": (0.02, -0.02), "length": (60.0, 300.0, 1000.0)},
)


N_MODES = 7  # the plate as a whole, and heat through its thickness; the next last a fiftieth of its time
STEEPEST = 1.55  # of the first mode's angle: at pi/2 the far face is held cold


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


def _thermal(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 - c T/T_ref; T_ref is reached by sliding `STROKES` half strokes at peak speed and full force.

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


THERMAL = Effect(
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
    act=_thermal,
    acts=(("capacity", "heat"),),
    source="Zimbru et al. 2018 (heat in friction joints); OpenSees FPBearingPTV for the idea of a temperature state.",
    start={"size": (0.1,), "cooling": (30.0, 300.0, 2000.0), "spread": (0.1, 3.0, 20.0)},
)


EFFECTS = (WEAR, BEDDING_IN, LOCAL_WEAR, CENTRE_WEAR, AMPLITUDE, THERMAL)
