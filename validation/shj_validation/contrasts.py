"""Analysis of variance of balanced tables of devices."""

from dataclasses import dataclass

from scipy.special import fdtrc

from shj_bayes._util.arrays import FloatArray


@dataclass(frozen=True)
class Anova:
    """Two-way analysis of variance with interaction, balanced.

    Parameters
    ----------
    f_rows, p_rows : float
        First factor, here the coating.
    f_columns, p_columns : float
        Second factor, here corrosion.
    """

    f_rows: float
    p_rows: float
    f_columns: float
    p_columns: float


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
    )
