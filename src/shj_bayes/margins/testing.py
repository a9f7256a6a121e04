"""Design assisted by testing: EN 1990 Annex D values and statistical tolerance limits of a set, as margins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

from shj_bayes.margins import en1990, tolerance
from shj_bayes.margins.row import HIGH, LOW, TESTING, TOLERANCE, Margin
from shj_bayes.margins.sample import UNITS, Sample

SIGNS = {LOW: -1, HIGH: 1}
LIMITS = ((0.95, 0.75), (0.95, 0.95), (0.90, 0.95))
"""Coverage and confidence of the tolerance limits."""
NORMAL, LOGNORMAL = "normal", "lognormal"
NOT_NORMAL = "not above zero: the normal law does not suit so wide a spread; use the lognormal value"
_FLOORED = "the devices agree to the printed digits: the spread is that of rounding"


@dataclass(frozen=True)
class Spread:
    """Where the spread of a margin comes from.

    Parameters
    ----------
    name : str
        "V known", "V unknown" or "V common".
    sd_log, variation : float
        Standard deviation of the logarithm; coefficient of variation.
    degrees : float
        Infinity where it is taken as known.
    origin : str
        In words.
    """

    name: str
    sd_log: float
    variation: float
    degrees: float
    origin: str


def spreads(sample: Sample, known_sd_log: float, common: tuple[float, int]) -> tuple[Spread, ...]:
    """Three ways to come by the spread: known beforehand, from these devices alone, common to all sets."""
    sd, degrees = common
    out = [
        Spread(
            "V known",
            known_sd_log,
            en1990.variation_of_log(known_sd_log),
            math.inf,
            "middle of the set's spread from the partially pooled model",
        )
    ]
    if sample.n > 1:
        out.append(Spread("V unknown", sample.sd_log, sample.variation, sample.n - 1, "these devices alone"))
    if degrees:
        out.append(
            Spread("V common", sd, en1990.variation_of_log(sd), degrees, "all sets together, each about its mean")
        )
    return tuple(out)


def en1990_values(set_name: str, quantity: str, sample: Sample, ways: tuple[Spread, ...]) -> Iterator[Margin]:
    """Characteristic and design values, low and high, normal and lognormal, for every way to come by the spread."""
    for fractile, word, table, purpose in (
        (en1990.CHARACTERISTIC, "characteristic", "D1", "characteristic value X_k, to be divided by gamma_m"),
        (en1990.DESIGN, "design", "D2", "design value X_d straight from tests, no gamma_m to follow"),
    ):
        for way in ways:
            known = math.isinf(way.degrees)
            factor = (
                en1990.factor_known(sample.n, fractile)
                if known
                else en1990.factor_unknown(sample.n, fractile, way.degrees)
            )
            few = way.degrees < en1990.FEWEST[fractile] - 1
            for law in (LOGNORMAL, NORMAL):
                for side in (LOW, HIGH):
                    value, formula, inputs = _limit(sample, way, factor, law, side)
                    note = f"Table {table} has no factor for n = {way.degrees + 1:g} with V unknown" if few else ""
                    yield Margin(
                        set_name,
                        quantity,
                        TESTING,
                        f"EN 1990 {word}, {law}, {way.name}",
                        side,
                        math.nan if few else value,
                        UNITS[quantity],
                        sample.n,
                        way.degrees,
                        f"EN 1990 {'D7.2' if word == 'characteristic' else 'D7.3'}, Table {table}",
                        formula,
                        f"{inputs}; spread: {way.origin}",
                        f"{'upper' if side == HIGH else 'lower'} {purpose}",
                        note or _remarks(sample, way, value),
                    )


def tolerance_limits(set_name: str, quantity: str, sample: Sample, ways: tuple[Spread, ...]) -> Iterator[Margin]:
    """One- and two-sided tolerance limits: of the set's own devices, and with the variance common to all sets."""
    forms: tuple[tuple[str, Callable[..., float]], ...] = (
        ("one-sided", tolerance.one_sided),
        ("two-sided", tolerance.two_sided),
    )
    for way in ways:
        if math.isinf(way.degrees):
            continue
        laws = (LOGNORMAL, NORMAL) if way.name == "V unknown" else (LOGNORMAL,)
        for coverage, confidence in LIMITS:
            for form, factor_of in forms:
                factor = partial(factor_of, sample.n, coverage, confidence, degrees=way.degrees)()
                for law in laws:
                    for side in (LOW, HIGH):
                        value, formula, inputs = _limit(sample, way, factor, law, side)
                        share = f"{100 * coverage:.0f}/{100 * confidence:.0f}"
                        covered = "beyond it" if form == "one-sided" else "between both limits"
                        yield Margin(
                            set_name,
                            quantity,
                            TOLERANCE,
                            f"tolerance {share} {form}, {law}, {way.name}",
                            side,
                            value,
                            UNITS[quantity],
                            sample.n,
                            way.degrees,
                            f"{tolerance.CLAUSE}, {form}"
                            + (", several samples with a common variance" if way.name == "V common" else ""),
                            formula,
                            f"{inputs}; spread: {way.origin}",
                            f"{100 * coverage:.0f} % of devices lie {covered}, with a confidence of "
                            f"{100 * confidence:.0f} %",
                            _remarks(sample, way, value),
                        )


def _limit(sample: Sample, way: Spread, factor: float, law: str, side: str) -> tuple[float, str, str]:
    sign = SIGNS[side]
    mark = "-" if sign < 0 else "+"
    if law == LOGNORMAL:
        return (
            en1990.lognormal_value(sample.mean_log, way.sd_log, factor, sign),
            f"exp(m_y {mark} k s_y)",
            f"m_y = {sample.mean_log:.4f}, s_y = {way.sd_log:.4f}, k = {factor:.4f}",
        )
    return (
        en1990.normal_value(sample.mean, way.variation, factor, sign),
        f"m (1 {mark} k V)",
        f"m = {sample.mean:.5g}, V = {way.variation:.4f}, k = {factor:.4f}",
    )


def _remarks(sample: Sample, way: Spread, value: float) -> str:
    notes = []
    if way.name == "V unknown" and sample.n > 1 and sample.sd_log <= sample.floor:
        notes.append(_FLOORED)
    if way.name == "V unknown" and sample.n == 2:
        notes.append("two devices hardly tell a spread; use V common")
    if value <= 0:
        notes.append(NOT_NORMAL)
    return "; ".join(notes)
