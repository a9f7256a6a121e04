"""What comes again: whole cycles, periods of a coordinate, chatter."""

import math
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.special import ndtri

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.inference.gaussian import log_gains
from shj_bayes.mismatch.data import AVERAGED_S, BinnedData, ErrorModel
from shj_bayes.mismatch.hypothesis import (
    EXPLAINED,
    FORMS,
    Candidate,
    Dependence,
    Parametrisation,
    beside_law,
    candidates,
    screen,
    size_weights,
)
from shj_bayes.mismatch.laplace import Laplace, laplace_under
from shj_bayes.model.coordinates import Coordinate, coordinates, coordinates_of
from shj_bayes.model.curve import PERIODS_PER_UNIT, SIZES, Curve
from shj_bayes.model.effects.effect import Effect, Values
from shj_bayes.model.filter import AT_REST_SD

PER_STROKE = 8  # places at which a stroke is looked at


def is_clock(over: Coordinate) -> bool:
    """Whether a coordinate goes on from stroke to stroke and has curves that come again: it is a clock."""
    return over.goes == "test" and over.repeats > 0.0


def is_over_a_clock(of: Dependence) -> bool:
    """Whether a class is a dependence on time."""
    return any(is_clock(over) for over in coordinates_of(of.coordinate))


def comes_again_in_place(of: Dependence) -> bool:
    """Whether curves of a class may come again along the stroke."""
    over = _repeating(of)
    return over is not None and not is_clock(over)


def of_whole_cycles(data: BinnedData, of: Dependence) -> Dependence:
    """Give a class over a clock without the curves that change within a cycle, as position and direction do.

    The smoothest curves stay, and have the probability of those that are left out. The class itself where nothing is.
    """
    histories = [part.history for part in data.blocks]
    moved_s = sum(float(h.time_s[-1] - h.time_s[0]) for h in histories)
    cycle = 2.0 * moved_s / sum(h.motion.n_half for h in histories) / histories[-1].tested_s
    if not is_over_a_clock(of) or all(v.curve is None or v.curve.length >= cycle for v in of.variants):
        return of
    kept = tuple(v for v in of.variants if v.curve is None)
    for sides in sorted({v.curve.sides for v in of.variants if v.curve}):
        own = [v for v in of.variants if v.curve is not None and v.curve.sides == sides]
        slow = [v for v in own if v.curve and v.curve.length >= cycle] or own[-1:]
        more = sum(v.weight for v in own) / sum(v.weight for v in slow)
        kept += tuple(replace(v, weight=v.weight * more) for v in slow)
    return replace(of, variants=kept)


def follows_cycles(data: BinnedData, effect: Effect, values: Values) -> bool:
    """Whether what an effect does keeps step with the cycles."""
    return bool(keep_step(_does_by_stroke(data, effect, values), sides="side" in values)[0])


def goes_one_way(data: BinnedData, effect: Effect, values: Values) -> bool:
    """Whether what an effect does goes one way from stroke to stroke, by most of all its changes."""
    courses = [own.mean(axis=(1, 2)) for own in _does_by_stroke(data, effect, values)]
    net = sum(abs(course[-1] - course[0]) for course in courses)
    return bool(net >= EXPLAINED * sum(np.abs(np.diff(course)).sum() for course in courses))


def _does_by_stroke(data: BinnedData, effect: Effect, values: Values) -> list[FloatArray]:
    """Give what an effect does to the force, as a share of Fy, as from `by_stroke`."""
    columns = []
    for part in data.blocks:
        does = effect.act(part.history, values, data.base)
        share = np.broadcast_to(does.clamping + does.added_kN / data.scale_kN, part.history.time_s.shape)
        columns.append(share[:, None])
    return by_stroke(data, columns)


def by_stroke(data: BinnedData, columns: Sequence[FloatArray]) -> list[FloatArray]:
    """Functions at `PER_STROKE` places of each push and of each pull, shapes (strokes, places, p).

    They are given at the points of each run, shapes (n_points, p).
    """
    at = (np.arange(PER_STROKE) + 0.5) / PER_STROKE
    strokes: dict[float, list[FloatArray]] = {1.0: [], -1.0: []}
    for part, column in zip(data.blocks, columns, strict=True):
        motion = part.history.motion
        for k, direction in enumerate(motion.direction):
            begin, end = motion.start[k], motion.start[k + 1]
            strokes[float(direction)].append(column[np.minimum((begin + at * (end - begin)).astype(int), end - 1)])
    return [np.array(own).reshape(len(own), PER_STROKE, columns[0].shape[1]) for own in strokes.values()]


def keep_step(strokes: Sequence[NDArray[Any]], *, sides: bool = False) -> BoolArray:
    """Whether more than half of the variance of each function, as from `by_stroke`, is the same in each cycle, (p,).

    They may be complex; with `sides` their variance is that about their means in push and in pull. A constant keeps
    step; nothing does where a test has no second cycle.
    """
    if min(len(own) for own in strokes) < 2:
        return np.zeros(strokes[0].shape[2], dtype=bool)
    if sides:
        strokes = [own - own.mean(axis=(0, 1)) for own in strokes]
    same = np.var(np.concatenate([own.mean(axis=0) for own in strokes]), axis=0)
    apart = np.mean([np.var(own, axis=0).mean(axis=0) for own in strokes], axis=0)
    return np.asarray((same > apart) | (same + apart == 0.0))


LENGTH = 0.15  # correlation length of a curve that comes again, as a share of its period
PER_TURN = 2.2  # blocks to a period at least, for it to be seen at all
MOST_TURNS = 200.0  # in all tests: what is faster counts as noise
AT_ONCE = 128  # frequencies
BINS_PER_TURN, FEWEST_PASSES = 4.0, 4  # bins to the shortest period; blocks in one of them
GOOD_PART = 0.3  # of the variance of a residual
STANDS_OUT = 3.0  # of the variance that the means of noise have


def waves(metric: ErrorModel, state: Laplace, of: Dependence, most: int = 2) -> list[Candidate]:
    """Find at most so many periods after which a curve of a class may come again, beside a model.

    An empty list where curves over the coordinate do not come again: `Coordinate.repeats` says how likely that is.
    """
    over, data = _repeating(of), metric.data
    if over is None:
        return []
    slowest, fastest = _limits(data, over)
    spacing = slowest / 4.0
    frequencies = np.arange(slowest, fastest, spacing)
    if is_clock(over):
        places = [over.values(part.history, data.base)[:, None] for part in data.blocks]
        turns = [np.exp(2j * np.pi * frequencies * place) for place in by_stroke(data, places)]
        frequencies = frequencies[~keep_step(turns)]
    if frequencies.size < 3:
        return []
    response = _response(data, state, of.action)
    if (of.action, over.id) not in data.waves:  # what more capacity gives differs little from model to model
        data.waves[of.action, over.id] = _columns(data, over, response, frequencies)
    gains = _gains(metric, state, data.waves[of.action, over.id], (of.action, over.id))
    peaks = np.flatnonzero((gains >= np.append(gains[1:], -np.inf)) & (gains >= np.append(-np.inf, gains[:-1])))
    weight = (1.0 - FORMS) * over.repeats / frequencies.size
    out = []
    for peak in peaks[np.argsort(-gains[peaks], kind="stable")][:most]:
        near = frequencies[peak] + spacing * np.linspace(-0.75, 0.75, 13)
        height = _gains(metric, state, _columns(data, over, response, near))
        # The top of the parabola through the highest one and its neighbours.
        k = int(np.clip(np.argmax(height), 1, near.size - 2))
        below, middle, above = height[k - 1 : k + 2]
        bend = 2.0 * middle - below - above
        shift = 0.5 * (above - below) / bend if bend > 0.0 else 0.0
        best = float(near[k] + np.clip(shift, -1.0, 1.0) * (near[1] - near[0]))
        curve = Curve(of.action, over.id, LENGTH, period=round(PERIODS_PER_UNIT / best) / PERIODS_PER_UNIT)
        variant = Parametrisation(curve, curve.effect(), weight)
        out += [replace(c, of=of) for c in candidates(data, state, (replace(of, variants=(variant,)),))]
    return out


def resolved(metric: ErrorModel, state: Laplace, of: Sequence[Dependence]) -> BinnedData:
    """Give the recordings in blocks that show what comes again: shorter ones where its period is too short for these.

    The state is that of the base law.
    """
    shown = data = metric.data
    known: dict[str, tuple[ErrorModel, Laplace] | None] = {}  # of a coordinate, for all its classes
    for one in of:
        over = _repeating(one)
        if over is None:
            continue
        if over.id not in known:
            new = _finest(data, state, over)
            known[over.id] = None if new is None else laplace_under(new, metric.setting, state.model, state.z)
        if (found := known[over.id]) is None:
            continue
        own, base = found
        best = max(screen(own, base, waves(own, base, one, 1)), key=lambda c: c.gain, default=None)
        period = best.variant.curve.period if best and best.variant.curve and best.gain > 0.0 else None
        # Averaged over nearly half a period a wave is too small; a clock has others beside it.
        if best is None or period is None or period * _limits(data, over)[1] >= (1.0 if is_clock(over) else 2.0):
            continue
        if is_clock(over):
            shown = own.data if shown is data else shown
            continue
        n_smooth = round(PER_TURN * base.residual.size / state.residual.size)
        all_of_it, rest = (f - uniform_filter1d(f, n_smooth) for f in (base.residual, base.residual - best.change))
        if float(np.var(rest)) < (1.0 - GOOD_PART) * float(np.var(all_of_it)):
            longest_s = 0.5 * period / (PER_TURN * data.blocks[0].history.peak_speed_mm_s)
            # From the first reading of a block to its last.
            shown = replace(data, longest_s=max(0.0, longest_s - data.timings[0].step_s)).finer_at(state.model, state.z)
    return shown


def _finest(data: BinnedData, state: Laplace, over: Coordinate) -> BinnedData | None:
    """Give the recordings in blocks that may show what comes again sooner over a coordinate than these do.

    None where all is shown, or where no place is passed with another force each time than the places beside it.
    """
    slowest, fastest = _limits(data, over)
    if fastest >= MOST_TURNS / 2.0 * slowest:
        return None
    if is_clock(over):
        return data.finer_at(data.device, data.z)
    history = data.blocks[0].history
    low, high = over.reach(history)
    shortest = (high - low) / MOST_TURNS
    fine = data.finer_at(state.model, state.z, longest_s=shortest / (PER_TURN * history.peak_speed_mm_s))
    residual = fine.likelihood.at(state.model).residual(state.z[None])[0]
    place = (fine.blocks.channel(over.id + "_mm") - low) / shortest * BINS_PER_TURN
    return fine if _comes_again(residual, place, fine, round(BINS_PER_TURN / (fastest * shortest))) else None


def _comes_again(residual: FloatArray, place: FloatArray, data: BinnedData, n_smooth: int) -> bool:
    """Whether the residual is another one in some places than in those beside them, pass for pass.

    Its means in bins of the place where the device slides, in push and in pull apart, less their smooth course over
    `n_smooth` bins to either side, are held against the scatter of single passes.
    """
    sense = np.sign(data.blocks.channel("direction"))
    along = sense * (data.blocks.force_kN - residual)
    used = (data.blocks.used > 0) & (along > SLIDING * along.max())
    ratio = []
    for sign in (-1.0, 1.0):
        own = used & (sense == sign)
        bins = np.clip(place[own], 0, BINS_PER_TURN * MOST_TURNS).astype(np.int64)
        count = np.bincount(bins)
        known = count > FEWEST_PASSES
        if known.sum() <= 2 * n_smooth + 1:
            continue
        from scipy.signal import savgol_filter  # noqa: PLC0415  half a second, for long recordings only

        mean = np.bincount(bins, residual[own])[known] / count[known]
        rest = mean - savgol_filter(mean, 2 * n_smooth + 1, polyorder=3)
        each = residual[own] - np.interp(bins, np.flatnonzero(known), mean - rest)
        ratio.append(float(np.mean(rest**2 * count[known])) / float(np.var(each)))
    return max(ratio, default=0.0) > STANDS_OUT


def _repeating(of: Dependence) -> Coordinate | None:
    """Coordinate of a class whose curves may come again."""
    over = coordinates().get(of.coordinate)
    return over if over is not None and over.repeats and any(v.curve for v in of.variants) else None


def _limits(data: BinnedData, over: Coordinate) -> tuple[float, float]:
    """Lowest and highest frequency that is looked at over a coordinate, in turns to its unit."""
    values = [over.values(part.history, data.base) for part in data.blocks]
    place = data.blocks.mean(values)
    block = float(np.quantile(np.abs(np.diff(place[data.blocks.used > 0])), 0.9))  # all but the longest tenth
    low, high = over.reach(data.blocks[0].history)
    return 2.0 / (high - low), min(1.0 / (PER_TURN * block), MOST_TURNS / (high - low))


def _response(data: BinnedData, state: Laplace, action: str) -> list[FloatArray]:
    """Force at the points of each run by a curve of height 1: Fy where it is added, what more capacity gives else."""
    histories = [part.history for part in data.blocks]
    if action == "added":
        return [np.full(h.position_mm.size, data.scale_kN) for h in histories]
    step = 1e-3
    at = list(state.model.law_names).index("Fy")
    z = state.z + step * np.eye(state.z.size)[at][None]
    theta = state.model.laws.natural(np.vstack([state.z, z]))
    rise = float(theta[1, at] / theta[0, at] - 1.0)
    forces = [part.force(state.model, theta) for part in data.blocks]
    return [np.asarray((f[1] - f[0]) / rise) for f in forces]


def _columns(data: BinnedData, over: Coordinate, response: list[FloatArray], frequencies: FloatArray) -> FloatArray:
    """Force of each block by a cosine and a sine of each frequency, shape (n, n_frequencies, 2), kN."""
    places = [over.values(part.history, data.base) for part in data.blocks]
    parts = []
    for some in np.array_split(frequencies, -(-frequencies.size // AT_ONCE)):
        angles = [2.0 * np.pi * place[:, None] * some for place in places]
        points = [np.concatenate([np.cos(a), np.sin(a)], axis=1) for a in angles]
        blocks = data.blocks.mean([p * r[:, None] for p, r in zip(points, response, strict=True)])
        parts.append(np.stack(np.split(blocks, 2, axis=1), axis=2))
    return np.concatenate(parts, axis=1)


def _gains(metric: ErrorModel, state: Laplace, columns: FloatArray, known: Hashable = None) -> FloatArray:
    """Log Bayes factor of a plain wave of each frequency, to first order, shape (n_frequencies,).

    Columns that are asked for again have a key, by which they are `known`.
    """
    k = columns.shape[1]
    flat = columns.reshape(columns.shape[0], 2 * k)
    wave, taken = metric.factors(flat) if known is None else metric.factors_of({known: flat})
    along, cross, solved = beside_law(metric, state, wave, taken)
    inner = _of_each(wave, wave) - _of_each(taken, taken) - _of_each(cross, solved)
    gains = log_gains(inner, along.reshape(k, 2), np.array(SIZES))
    return np.asarray(np.logaddexp.reduce(gains + np.log(size_weights()), axis=-1))


def _of_each(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of the cosine and the sine of each frequency in `a` with those in `b`, shape (m, 2 k) to (k, 2, 2)."""
    pairs = [np.einsum("mk,mk->k", a[:, i::2], b[:, j::2]) for i in (0, 1) for j in (0, 1)]
    return np.stack(pairs, axis=-1).reshape(-1, 2, 2)


TOGETHER = 8  # readings in a row that must scatter: a jump of the force is none
# Median product of neighbouring second differences of white noise of variance 1, its sign turned; its mean is 4, which
# also holds for readings in steps. That of teeth is larger yet, that of what a model misses negative.
ALTERNATE, MEAN = 1.482, 4.0
SURE = 0.99  # probability with which what is called chatter is no noise
MOST_AT_REST = math.exp(
    float(ndtri(SURE)) * AT_REST_SD
)  # of noise at low speed over that at speed, with that probability
SLIDING, ELASTIC = 0.9, 0.6  # of the largest force of the law alone: above it slides, below it is elastic
LEAST = 0.05  # of the sliding time, beyond what is as loud by chance: less is no chatter
QUIET = 0.25  # of the sliding time, in which the scatter is least: that of noise where something chatters
FEWEST_STROKES = 2  # that chatter: what happens once says nothing of the next stroke

STATEMENT = (
    "While it slides the force scatters by up to {size:.0%} of Fy to either side of the model, in {share:.0%} of that "
    "time: it sticks and jumps. The model gives the mean; the largest force is that much higher."
)
EQUATION = "|F - model| < a Fy while it slides"
SHOWS = "Scatter from reading to reading that comes and goes on the plateaus, and none on the elastic branches."


@dataclass(frozen=True, eq=False)
class Chatter:
    """Scatter of the force that the sliding makes."""

    size: float  # 99th percentile of its distance from its local mean while sliding, as a share of Fy
    share: float  # of the sliding time in which it is larger than noise
    of_strokes: FloatArray  # shape (n,): largest distance in each stroke that chatters, as a share of Fy
    apart: float  # largest less smallest of these over all strokes that slide, 0 for those that do not chatter
    lowers: float  # direction that it lowers the mean force of, 1 push, -1 pull: that of the larger distances


def chatter_of(data: BinnedData, state: Laplace, most_kN: float) -> Chatter | None:
    """Look for chatter beside a model; None where the scatter is no larger than that of noise.

    The noise of a load cell has a standard deviation of `most_kN` at most.
    """
    fine = data.finer_at(state.model, state.z, longest_s=0.0)
    residual, _ = fine.likelihood.at(state.model).residual_and_slope(state.z[None])
    alone = fine.likelihood.residual(state.of_law(fine.device)[None])
    loaded = np.abs(fine.blocks.force_kN - alone) * fine.blocks.used
    rows = np.concatenate([residual, loaded / loaded.max()])
    longest = AVERAGED_S / data.timings[0].step_s
    found = None
    for together in (2**i for i in range(1 + max(0, int(math.log2(longest))))):
        one = _at_scale(list(_half_cycles(fine, rows, together)), data.scale_kN, most_kN)
        if one is not None and (found is None or one.share > found.share):
            found = one
    return found


@cache
def _of_white_noise() -> FloatArray:
    """Local scatter, as `_at_scale` takes it, of white noise of variance 1, shape (n,): few readings differ much."""
    bends = np.diff(np.random.default_rng(1).standard_normal(100_000), 2)
    return np.asarray(median_filter(-bends[1:] * bends[:-1], TOGETHER))


def _half_cycles(fine: BinnedData, rows: FloatArray, together: int) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """Rows (residual, kN; load, 0 to 1) of each half-cycle in means of so many readings, and its direction, 1 or -1."""
    first = 0
    for part in fine.blocks:
        halves = zip(part.timing.half[:-1], part.timing.half[1:], part.history.motion.direction, strict=True)
        for a, b, direction in halves:
            own = rows[:, first + a : first + b][:, part.count[a:b] > 0]
            n = own.shape[1] // together
            if n > TOGETHER + 3:
                means = own[:, : n * together].reshape(2, n, together).mean(axis=2)
                yield means[0], means[1], float(direction)
        first += part.n


def _at_scale(
    half_cycles: list[tuple[FloatArray, FloatArray, float]], scale_kN: float, most_kN: float
) -> Chatter | None:
    """Compare the scatter while sliding with that on the elastic branches; None where there is no chatter."""
    products, sliding, elastic, local, away, stroke = [], [], [], [], [], []
    for i, (residual, load, _) in enumerate(half_cycles):
        bends = np.diff(residual, 2)
        product = -bends[1:] * bends[:-1]
        products.append(product)
        local.append(median_filter(product, TOGETHER))
        sliding.append(load[1:-2] > SLIDING)
        elastic.append(load[1:-2] < ELASTIC)
        away.append(np.abs(residual - uniform_filter1d(residual, TOGETHER))[1:-2])
        stroke.append(np.full(product.size, i))
    if not products:
        return None
    slides, rests = np.concatenate(sliding), np.concatenate(elastic)
    if slides.sum() < TOGETHER or rests.sum() < TOGETHER:
        return None
    quiet = max(float(np.mean(np.concatenate(products)[rests])), 0.0) / MEAN
    scatter, most = np.concatenate(local)[slides], max(most_kN**2, MOST_AT_REST**2 * quiet)
    least, of_unit = ALTERNATE * most, _of_white_noise()
    loud = scatter > least
    # What is as loud by chance where the noise is as large throughout; chatter may take up most of the time.
    even = of_unit * min(float(np.quantile(scatter, QUIET) / np.quantile(of_unit, QUIET)), most)
    levels = (least, max(least, float(np.quantile(even, 1.0 - LEAST))))
    if max(np.mean(scatter > level) - np.mean(even > level) for level in levels) < LEAST:
        return None
    distance, of = np.concatenate(away)[slides] / scale_kN, np.concatenate(stroke)[slides]
    largest = np.zeros(len(half_cycles))
    np.maximum.at(largest, of[loud], distance[loud])
    if np.count_nonzero(largest) < FEWEST_STROKES:
        return None
    size, apart = float(np.percentile(distance, 99)), float(np.ptp(largest[np.unique(of)]))
    direction = np.array([one for _, _, one in half_cycles])
    lowers = 1.0 if float(np.average(direction, weights=largest)) > 0.0 else -1.0
    return Chatter(size, float(loud.mean()), largest[largest > 0.0], apart, lowers)
