"""What comes again after a fixed time or distance: the periods that a residual speaks for.

A period has a narrow basin, so all of them are looked at in one sweep, to first order: a wave of each frequency beside
the model, as in a periodogram, but held against the noise, the discrepancy and everything the model can follow.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from shj_bayes.inference.gaussian import Gaussian, log_gains
from shj_bayes.mismatch.classes import FORMS, Candidate, Class, Variant, candidates, size_weights
from shj_bayes.mismatch.cycles import by_stroke, is_clock, keep_step
from shj_bayes.mismatch.scene import Metric, Scene
from shj_bayes.mismatch.screen import screen
from shj_bayes.mismatch.state import State, settle_under
from shj_bayes.model.coordinates import Coordinate, coordinates
from shj_bayes.model.curve import PERIODS_PER_UNIT, SIZES, Curve
from shj_bayes.model.parameters import FloatArray

LENGTH = 0.15  # correlation length of a curve that comes again, as a share of its period
PER_TURN = 2.5  # blocks to a period at least, for it to be seen at all
MOST_TURNS = 200.0  # in all tests: what is faster counts as noise
AT_ONCE = 128  # frequencies


def waves(scene: Scene, metric: Metric, state: State, of: Class, most: int = 2) -> list[Candidate]:
    """Find at most so many periods after which a curve of a class may come again, beside a model.

    An empty list where curves over the coordinate do not come again: `Coordinate.repeats` says how likely that is.
    """
    over = _repeating(of)
    if over is None:
        return []
    slowest, fastest = _limits(scene, over)
    spacing = slowest / 4.0
    frequencies = np.arange(slowest, fastest, spacing)
    if is_clock(over):
        places = [over.values(part.history, scene.base)[:, None] for part in scene.posterior.averages]
        turns = [np.exp(2j * np.pi * frequencies * place) for place in by_stroke(scene, places)]
        frequencies = frequencies[~keep_step(turns)]
    if frequencies.size < 3:
        return []
    response = _response(scene, state, of.action)
    if (of.action, over.id) not in scene.waves:  # what more capacity gives differs little from model to model
        scene.waves[of.action, over.id] = _columns(scene, over, response, frequencies)
    gains = _gains(metric, state, scene.waves[of.action, over.id])
    peaks = np.flatnonzero((gains >= np.append(gains[1:], -np.inf)) & (gains >= np.append(-np.inf, gains[:-1])))
    weight = (1.0 - FORMS) * over.repeats / frequencies.size
    out = []
    for peak in peaks[np.argsort(-gains[peaks], kind="stable")][:most]:
        near = frequencies[peak] + spacing * np.linspace(-0.75, 0.75, 13)
        best = near[np.argmax(_gains(metric, state, _columns(scene, over, response, near)))]
        period = round(PERIODS_PER_UNIT / best) / PERIODS_PER_UNIT
        curve = Curve(of.action, over.id, LENGTH, period=period)
        variant = Variant(curve, curve.effect(), weight)
        out += [replace(c, of=of) for c in candidates(scene, state, (replace(of, variants=(variant,)),))]
    return out


def resolved(scene: Scene, metric: Metric, state: State, of: Sequence[Class]) -> Scene:
    """Give the recordings in blocks that show what comes again: finer ones where its period is too short for these.

    The state is that of the base law.
    """
    short = [one for one in of if (over := _repeating(one)) is not None and not _enough(scene, over)]
    if not short:
        return scene
    fine = scene.finer
    own, base = settle_under(fine, metric.setting, state.model, state.z)
    for one in short:
        best = max(screen(own, base, waves(fine, own, base, one, 1)), key=lambda c: c.gain, default=None)
        if best is None or best.gain < 0.0:
            continue
        curve = best.variant.curve
        if curve is not None and curve.period is not None and curve.period * _limits(scene, curve.over)[1] < 1.0:
            return fine
    return scene


def _repeating(of: Class) -> Coordinate | None:
    """Coordinate of a class whose curves may come again."""
    over = coordinates().get(of.coordinate)
    return over if over is not None and over.repeats and any(v.curve for v in of.variants) else None


def _limits(scene: Scene, over: Coordinate) -> tuple[float, float]:
    """Lowest and highest frequency that is looked at over a coordinate, in turns to its unit."""
    values = [over.values(part.history, scene.base) for part in scene.posterior.averages]
    place = scene.blocks([v[:, None] for v in values])[:, 0]
    block = float(np.quantile(np.abs(np.diff(place[scene.used > 0])), 0.9))  # all but the longest tenth
    low, high = over.reach(scene.posterior.averages[0].history)
    return 2.0 / (high - low), min(1.0 / (PER_TURN * block), MOST_TURNS / (high - low))


def _enough(scene: Scene, over: Coordinate) -> bool:
    """Whether the blocks show all that is looked for over a coordinate."""
    slowest, fastest = _limits(scene, over)
    return fastest >= MOST_TURNS / 2.0 * slowest


def _response(scene: Scene, state: State, action: str) -> list[FloatArray]:
    """Force at the points of each run by a curve of height 1: Fy where it is added, what more capacity gives else."""
    histories = [part.history for part in scene.posterior.averages]
    if action == "added":
        return [np.full(h.position_mm.size, scene.scale_kN) for h in histories]
    step = 1e-3
    at = list(state.model.law_names).index("Fy")
    z = state.z + step * np.eye(state.z.size)[at][None]
    theta = state.model.natural_of_law(np.vstack([state.z, z]))
    rise = float(theta[1, at] / theta[0, at] - 1.0)
    forces = [state.model.force(theta, p.history, p.start_force_kN) for p in scene.posterior.averages]
    return [np.asarray((f[1] - f[0]) / rise) for f in forces]


def _columns(scene: Scene, over: Coordinate, response: list[FloatArray], frequencies: FloatArray) -> FloatArray:
    """Force of each block by a cosine and a sine of each frequency, shape (n, n_frequencies, 2), kN."""
    places = [over.values(part.history, scene.base) for part in scene.posterior.averages]
    parts = []
    for some in np.array_split(frequencies, -(-frequencies.size // AT_ONCE)):
        angles = [2.0 * np.pi * place[:, None] * some for place in places]
        points = [np.concatenate([np.cos(a), np.sin(a)], axis=1) for a in angles]
        blocks = scene.blocks([p * r[:, None] for p, r in zip(points, response, strict=True)])
        parts.append(np.stack(np.split(blocks, 2, axis=1), axis=2))
    return np.concatenate(parts, axis=1)


def _gains(metric: Metric, state: State, columns: FloatArray) -> FloatArray:
    """Log Bayes factor of a plain wave of each frequency, to first order, shape (n_frequencies,)."""
    beside, beside_taken = metric.factors(state.beside())
    k = columns.shape[1]
    wave, taken = metric.factors(columns.reshape(columns.shape[0], 2 * k))
    own = beside.T @ beside - beside_taken.T @ beside_taken
    along, cross = np.split(beside.T @ wave - beside_taken.T @ taken, [1])
    law = Gaussian.of(own)
    solved = law.solve(cross)
    along = (along[0] - law.along @ solved).reshape(k, 2)
    inner = _of_each(wave, wave) - _of_each(taken, taken) - _of_each(cross, solved)
    return np.asarray(logsumexp(log_gains(inner, along, np.array(SIZES)) + np.log(size_weights()), axis=-1))


def _of_each(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of the cosine and the sine of each frequency in `a` with those in `b`, shape (m, 2 k) to (k, 2, 2)."""
    pairs = [np.einsum("mk,mk->k", a[:, i::2], b[:, j::2]) for i in (0, 1) for j in (0, 1)]
    return np.stack(pairs, axis=-1).reshape(-1, 2, 2)
