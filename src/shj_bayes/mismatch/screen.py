"""What a residual speaks for to first order, and what the formulas of an answer may miss."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.gaussian import Gaussian, log_gains
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.hypothesis import (
    EXPLAINED,
    LOG_PRIOR_ODDS,
    Candidate,
    Dependence,
    candidates,
    size_weights,
    sized,
    unit_columns,
)
from shj_bayes.mismatch.laplace import Laplace
from shj_bayes.model.curve import SIZES, Curve

SIZES_OF_STARTS = np.array([0.25, 0.5, 1.0, 2.0, 4.0])  # of an effect at the values that a search starts from


def screen(metric: ErrorModel, state: Laplace, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Give candidates, as from `classes.candidates`, their gain, best first, with curves of the size that fits."""
    if not candidates:
        return []
    columns, taken = metric.factors_of({c: c.columns for c in candidates})
    along, cross, solved = beside_law(metric, state, columns, taken)
    out, first = [], 0
    for c in candidates:
        own = slice(first, first + c.columns.shape[1])
        first = own.stop
        inner = columns[:, own].T @ columns[:, own] - taken[:, own].T @ taken[:, own] - cross[:, own].T @ solved[:, own]
        out.append(_gained(c, Gaussian(0.0, along[own], inner)))
    return sorted(out, key=lambda c: -c.gain)


def beside_law(
    metric: ErrorModel, state: Laplace, columns: FloatArray, taken: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Give what a state leaves of the data to columns, which are given by their factors under a metric.

    Products with the data, shape (p,), once the parameters are integrated out; products with the derivatives, and
    these solved by the precision of the parameters, shape (n_law, p): their product is what the former take up.
    """
    beside, beside_taken = metric.factors(state.beside())
    law = Gaussian.of(beside.T @ beside - beside_taken.T @ beside_taken)
    along, cross = np.split(beside.T @ columns - beside_taken.T @ taken, [1])
    solved = law.solve(cross)
    return np.asarray(along[0] - law.along @ solved), cross, solved


def _gained(c: Candidate, own: Gaussian) -> Candidate:
    """Candidate with its gain, averaged over its size before the test."""
    curve = c.variant.curve
    sizes = SIZES_OF_STARTS if curve is None else np.array(SIZES) / curve.size
    weights = np.full(sizes.size, 1.0 / sizes.size) if curve is None else size_weights()
    parts = log_gains(own.inner, own.along, sizes) + np.log(weights)
    gain = float(np.logaddexp.reduce(parts) + np.log(c.variant.weight))
    best = float(sizes[np.argmax(parts)])
    c = replace(c, change=c.columns @ (best * own.sized(best).mean))
    if curve is None:
        return replace(c, gain=gain)
    curve = sized(curve, curve.size * best)
    effect = curve.effect()
    model = c.model.with_effects((*c.model.effects[:-1], effect))
    return replace(c, gain=gain, model=model, variant=replace(c.variant, curve=curve, effect=effect))


def curves_of(data: BinnedData, state: Laplace, of: Dependence) -> FloatArray | None:
    """Give the curves of a class, kN by unit of normal coefficients, shape (n, p); None where it has none.

    To first order, with the standard deviation of `Curve.size`. A class may have several: heat decays sooner or later.
    What acts on the motion has none.
    """
    curves = [v for v in of.variants if v.curve is not None and not v.curve.sides]
    if not curves:
        return None
    likely = {v.curve.coordinate: v for v in sorted(curves, key=lambda v: v.weight) if v.curve is not None}
    one = replace(of, variants=tuple(likely.values()))
    return np.column_stack([c.columns for c in candidates(data, state, (one,))])


def missed_by(data: BinnedData, state: Laplace, of: Dependence, size: float) -> FloatArray | None:
    """Give what a form of a size, a share of Fy, may miss over the coordinate of a class: curves as of `curves_of`.

    With a standard deviation of 1 - `EXPLAINED` of the size.
    """
    curves = curves_of(data, state, of)
    return None if curves is None else curves * ((1.0 - EXPLAINED) * size / Curve.size)


def beside_missed(
    metric: ErrorModel,
    state: Laplace,
    found: Sequence[tuple[Candidate, float]],
    others: Sequence[Dependence] = (),
) -> Laplace:
    """Give a state with a covariance that counts what its formulas may miss, and the classes that it does not hold.

    A formula may miss a curve, `missed_by`: `found` holds the classes of the model with their sizes, as shares of Fy.
    Each of the `others` counts with its probability: one that is too small to matter for the force may still move the
    parameters by more than noise does. All to first order. The parameters stay as they are; how far they would move is
    uncertainty.
    """
    covariance = state.covariance.copy()
    missed = [
        curves
        for member, size in found
        if member.variant.curve is None and (curves := missed_by(metric.data, state, member.of, size)) is not None
    ]
    if missed:
        covariance = _spread(metric, state, *missed)
    best: dict[str, Candidate] = {}
    for c in screen(metric, state, candidates(metric.data, state, tuple(others))):
        best.setdefault(c.of.id, c)
    for c in best.values():
        column = c.change[:, None] if c.variant.curve is None else unit_columns(c)
        covariance += expit(c.gain + LOG_PRIOR_ODDS) * (_spread(metric, state, column) - state.covariance)
    return replace(state, covariance=covariance)


def _spread(metric: ErrorModel, state: Laplace, *columns: FloatArray) -> FloatArray:
    """Covariance of the parameters beside further columns, with the square of how far they move from where they are."""
    d = state.z.size
    wide = metric.gaussian(state.beside(*columns))
    moved = wide.mean[:d] - state.z
    return np.asarray(wide.covariance[:d, :d] + np.outer(moved, moved))
