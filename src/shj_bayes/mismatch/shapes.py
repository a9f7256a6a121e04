"""A formula for a curve that no mechanism of the catalogue has, where a simple one lies within its band."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from shj_bayes.mismatch.classes import MATTERS
from shj_bayes.model.parameters import FloatArray


@dataclass(frozen=True)
class Shape:
    """A curve over a share u of a range: linear in its sizes, with one length or place that is not."""

    name: str  # short word
    # ``columns(u, length)``, shape (n, n_sizes); the last size is a constant
    columns: Callable[[FloatArray, float], FloatArray]
    lengths: FloatArray  # lengths or places to try, as shares of the range
    # ``text(sizes, length, name, unit)`` writes the formula; lengths are in the unit
    text: Callable[[FloatArray, float, str, str], str]


def _with_one(*columns: FloatArray) -> FloatArray:
    return np.stack([*columns, np.ones_like(columns[0])], axis=1)


def _wave(sizes: FloatArray, length: float, x: str, unit: str) -> str:
    size, phase = float(np.hypot(sizes[0], sizes[1])), float(np.arctan2(sizes[1], sizes[0]))
    return f"{size:.3g} sin(2 pi {x} / {length:.3g} {unit} {phase:+.2g}) {sizes[2]:+.3g}"


SHAPES = (
    Shape("line", lambda u, _: _with_one(u), np.ones(1), lambda s, _, x, unit: f"{s[0]:.3g} {x}/range {s[1]:+.3g}"),
    Shape(
        "parabola", lambda u, _: _with_one(u**2, u), np.ones(1),
        lambda s, _, x, unit: f"{s[0]:.3g} ({x}/range)^2 {s[1]:+.3g} {x}/range {s[2]:+.3g}",
    ),
    Shape(
        "modulus", lambda u, c: _with_one(np.abs(u - c)), np.linspace(0.05, 0.95, 91),
        lambda s, c, x, unit: f"{s[0]:.3g} |{x} - {c:.3g} {unit}|/range {s[1]:+.3g}",
    ),
    Shape(
        "step", lambda u, c: _with_one(1.0 / (1.0 + np.exp(-np.clip((u - c) / 0.01, -50, 50)))),
        np.linspace(0.05, 0.95, 91), lambda s, c, x, unit: f"{s[0]:.3g} step({x} - {c:.3g} {unit}) {s[1]:+.3g}",
    ),
    Shape(
        "exponential", lambda u, c: _with_one(np.exp(-u / c)), np.geomspace(1 / 60, 2.0, 40),
        lambda s, c, x, unit: f"{s[0]:.3g} exp(-{x} / {c:.3g} {unit}) {s[1]:+.3g}",
    ),
    Shape("sine", lambda u, c: _with_one(np.sin(2 * np.pi * u / c), np.cos(2 * np.pi * u / c)),
          1.0 / np.arange(1.0, 16.0, 0.1), _wave),
)  # fmt: skip


def formula_of(at: FloatArray, mean: FloatArray, low: FloatArray, high: FloatArray, name: str, unit: str) -> str | None:
    """Simplest formula that lies within the band of a curve, per cent of Fy, or misses it by less than what matters.

    Its right-hand side, with symbol and unit of the coordinate; None where no shape of a few numbers does.
    """
    first, span = float(at[0]), float(np.ptp(at))
    u = (at - first) / span
    weight = 1.0 / np.maximum(high - low, 0.2 * 100 * MATTERS)
    allowed = np.maximum(0.5 * (high - low), 100 * MATTERS)
    for shape in SHAPES:
        best: tuple[float, FloatArray, float] | None = None
        for length in shape.lengths:
            columns = shape.columns(u, float(length))
            solved = np.linalg.lstsq(columns * weight[:, None], mean * weight, rcond=1e-9)[0]
            sizes = np.asarray(solved, dtype=np.float64)
            worst = float(np.max(np.abs(columns @ sizes - mean) / allowed))
            if best is None or worst < best[0]:
                best = (worst, sizes, float(length))
        assert best is not None
        if best[0] <= 1.0:
            place = best[2] * span + (first if shape.name in ("modulus", "step") else 0.0)
            symbol = name if first == 0.0 or shape.name in ("modulus", "step") else f"({name} - {first:.3g} {unit})"
            return shape.text(best[1], place, symbol, unit)
    return None
