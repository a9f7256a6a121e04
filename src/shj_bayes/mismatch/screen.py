"""Which classes a residual speaks for, to first order: the log Bayes factor of each, all in one sweep."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from shj_bayes.mismatch.classes import Candidate, size_weights, sized
from shj_bayes.mismatch.scene import Metric, beside
from shj_bayes.mismatch.state import State
from shj_bayes.model.curve import SIZES
from shj_bayes.model.parameters import FloatArray

SIZES_OF_STARTS = np.array([0.25, 0.5, 1.0, 2.0, 4.0])  # of an effect at the values that a search starts from


def screen(metric: Metric, state: State, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Give candidates, as from `classes.candidates`, their gain, best first, with curves of the size that fits."""
    wide = state.beside(*(c.columns for c in candidates))
    along, inner = beside(metric.products(wide), state.z.size)
    out, first = [], 0
    for c in candidates:
        own = slice(first, first + c.columns.shape[1])
        first = own.stop
        out.append(_gained(c, inner[own, own], along[own]))
    return sorted(out, key=lambda c: -c.gain)


def log_gain(inner: FloatArray, along: FloatArray, sizes: FloatArray, weights: FloatArray) -> FloatArray:
    """Log Bayes factor of columns with normal coefficients, shape (..., m) for m standard deviations of these.

    `inner` and `along`, shapes (..., p, p) and (..., p), are the products of the columns with one another and with the
    data, as from `scene.beside`; the average over the sizes, with their probabilities as `weights`, is the `logsumexp`.
    """
    values, vectors = np.linalg.eigh(inner)
    values = np.maximum(values, 0.0)[..., None, :]
    squares = np.einsum("...ij,...i->...j", vectors, along)[..., None, :] ** 2
    v = sizes[:, None] ** 2
    gains = 0.5 * np.sum(v * squares / (1.0 + v * values) - np.log1p(v * values), axis=-1)
    return np.asarray(gains + np.log(weights))


def _gained(c: Candidate, inner: FloatArray, along: FloatArray) -> Candidate:
    """Candidate with its gain, averaged over its size before the test."""
    curve = c.variant.curve
    sizes = SIZES_OF_STARTS if curve is None else np.array(SIZES) / curve.size
    weights = np.full(sizes.size, 1.0 / sizes.size) if curve is None else size_weights()
    parts = log_gain(inner, along, sizes, weights)
    gain = float(logsumexp(parts) + np.log(c.variant.weight))
    best = float(sizes[np.argmax(parts)]) ** 2
    mean = np.linalg.solve(np.eye(along.size) / best + inner, along)
    c = replace(c, change=c.columns @ mean)
    if curve is None:
        return replace(c, gain=gain)
    curve = sized(curve, curve.size * float(sizes[np.argmax(parts)]))
    effect = curve.effect()
    model = c.model.with_effects((*c.model.effects[:-1], effect))
    return replace(c, gain=gain, model=model, variant=replace(c.variant, curve=curve, effect=effect))
