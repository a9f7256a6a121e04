"""Classical side figures for balanced tables of devices: exact permutation and analysis of variance."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from shj_bayes.errors import PopulationError
from shj_bayes.population.quantities import FloatArray


@dataclass(frozen=True)
class Permutation:
    """Exact stratified permutation test of "treated or not".

    Parameters
    ----------
    mean_difference : float
        Mean over strata of treated minus untreated, in the unit of the values.
    p_two_sided : float
        Share of arrangements at least as far from zero.
    arrangements : int
        All of them.
    p_least : float
        Smallest share that any arrangement of these values can give.
    """

    mean_difference: float
    p_two_sided: float
    arrangements: int
    p_least: float


def stratified_permutation(values: FloatArray) -> Permutation:
    """Permute "treated" and "untreated" inside each stratum, exactly.

    Parameters
    ----------
    values : array, shape (n_strata, 2, n_devices)
        Untreated first, treated second; equal numbers.

    Returns
    -------
    Permutation

    Raises
    ------
    PopulationError
        If the table is not of that shape.
    """
    if values.ndim != 3 or values.shape[1] != 2:
        raise PopulationError(f"a stratified permutation needs shape (strata, 2, devices); got {values.shape}")
    n_strata, _, n = values.shape
    observed = float((values[:, 1].mean(axis=1) - values[:, 0].mean(axis=1)).sum())
    sums = np.zeros(1)
    for stratum in values.reshape(n_strata, -1):
        chosen = [list(c) for c in itertools.combinations(range(2 * n), n)]
        differences = np.array([(2.0 * stratum[c].sum() - stratum.sum()) / n for c in chosen])
        sums = np.add.outer(sums, differences).ravel()
    away = np.abs(sums)
    p, least = (float(np.mean(away >= x - 1e-9 * max(1.0, x))) for x in (abs(observed), float(away.max())))
    return Permutation(observed / n_strata, p, sums.size, least)


@dataclass(frozen=True)
class Anova:
    """Two-way analysis of variance with interaction, balanced.

    Parameters
    ----------
    f_rows, p_rows : float
        First factor, here the coating.
    f_columns, p_columns : float
        Second factor, here corrosion.
    degrees : tuple of int
        Rows, columns, residual.
    """

    f_rows: float
    p_rows: float
    f_columns: float
    p_columns: float
    degrees: tuple[int, int, int]


def two_way_anova(values: FloatArray) -> Anova:
    """Test both main effects against the spread within cells.

    Parameters
    ----------
    values : array, shape (n_rows, n_columns, n_replicates)
        Balanced table.

    Returns
    -------
    Anova
    """
    a, b, n = values.shape
    cell = values.mean(axis=2)
    residual = float(((values - cell[..., None]) ** 2).sum()) / (a * b * (n - 1))
    rows = b * n * float(((values.mean(axis=(1, 2)) - values.mean()) ** 2).sum()) / (a - 1)
    columns = a * n * float(((values.mean(axis=(0, 2)) - values.mean()) ** 2).sum()) / (b - 1)
    degrees = (a - 1, b - 1, a * b * (n - 1))
    f_rows, f_columns = rows / residual, columns / residual
    return Anova(
        f_rows,
        float(fdtrc(degrees[0], degrees[2], f_rows)),
        f_columns,
        float(fdtrc(degrees[1], degrees[2], f_columns)),
        degrees,
    )
