"""Which classes a residual speaks for, to first order: the log Bayes factor of each, all in one sweep."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from shj_bayes.inference.gaussian import Gaussian, log_gains
from shj_bayes.mismatch.classes import Candidate, size_weights, sized
from shj_bayes.mismatch.scene import ErrorModel
from shj_bayes.mismatch.state import Laplace
from shj_bayes.model.curve import SIZES

SIZES_OF_STARTS = np.array([0.25, 0.5, 1.0, 2.0, 4.0])  # of an effect at the values that a search starts from


def screen(metric: ErrorModel, state: Laplace, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Give candidates, as from `classes.candidates`, their gain, best first, with curves of the size that fits."""
    wide = state.beside(*(c.columns for c in candidates))
    rest = metric.gaussian(wide).given(state.z.size)
    out, first = [], 0
    for c in candidates:
        own = slice(first, first + c.columns.shape[1])
        first = own.stop
        out.append(_gained(c, rest.some(own)))
    return sorted(out, key=lambda c: -c.gain)


def _gained(c: Candidate, own: Gaussian) -> Candidate:
    """Candidate with its gain, averaged over its size before the test."""
    curve = c.variant.curve
    sizes = SIZES_OF_STARTS if curve is None else np.array(SIZES) / curve.size
    weights = np.full(sizes.size, 1.0 / sizes.size) if curve is None else size_weights()
    parts = log_gains(own.inner, own.along, sizes) + np.log(weights)
    gain = float(logsumexp(parts) + np.log(c.variant.weight))
    best = float(sizes[np.argmax(parts)])
    c = replace(c, change=c.columns @ (best * own.sized(best).mean))
    if curve is None:
        return replace(c, gain=gain)
    curve = sized(curve, curve.size * best)
    effect = curve.effect()
    model = c.model.with_effects((*c.model.effects[:-1], effect))
    return replace(c, gain=gain, model=model, variant=replace(c.variant, curve=curve, effect=effect))
