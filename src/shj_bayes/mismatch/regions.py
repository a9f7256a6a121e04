"""Where a residual lies, what looks alike there, and how a curve is written."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import ndtr

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.inference.start import extended, orthogonal_to
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.hypothesis import MIN_EFFECT
from shj_bayes.mismatch.laplace import Laplace
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.results.diagnosis import Alias, Location

HIDDEN = 0.1  # share of an effect that must survive a refit of the base law for the history to show it at all
ALIKE = 0.9  # cosine above which two effects look alike


def aliases_of(data: BinnedData) -> list[Alias]:
    """Pairs of effects that the tested history cannot separate, strongest first.

    Each effect acts with the values that a search starts from on the base law with the parameters of the device.
    """
    device = data.device.with_effects(())
    z = data.z[: device.n_law]
    law = data.likelihood.at(device)
    before = law.residual(z[None])[0]
    slopes = law.jacobian(z, before) * data.blocks.used[:, None]
    left: dict[str, FloatArray] = {}
    out = []
    for effect in catalogue().values():
        if effect.form or effect.id == "velocity":
            continue
        model = device.with_effects((effect,))
        starts = extended(z, device, model, effect)
        change = before - data.likelihood.at(model).residual(starts[len(starts) // 2][None])[0]
        rest = orthogonal_to(slopes, change[:, None])[:, 0]
        size, whole = float(np.linalg.norm(rest)), float(np.linalg.norm(change))
        if size <= HIDDEN * whole or whole == 0.0:
            out.append(Alias((effect.id, "base law"), 1.0 - size / max(whole, 1e-300)))
        else:
            left[effect.id] = rest / size
    names = list(left)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            cosine = float(left[first] @ left[second])
            if abs(cosine) > ALIKE:
                out.append(Alias((first, second), cosine))
    return sorted(out, key=lambda alias: -abs(alias.correlation))


MIN_SHARE = 0.01  # of the blocks that a region must hold to be looked at
LISTED, EACH = 8, 2  # regions in a list for people; of one coordinate
SURE = 0.05
WORDS = {"slip": "slip since reversal"}  # for coordinates in files, where they have other words
SIDES = ("both", "push", "pull")
WHERE = (("position", 11), ("speed", 6), ("slip", 8), ("travel", 12), ("amplitude", 6))  # and in how many intervals


def regions_of(metric: ErrorModel, base: Laplace) -> list[Location]:
    """List the regions in which the base law fails, the largest first, at most two for each coordinate."""
    data = metric.data
    sense, run = data.blocks.channel("direction"), run_of(data)
    cuts, columns = [], []
    histories = [part.history for part in data.blocks]
    for name, n in WHERE:
        over = coordinate_named(name)
        part = data.blocks.mean([over.share(h, data.base) for h in histories])
        for low, high in pairwise(np.linspace(0.0, 1.0 + 1e-9, n + 1)):
            inside = (part >= low) & (part < high) & (data.blocks.used > 0)
            edges = over.value_of(np.array([low, min(high, 1.0)]), histories[0])
            ends = (float(edges[0]), float(edges[1]))
            cuts += [(WORDS.get(over.id, over.id), over.unit, ends, word) for word in SIDES]
            columns += [_side(word, inside, sense) for word in SIDES]
    for number in range(1, len(histories) + 1):
        inside = (run == number) & (data.blocks.used > 0)
        cuts += [("run", "1", (number - 0.5, number + 0.5), word) for word in SIDES]
        columns += [_side(word, inside, sense) for word in SIDES]
    table = np.stack(columns, axis=1)
    large = np.count_nonzero(table, axis=0) >= MIN_SHARE * data.blocks.used.sum()
    table, cuts = table[:, large], [cut for cut, ok in zip(cuts, large, strict=True) if ok]
    # Two-sided chance of each column's product with the residual, beside the parameters of the law.
    rest = metric.gaussian(base.beside(table)).given(base.z.size)
    p_values = 2.0 * ndtr(-np.abs(rest.along) / np.sqrt(np.maximum(np.diag(rest.inner), 1e-300)))
    whole = float(base.residual @ base.residual)
    found = []
    for (coordinate, unit, interval, side), column, p in zip(cuts, table.T, p_values, strict=True):
        own = np.flatnonzero(column)
        squares = np.bincount(run[own], weights=base.residual[own] ** 2)
        found.append(
            Location(
                coordinate=coordinate,
                unit=unit,
                interval=interval,
                direction=side,
                runs=tuple(int(i) for i in np.flatnonzero(squares >= 0.1 * squares.sum()) if i > 0),
                size_kN=float(column[own] @ base.residual[own]) / own.size,
                share=float(squares.sum()) / max(whole, 1e-300),
                p_value=min(1.0, float(p) * len(cuts)),
            )
        )
    kept: list[Location] = []
    for region in sorted(found, key=lambda r: -abs(r.size_kN)):
        same = sum(k.coordinate == region.coordinate for k in kept)
        if region.p_value <= SURE and abs(region.size_kN) > 0 and same < EACH and len(kept) < LISTED:
            kept.append(region)
    return kept


def run_of(data: BinnedData) -> IntArray:
    """Give the number of the run of each block."""
    return np.concatenate([np.full(part.n, part.history.run) for part in data.blocks])


def _side(word: str, inside: BoolArray, sense: FloatArray) -> FloatArray:
    """Column of a region: signed with the motion, or 1 in one direction."""
    if word == "both":
        return np.asarray(inside * np.sign(sense))
    return np.asarray(inside & (sense > 0 if word == "push" else sense < 0), dtype=np.float64)


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
    weight = 1.0 / np.maximum(high - low, 0.2 * 100 * MIN_EFFECT)
    allowed = np.maximum(0.5 * (high - low), 100 * MIN_EFFECT)
    for shape in SHAPES:
        fits = []
        for length in shape.lengths:
            columns = shape.columns(u, float(length))
            solved = np.linalg.lstsq(columns * weight[:, None], mean * weight, rcond=1e-9)[0]
            sizes = np.asarray(solved, dtype=np.float64)
            worst = float(np.max(np.abs(columns @ sizes - mean) / allowed))
            fits.append((worst, sizes, float(length)))
        worst, sizes, length = min(fits, key=lambda fit: fit[0])
        if worst <= 1.0:
            place = length * span + (first if shape.name in ("modulus", "step") else 0.0)
            symbol = name if first == 0.0 or shape.name in ("modulus", "step") else f"({name} - {first:.3g} {unit})"
            return shape.text(sizes, place, symbol, unit)
    return None
