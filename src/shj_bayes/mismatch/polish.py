"""The numbers of a formula: fitted to a profile, and left out one after another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from shj_bayes.mismatch.expression import LIMIT, NARROWEST, Factor, Sum, Term, free_numbers, shape, tidy
from shj_bayes.model.parameters import FloatArray


def polish(terms: Sum, x: FloatArray, y: FloatArray, weight: FloatArray, *, slopes: bool = True) -> tuple[Sum, float]:
    """Fit all numbers of a sum by weighted least squares.

    The sizes are linear and solved for; slopes and shifts are descended to (variable projection).

    Parameters
    ----------
    terms : Sum
        Where to start.
    x, y, weight : array, shape (n,)
        Profile: coordinate, residual, number of samples.
    slopes : bool
        False keeps the slopes as they are.

    Returns
    -------
    Sum, float
        The fitted sum and its weighted sum of squared errors.
    """
    root = np.sqrt(weight)
    names = [n for t in terms for f in t.factors for n in free_numbers(f)]
    free = np.array([slopes or n == "shift" for n in names], dtype=np.bool_)
    start = np.array([getattr(f, n) for t in terms for f in t.factors for n in free_numbers(f)], dtype=np.float64)

    def solved(values: FloatArray) -> tuple[Sum, FloatArray]:
        inner = start.copy()
        inner[free] = values
        moved = _with_inner(terms, inner)
        columns = np.stack([shape(t, x) for t in moved], axis=1) * root[:, None]
        sizes = np.linalg.lstsq(columns, y * root, rcond=1e-9)[0]
        fitted = tuple(replace(t, size=float(s)) for t, s in zip(moved, sizes, strict=True))
        return fitted, np.asarray(y * root - columns @ sizes)

    values = start[free]
    if values.size:
        limits = [LIMIT.get(f.name, NARROWEST) for t in terms for f in t.factors for _ in free_numbers(f)]
        high = np.array(limits)[free] * np.where(np.array(names)[free] == "slope", 1.0, 2.0)
        begin = np.clip(values, -0.999 * high, 0.999 * high)

        def miss(inner: FloatArray) -> FloatArray:
            return solved(inner)[1]

        values = least_squares(miss, begin, bounds=(-high, high), x_scale="jac", max_nfev=60).x
    fitted, error = solved(values)
    return fitted, float(error @ error)


def _with_inner(terms: Sum, values: FloatArray) -> Sum:
    """Put slopes and shifts back; a free shift stays one, even when it is 0."""
    rest = iter(values.tolist())
    out = []
    for term in terms:
        factors = []
        for f in term.factors:
            slope = next(rest) if "slope" in free_numbers(f) else f.slope
            shift = (next(rest) or 1e-12) if "shift" in free_numbers(f) else 0.0
            factors.append(Factor(f.name, slope, shift))
        out.append(replace(term, factors=tuple(factors)))
    return tuple(out)


def freed(terms: Sum) -> Sum:
    """Give every sum the numbers that it may want: a constant, and a shift in every function but exp."""
    loose = tuple(
        replace(t, factors=tuple(replace(f, shift=f.shift or 1e-3) if f.name != "exp" else f for f in t.factors))
        for t in terms
    )
    return tidy((*loose, Term(1e-12))) if all(t.key != (0, ()) for t in loose) else tidy(loose)


def shortened(terms: Sum, x: FloatArray, y: FloatArray, weight: FloatArray) -> list[tuple[Sum, float]]:
    """Polish a sum, then drop one number after another, the least needed first.

    Returns
    -------
    list of (Sum, float)
        From the whole sum to a single term, each polished, with its weighted sum of squared errors.
    """
    current = polish(terms, x, y, weight)
    out = [current]
    while len(smaller := _without_one(current[0])) > 0:
        current = min((polish(s, x, y, weight) for s in smaller), key=lambda found: found[1])
        out.append(current)
    return out


def _without_one(terms: Sum) -> list[Sum]:
    """All sums with one number less: a term, or a shift."""
    out = [terms[:i] + terms[i + 1 :] for i in range(len(terms)) if len(terms) > 1]
    for i, term in enumerate(terms):
        for j, factor in enumerate(term.factors):
            if factor.shift != 0.0:
                less = (*term.factors[:j], replace(factor, shift=0.0), *term.factors[j + 1 :])
                out.append((*terms[:i], replace(term, factors=less), *terms[i + 1 :]))
    return out
