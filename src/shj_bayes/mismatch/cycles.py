"""What keeps step with the cycles of a test: over time it does what position, direction and speed do.

Nothing outside a device follows the strokes, so what is the same in each cycle is none of its dependence on time.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shj_bayes.mismatch.classes import Class
from shj_bayes.mismatch.scene import Scene
from shj_bayes.model.coordinates import Coordinate, coordinates_of
from shj_bayes.model.effects.effect import Effect, Values
from shj_bayes.model.parameters import FloatArray

PER_STROKE = 8  # places at which a stroke is looked at


def is_clock(over: Coordinate) -> bool:
    """Whether a coordinate goes on from stroke to stroke and has curves that come again: it is a clock."""
    return over.goes == "test" and over.repeats > 0.0


def is_over_a_clock(of: Class) -> bool:
    """Whether a class is a dependence on time."""
    return any(is_clock(over) for over in coordinates_of(of.coordinate))


def of_whole_cycles(scene: Scene, of: Class) -> Class:
    """Give a class over a clock without the curves that change within a cycle, as position and direction do.

    The smoothest curves stay, and have the probability of those that are left out. The class itself where nothing is.
    """
    if not is_over_a_clock(of):
        return of
    histories = [part.history for part in scene.posterior.averages]
    moved_s = sum(float(h.time_s[-1] - h.time_s[0]) for h in histories)
    cycle = 2.0 * moved_s / sum(h.motion.n_half for h in histories) / histories[-1].tested_s
    if all(v.curve is None or v.curve.length >= cycle for v in of.variants):
        return of
    kept = tuple(v for v in of.variants if v.curve is None)
    for sides in sorted({v.curve.sides for v in of.variants if v.curve}):
        own = [v for v in of.variants if v.curve is not None and v.curve.sides == sides]
        slow = [v for v in own if v.curve and v.curve.length >= cycle] or own[-1:]
        more = sum(v.weight for v in own) / sum(v.weight for v in slow)
        kept += tuple(replace(v, weight=v.weight * more) for v in slow)
    return replace(of, variants=kept)


def follows_cycles(scene: Scene, effect: Effect, values: Values) -> bool:
    """Whether what an effect does keeps step with the cycles."""
    columns = []
    for part in scene.posterior.averages:
        does = effect.act(part.history, values, scene.base)
        share = np.broadcast_to(does.clamping + does.added_kN / scene.scale_kN, part.history.time_s.shape)
        columns.append(share[:, None])
    return bool(keep_step(by_stroke(scene, columns), sides="side" in values)[0])


def by_stroke(scene: Scene, columns: Sequence[FloatArray]) -> list[FloatArray]:
    """Functions at `PER_STROKE` places of each push and of each pull, shapes (strokes, places, p).

    They are given at the points of each run, shapes (n_points, p).
    """
    at = (np.arange(PER_STROKE) + 0.5) / PER_STROKE
    strokes: dict[float, list[FloatArray]] = {1.0: [], -1.0: []}
    for part, column in zip(scene.posterior.averages, columns, strict=True):
        motion = part.history.motion
        for k, direction in enumerate(motion.direction):
            begin, end = motion.start[k], motion.start[k + 1]
            strokes[float(direction)].append(column[np.minimum((begin + at * (end - begin)).astype(int), end - 1)])
    return [np.array(own).reshape(len(own), PER_STROKE, columns[0].shape[1]) for own in strokes.values()]


def keep_step(strokes: Sequence[NDArray[Any]], *, sides: bool = False) -> NDArray[np.bool_]:
    """Whether most of each function, more than half its variance, is the same in each cycle, shape (p,).

    Of functions, which may be complex, as from `by_stroke`; with `sides` their variance is that about their means in
    push and in pull. A constant keeps step; nothing does where a test has no second cycle.
    """
    if min(len(own) for own in strokes) < 2:
        return np.zeros(strokes[0].shape[2], dtype=bool)
    if sides:
        strokes = [own - own.mean(axis=(0, 1)) for own in strokes]
    same = np.var(np.concatenate([own.mean(axis=0) for own in strokes]), axis=0)
    apart = np.mean([np.var(own, axis=0).mean(axis=0) for own in strokes], axis=0)
    return np.asarray((same > apart) | (same + apart == 0.0))
