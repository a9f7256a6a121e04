"""The Gaussian that a linearised model leaves behind: evidence, posterior and what further columns would gain.

Everything to first order is one linear model: whitened data ``y = A u + e`` with standard normal coefficients `u` and
standard normal errors `e`. Only the products of `y` and the columns of `A` matter. A coefficient of another size is a
column in proportion; one that is integrated out leaves the products of the others beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from shj_bayes._util.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class Gaussian:
    """Products of data and columns whose coefficients have standard normal priors.

    Attributes
    ----------
    square : float
        ``y @ y``.
    along : array, shape (p,)
        ``A.T @ y``.
    inner : array, shape (p, p)
        ``A.T @ A``, the Gram matrix.
    constant : float
        Log density of data that are all 0 and owe nothing to the columns.
    """

    square: float
    along: FloatArray
    inner: FloatArray
    constant: float = 0.0

    @classmethod
    def of(cls, products: FloatArray, constant: float = 0.0) -> Gaussian:
        """From the products of the data and the columns side by side, shape (1 + p, 1 + p)."""
        return cls(float(products[0, 0]), products[0, 1:], products[1:, 1:], constant)

    @cached_property
    def precision(self) -> FloatArray:
        """Inverse of the covariance of the coefficients, shape (p, p)."""
        return np.eye(self.along.size) + self.inner

    @cached_property
    def root(self) -> FloatArray:
        """Cholesky factor of the precision in the lower triangle, shape (p, p); the other one holds anything."""
        return np.asarray(cho_factor(self.precision, lower=True, check_finite=False)[0])

    def solve(self, columns: FloatArray) -> FloatArray:
        """Give ``covariance @ columns``; `numpy.linalg.LinAlgError` where rounding leaves no positive precision."""
        return np.asarray(cho_solve((self.root, True), columns, check_finite=False), dtype=np.float64)

    def whitened(self, columns: FloatArray) -> FloatArray:
        """Give columns whose products with one another are those of `columns` in the covariance."""
        return np.asarray(solve_triangular(self.root, columns, lower=True, check_finite=False), dtype=np.float64)

    @cached_property
    def half_log_det(self) -> float:
        """Half the log determinant of the precision."""
        return float(np.log(np.diag(self.root)).sum())

    @cached_property
    def mean(self) -> FloatArray:
        """Posterior mean of the coefficients, shape (p,)."""
        return self.solve(self.along)

    @cached_property
    def covariance(self) -> FloatArray:
        """Posterior covariance of the coefficients, shape (p, p)."""
        return self.solve(np.eye(self.along.size))

    @cached_property
    def gain(self) -> float:
        """Log Bayes factor of the columns over none of them."""
        return 0.5 * float(self.along @ self.mean) - self.half_log_det

    @cached_property
    def log_evidence(self) -> float:
        """Log density of the data with all coefficients integrated out."""
        return self.constant - 0.5 * self.square + self.gain

    def sized(self, sizes: ArrayLike) -> Gaussian:
        """Give the same where the coefficients have other standard deviations before the test, shape (p,) or one."""
        root = np.broadcast_to(np.asarray(sizes, dtype=np.float64), self.along.shape)
        return Gaussian(self.square, self.along * root, self.inner * np.outer(root, root), self.constant)

    def given(self, d: int) -> Gaussian:
        """Give what is left to the columns behind the first `d` once the coefficients of these are integrated out."""
        first = Gaussian(self.square, self.along[:d], self.inner[:d, :d], self.constant)
        cross = self.inner[:d, d:]
        solved = first.solve(cross)
        return Gaussian(
            self.square - float(first.along @ first.mean),
            self.along[d:] - first.along @ solved,
            self.inner[d:, d:] - cross.T @ solved,
            self.constant - first.half_log_det,
        )


def log_gains(inner: FloatArray, along: FloatArray, sizes: FloatArray) -> FloatArray:
    """Log Bayes factors of many sets of columns at once, for m sizes of their coefficients, shape (..., m).

    `inner` and `along`, shapes (..., p, p) and (..., p), are as in `Gaussian`.
    """
    values, vectors = np.linalg.eigh(inner)
    values = np.maximum(values, 0.0)[..., None, :]
    squares = np.einsum("...ij,...i->...j", vectors, along)[..., None, :] ** 2
    v = sizes[:, None] ** 2
    return np.asarray(0.5 * np.sum(v * squares / (1.0 + v * values) - np.log1p(v * values), axis=-1))
