"""What is left when the catalogue does not explain a misfit: where, what shape, which period."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import lombscargle

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.formula import find_formula
from shj_bayes.mismatch.locate import largest_region, profile
from shj_bayes.mismatch.regions import Regions
from shj_bayes.mismatch.search import Search
from shj_bayes.mismatch.thresholds import LINE, REPEAT_P
from shj_bayes.model.parameters import FloatArray

COORDINATES = {"position": "position_mm", "slip since reversal": "slip_mm", "travel": "travel_m", "speed": "speed_mm_s"}
PERIODIC = 0.25  # share of the residual that one sine must take up to be called a period


def describe_unknown(evidence: Evidence, result: Search, regions: Regions, *, seed: int = 1) -> dict[str, Any]:
    """Describe what the residual still holds after the effects of the catalogue that were found.

    Parameters
    ----------
    evidence : Evidence
        The recordings.
    result : Search
        Its final model's residual is described.
    regions : Regions
        Where to look for the largest misfit.
    seed : int
        Same seed and residual, same formula.

    Returns
    -------
    dict
        ``coordinate`` over which it is most regular, ``shape`` (table of centre, push and pull in kN), ``formula``
        (None where no simple one predicts held-out cycles), ``formula_words`` (how good it is, or why there is none),
        ``formula_share`` (of what comes again over the coordinate on held-out cycles, or None), ``period`` with unit or
        None, ``size_kN``, ``words``.
    """
    residual = result.final.residual_kN
    size, region = largest_region(evidence, result.final, regions, result.steps[-1].alarm)
    again = result.steps[-1].repeat
    if again.p_value < REPEAT_P and again.size_kN > size:  # waves along a stroke have no region of their own
        size, region = again.size_kN, None
    line = result.steps[-1].line
    formula = find_formula(evidence, residual, line, seed=seed)
    taken = {name: _taken(evidence, residual, name) for name in COORDINATES}
    # A wave of the clock comes again over time, which no map shows; then the best of the mapped coordinates is drawn.
    coordinate = formula.coordinate if formula.coordinate in taken else max(taken, key=lambda name: taken[name])
    centres, push, pull = profile(evidence, residual, coordinate)
    period = _period(evidence, residual)
    rows = [
        {"centre": float(c), "push_kN": _number(a), "pull_kN": _number(b)}
        for c, a, b in zip(centres, push, pull, strict=True)
    ]
    where = f" between {region.low:.3g} and {region.high:.3g} {region.unit} of {region.coordinate}" if region else ""
    if line.p_value < LINE and line.amplitude_kN > size:
        size, region = line.amplitude_kN, None
        period = {"coordinate": "time", "length": line.period_s, "unit": "s", "share": None}
    left = "What is left after them" if result.found else "The misfit"
    how_much = f"reaches {size:.2g} kN{where}"
    if size == 0.0:  # too few half-cycles to be sure of any region, and yet more than noise
        size = result.final.rmse_kN
        how_much = f"is {size:.2g} kN, root mean square"
    words = f"{left} {how_much}; it is most regular over {coordinate}"
    words += f", with a period of {period['length']:.3g} {period['unit']} of {period['coordinate']}." if period else "."
    return {
        "coordinate": coordinate,
        "shape": rows,
        "formula": formula.text,
        "formula_words": formula.words,
        "formula_share": formula.share if formula.text else None,
        "period": period,
        "size_kN": size,
        "words": words,
    }


def _taken(evidence: Evidence, residual: FloatArray, coordinate: str) -> float:
    """Share of the residual's sum of squares that its mean over intervals of a coordinate takes up."""
    values, sense = evidence.stack(COORDINATES[coordinate]), evidence.stack("direction")
    edges = np.linspace(values.min(), values.max(), 33)
    index = np.clip(np.searchsorted(edges, values) - 1, 0, 31) + 32 * (sense > 0)
    own = evidence.weight > 0
    count = np.bincount(index[own], minlength=64)
    total = np.bincount(index[own], weights=residual[own], minlength=64)
    return float(np.sum(total**2 / np.maximum(count, 1)) / max(float(residual @ residual), 1e-300))


def _period(evidence: Evidence, residual: FloatArray) -> dict[str, Any] | None:
    """Period over position, slip or time, when one sine takes up a good share of the residual."""
    best: tuple[float, str, float, str] | None = None
    own = evidence.weight > 0
    r = residual[own] - residual[own].mean()
    for coordinate, name, unit in (
        ("position", "position_mm", "mm"),
        ("slip since reversal", "slip_mm", "mm"),
        ("time", "time_s", "s"),
    ):
        values = evidence.stack(name)[own]
        span = float(np.ptp(values))
        waves = np.arange(2.0, 80.0, 0.25)
        for sign in (np.ones(r.size), evidence.stack("direction")[own]):
            power = lombscargle(values, r * sign, 2 * np.pi * waves / span, normalize=True)
            top = int(np.argmax(power))
            if best is None or power[top] > best[0]:
                best = (float(power[top]), coordinate, span / float(waves[top]), unit)
    if best is None or best[0] < PERIODIC:
        return None
    return {"coordinate": best[1], "length": best[2], "unit": best[3], "share": best[0]}


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
