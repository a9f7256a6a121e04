"""Two sets side by side: how far apart, how sure, and what so few devices can say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import ndtr

from shj_bayes.errors import PopulationError
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.quantities import QUANTITIES, FloatArray


@dataclass(frozen=True)
class Contrast:
    """One quantity of set a against set b.

    Parameters
    ----------
    quantity, unit : str
        What is compared; the unit is "1" for a quotient.
    kind : {"quotient", "difference"}
        a/b for K, Fy, ratio, beta; a - b for gamma.
    q05, q50, q95 : float
        Of the quotient or difference between the typical devices (medians) of both sets.
    probability_level : float
        Probability that the typical device of a is above that of b.
    superiority : float
        Probability that a new device of a is above a new device of b.
    n_a, n_b : int
        Devices that give the quantity.
    spread_factor : tuple of float
        5, 50 and 95 % of tau_a / tau_b.
    welch_p : float or None
        Two-sided p of Welch's test on the point values, pooled scale; None when either set has fewer
        than two devices or both have no spread. It does not know of rounding.
    other_priors : mapping of str to tuple of float
        5 and 95 % of the same under each other prior of the spread.
    sentence : str
        The same in words; "settled" only when every prior of the spread says so.
    """

    quantity: str
    unit: str
    kind: str
    q05: float
    q50: float
    q95: float
    probability_level: float
    superiority: float
    n_a: int
    n_b: int
    spread_factor: tuple[float, float, float]
    welch_p: float | None
    other_priors: Mapping[str, tuple[float, float]]
    sentence: str


@dataclass(frozen=True)
class Comparison:
    """Two sets compared in every pooled quantity.

    Parameters
    ----------
    set_a, set_b : str
        Names.
    contrasts : tuple of Contrast
        One per quantity.
    """

    set_a: str
    set_b: str
    contrasts: tuple[Contrast, ...]

    def to_table(self) -> pd.DataFrame:
        """One row per quantity."""
        return pd.DataFrame(
            [
                {
                    "set_a": self.set_a,
                    "set_b": self.set_b,
                    "quantity": c.quantity,
                    "kind": c.kind,
                    "unit": c.unit,
                    "q05": c.q05,
                    "q50": c.q50,
                    "q95": c.q95,
                    **{f"q05_{label}": band[0] for label, band in c.other_priors.items()},
                    **{f"q95_{label}": band[1] for label, band in c.other_priors.items()},
                    "probability_level": c.probability_level,
                    "superiority": c.superiority,
                    "n_a": c.n_a,
                    "n_b": c.n_b,
                    "welch_p": c.welch_p,
                    "sentence": c.sentence,
                }
                for c in self.contrasts
            ]
        )


def _welch(a: list[float], b: list[float]) -> float | None:
    if min(len(a), len(b)) < 2 or max(np.ptp(a), np.ptp(b)) < 1e-9:
        return None
    va, vb = (float(np.var(x, ddof=1)) / len(x) for x in (a, b))
    degrees = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return float(2.0 * stats.t.sf(abs(np.mean(a) - np.mean(b)) / np.sqrt(va + vb), degrees))


def _shift(result: PopulationResult, name: str, pair: tuple[int, int], prior: str) -> tuple[FloatArray, list[float]]:
    """Difference of the set levels, pooled scale, and 5, 50, 95 % of the quotient or difference."""
    fit, q = result.fit(name, prior), QUANTITIES[name]
    shift = fit.mu[:, pair[0]] - fit.mu[:, pair[1]]
    return shift, np.quantile(q.natural(shift), [0.05, 0.5, 0.95]).tolist()


def _sentence(sets: tuple[str, str], name: str, band: list[float], settled: dict[str, bool], n: tuple[int, int]) -> str:
    q05, q50, q95 = band
    if QUANTITIES[name].logarithmic:
        size = f"is {q50:.2f} times that of {sets[1]} (90 % interval {q05:.2f} to {q95:.2f})"
        open_ = f"a factor of anything from {q05:.2f} to {q95:.2f}"
    else:
        unit = QUANTITIES[name].unit
        size = f"differs from {sets[1]} by {q50:+.3g} {unit} (90 % interval {q05:+.3g} to {q95:+.3g})"
        open_ = f"anything from {q05:+.3g} to {q95:+.3g} {unit}"
    if not settled["default"]:
        verdict = f"the direction is not settled: {open_} is compatible with them"
    elif not all(settled.values()):
        against = ", ".join(label for label, yes in settled.items() if not yes)
        verdict = f"the direction hangs on what is assumed of the spread (not settled under the {against} prior)"
    else:
        verdict = "the direction is settled at 90 %, whatever prior of the spread is taken"
    return f"{sets[0]}: {name} of a typical device {size}; with {n[0]} and {n[1]} devices {verdict}."


def compare(result: PopulationResult, set_a: str, set_b: str) -> Comparison:
    """Compare two sets of a fitted population.

    Parameters
    ----------
    result : PopulationResult
        A fitted population.
    set_a, set_b : str
        Two different sets.

    Returns
    -------
    Comparison

    Raises
    ------
    PopulationError
        If a set is unknown or both are the same.
    """
    i, j = result.index(set_a), result.index(set_b)
    if i == j:
        raise PopulationError(f"a set cannot be compared with itself ({set_a!r}); name two different sets")
    a, b = result.sets[i], result.sets[j]
    contrasts = []
    for name, fit in result.posteriors.items():
        q = QUANTITIES[name]
        shift, band = _shift(result, name, (i, j), "default")
        others = {label: _shift(result, name, (i, j), label)[1] for label in result.other_priors}
        none = 1.0 if q.logarithmic else 0.0
        settled = {label: not x[0] < none < x[2] for label, x in {"default": band, **others}.items()}
        factor = np.quantile(fit.tau[:, i] / fit.tau[:, j], [0.05, 0.5, 0.95]).tolist()
        n = (fit.n_devices[i], fit.n_devices[j])
        contrasts.append(
            Contrast(
                quantity=name,
                unit="1" if q.logarithmic else q.unit,
                kind="quotient" if q.logarithmic else "difference",
                q05=band[0],
                q50=band[1],
                q95=band[2],
                probability_level=float(np.mean(shift > 0)),
                superiority=float(ndtr(shift / np.hypot(fit.tau[:, i], fit.tau[:, j])).mean()),
                n_a=n[0],
                n_b=n[1],
                spread_factor=(factor[0], factor[1], factor[2]),
                welch_p=_welch(*([x for x in s.points[name] if np.isfinite(x)] for s in (a, b))),
                other_priors=MappingProxyType({label: (x[0], x[2]) for label, x in others.items()}),
                sentence=_sentence((a.name, b.name), name, band, settled, n),
            )
        )
    return Comparison(a.name, b.name, tuple(contrasts))
