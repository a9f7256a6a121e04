"""Chatter of surfaces that stick and slip: seen in the scatter from reading to reading, not in the mean of the force.

Teeth shorter than a block average out of all that a search compares, and no formula of the motion follows them: each
stroke begins them anew. What is looked for is a scatter that is larger than the noise of a load cell while the
connection slides, and much larger than on the elastic branches, where nothing slips.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.special import ndtri

from shj_bayes.mismatch.scene import AVERAGED_S, Scene
from shj_bayes.mismatch.state import State
from shj_bayes.model.noise.low_speed import ROUGHER
from shj_bayes.model.parameters import FloatArray

TOGETHER = 8  # readings in a row that must scatter: a jump of the force is none
# Median product of neighbouring second differences of white noise of variance 1, its sign turned; its mean is 4, which
# also holds for readings in steps. That of teeth is larger yet, that of what a model misses negative.
ALTERNATE, MEAN = 1.482, 4.0
SURE = 0.99  # probability with which what is called chatter is no noise
ROUGHEST = math.exp(float(ndtri(SURE)) * ROUGHER)  # of noise at low speed over that at speed, with that probability
SLIDING, ELASTIC = 0.9, 0.6  # of the largest force of the law alone: above it slides, below it is elastic
LEAST = 0.05  # of the sliding time: less is no chatter
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
    # direction that it lowers the mean force of, 1 push, -1 pull: the one with the larger distances in the mean
    lowers: float


def chatter_of(scene: Scene, state: State, most_kN: float) -> Chatter | None:
    """Look for chatter beside a model; None where the scatter is no larger than that of noise.

    The noise of a load cell has a standard deviation of `most_kN` at most.
    """
    fine = scene.finer_at(state.model, state.z, longest_s=0.0)
    residual, _ = fine.residual_and_slope(state.model, state.z[None])
    loaded = np.abs(fine.force(fine.device, state.of_law(fine.device)[None]))
    rows = np.concatenate([residual, loaded / loaded.max()])
    longest = AVERAGED_S / scene.step_s
    found = None
    for together in (2**i for i in range(1 + max(0, int(math.log2(longest))))):
        one = _at_scale(list(_half_cycles(fine, rows, together)), scene.scale_kN, most_kN)
        if one is not None and one.share > max(LEAST, found.share if found else 0.0):
            found = one
    return found


def _half_cycles(fine: Scene, rows: FloatArray, together: int) -> Iterator[tuple[FloatArray, FloatArray, float]]:
    """Residual of each half-cycle, kN, and how far the law alone is loaded, 0 to 1, in means of so many readings.

    And its direction, 1 or -1.
    """
    first = 0
    for part in fine.posterior.averages:
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
    loud = np.concatenate(local)[slides] > ALTERNATE * max(most_kN**2, ROUGHEST**2 * quiet)
    distance, of = np.concatenate(away)[slides] / scale_kN, np.concatenate(stroke)[slides]
    largest = np.zeros(len(half_cycles))
    np.maximum.at(largest, of[loud], distance[loud])
    if np.count_nonzero(largest) < FEWEST_STROKES:
        return None
    size, apart = float(np.percentile(distance, 99)), float(np.ptp(largest[np.unique(of)]))
    direction = np.array([one for _, _, one in half_cycles])
    lowers = 1.0 if float(np.average(direction, weights=largest)) > 0.0 else -1.0
    return Chatter(size, float(loud.mean()), largest[largest > 0.0], apart, lowers)
