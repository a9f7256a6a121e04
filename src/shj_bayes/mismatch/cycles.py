"""What keeps step with the cycles of a test: over time it does what position, direction and speed do.

Nothing outside a device follows the strokes, so what is the same in each cycle is none of its dependence on time.
"""

from collections.abc import Sequence

import numpy as np

from shj_bayes.mismatch.scene import Scene
from shj_bayes.model.coordinates import Coordinate
from shj_bayes.model.effects.effect import Effect, Values
from shj_bayes.model.parameters import FloatArray

PER_STROKE = 8  # places at which a stroke is looked at


def is_clock(over: Coordinate) -> bool:
    """Whether a coordinate goes on from stroke to stroke and has curves that come again: it is a clock."""
    return over.goes == "test" and over.repeats > 0.0


def follows_cycles(scene: Scene, effect: Effect, values: Values, *, sides: bool) -> bool:
    """Whether most of what an effect does (more than half its variance) is the same in each cycle.

    With `sides` for one that has a curve for push and one for pull: about its mean in each.
    """
    columns = []
    for part in scene.posterior.averages:
        does = effect.act(part.history, values, scene.base)
        share = np.broadcast_to(does.clamping + does.added_kN / scene.scale_kN, part.history.time_s.shape)
        columns.append(share[:, None])
    return bool(share_in_step(scene, columns, sides=sides)[0] > 0.5)


def share_in_step(scene: Scene, columns: Sequence[FloatArray], *, sides: bool = False) -> FloatArray:
    """Share of the variance of functions that is the same in each cycle, shape (p,).

    The functions, which may be complex, are given at the points of each run, shapes (n_points, p); with `sides` their
    variance is that about their means in push and in pull. 1 where there is none, 0 where a test has no second cycle.
    """
    at = (np.arange(PER_STROKE) + 0.5) / PER_STROKE
    phases: dict[float, list[FloatArray]] = {1.0: [], -1.0: []}
    for part, column in zip(scene.posterior.averages, columns, strict=True):
        motion = part.history.motion
        for k, direction in enumerate(motion.direction):
            begin, end = motion.start[k], motion.start[k + 1]
            phases[float(direction)].append(column[np.minimum((begin + at * (end - begin)).astype(int), end - 1)])
    if min(len(strokes) for strokes in phases.values()) < 2:
        return np.zeros(columns[0].shape[1])
    # shape (strokes, places, p) each; a place has a mean over the strokes of its direction
    whole = [np.array(strokes) for strokes in phases.values()]
    if sides:
        whole = [one - one.mean(axis=(0, 1)) for one in whole]
    means = np.concatenate([one.mean(axis=0) for one in whole])
    total = sum(np.var(one, axis=0).mean(axis=0) for one in whole) / len(whole) + np.var(means, axis=0)
    return np.asarray(np.divide(np.var(means, axis=0), total, out=np.ones(total.shape), where=total > 0.0))
