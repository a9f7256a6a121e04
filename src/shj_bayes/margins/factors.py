"""Factors on the nominal sliding force: ASCE 7, EN 15129 and New Zealand practice, as margins."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from shj_bayes.margins import asce7, en15129, nz
from shj_bayes.margins.parts import Parts
from shj_bayes.margins.row import FACTORS, HIGH, LOW, MIDDLE, Margin

RowMaker = Callable[[str, str, float, str, str, tuple[str, str, str, str]], Margin]
"""kind, side, value, clause, formula, (unit, inputs, purpose, note) -> row."""


def factor_rows(
    set_name: str, parts: Parts, n_devices: int, importance: str = "II", nominal_words: str = "typical device"
) -> Iterator[Margin]:
    """Rows of ASCE 7, EN 15129 and New Zealand practice for one set."""

    def row(kind: str, side: str, value: float, clause: str, formula: str, more: tuple[str, str, str, str]) -> Margin:
        unit, inputs, purpose, note = more
        return Margin(
            set_name,
            "Fy",
            FACTORS,
            kind,
            side,
            value,
            unit,
            n_devices,
            math.nan,
            clause,
            formula,
            inputs,
            purpose,
            note,
        )

    base = f"nominal {parts.nominal_kN:.4g} kN ({nominal_words})"
    yield row(
        "nominal sliding force",
        MIDDLE,
        parts.nominal_kN,
        "ASCE 7, NZ practice",
        "50 % of a new device, first run",
        ("kN", base, "what the factors below multiply", ""),
    )
    total = asce7.modification(parts.age.bounds, parts.testing, parts.specification)
    floored = asce7.with_floor(total)
    for side, pick in ((LOW, "low"), (HIGH, "high")):
        word = "min" if side == LOW else "max"
        spec, test, age, both, final = (
            getattr(b, pick) for b in (parts.specification, parts.testing, parts.age.bounds, total, floored)
        )
        clause = "ASCE 7 18.2.4"
        yield row(
            f"lambda_spec,{word}",
            side,
            spec,
            clause,
            f"{'5' if side == LOW else '95'} % / 50 % of a new device",
            ("1", f"{parts.low_kN:.4g} to {parts.high_kN:.4g} kN", "manufacturing: device to device", ""),
        )
        yield row(
            f"lambda_test,{word}",
            side,
            test,
            clause,
            "(second run / first) x speed factor, each where it is beyond 1",
            ("1", parts.inputs, "first cycle, cumulative travel and speed in the tests", ""),
        )
        yield row(
            f"lambda_ae,{word}",
            side,
            age,
            clause,
            "corroded / uncorroded, typical devices",
            ("1", parts.age.words, "ageing and environment: corrosion only", ""),
        )
        sign = "1 - 0.75 (1 - ae)" if side == LOW else "1 + 0.75 (ae - 1)"
        yield row(
            f"lambda_{word}",
            side,
            both,
            clause,
            f"({sign}) x test x spec",
            (
                "1",
                f"ae {age:.3f}, test {test:.3f}, spec {spec:.3f}",
                "factor on the nominal force, before the floor",
                "",
            ),
        )
        limit = asce7.FLOORS["damper"][0 if side == LOW else 1]
        yield row(
            f"lambda_{word} with the floor for dampers",
            side,
            final,
            f"{clause}.5",
            f"not {'above' if side == LOW else 'below'} {limit:g}",
            ("1", f"{both:.3f}", f"{'lower' if side == LOW else 'upper'}-bound analysis", ""),
        )
        yield row(
            f"ASCE 7 {'lower' if side == LOW else 'upper'} bound force",
            side,
            final * parts.nominal_kN,
            clause,
            f"lambda_{word} x nominal",
            (
                "kN",
                f"{final:.3f} x {parts.nominal_kN:.4g} kN",
                f"{'lower' if side == LOW else 'upper'}-bound analysis",
                "",
            ),
        )
    yield from _en15129(row, parts, importance)
    yield from _nz(row, parts)


def _en15129(row: RowMaker, parts: Parts, importance: str) -> Iterator[Margin]:
    influences = (parts.age.bounds, asce7.NONE, asce7.NONE, parts.travel)
    factors = en15129.bound_factors(influences, importance)
    untested = "temperature and contamination were not tested and stand as 1"
    for side, value, factor, supply, word in (
        (LOW, parts.low_kN * factors.low, factors.low, parts.low_kN, "LBDP"),
        (HIGH, parts.high_kN * factors.high, factors.high, parts.high_kN, "UBDP"),
    ):
        yield row(
            f"EN 15129 {word}, importance class {importance}",
            side,
            value,
            "EN 15129; EN 1998-2 Annex J",
            "X x product of [1 + (lambda_fi - 1) psi_fi]",
            (
                "kN",
                f"X = {supply:.4g} kN (new device), product {factor:.3f}: ageing {parts.age.words}; "
                f"travel {parts.travel.low:.3f} to {parts.travel.high:.3f}; psi = {en15129.COMBINATION[importance]:g}",
                f"{'lower' if side == LOW else 'upper'} bound design property, one of two analyses",
                untested,
            ),
        )


def _nz(row: RowMaker, parts: Parts) -> Iterator[Margin]:
    phi, phi_o = nz.equivalent_factors(parts.low_kN, parts.high_kN, parts.nominal_kN)
    practice = f"practice for hardened shims: phi {nz.PRACTICE_PHI:.2f}, phi_o {nz.PRACTICE_PHI_O:.2f}"
    clause = "NZ practice for sliding hinge joints"
    used = f"nominal {parts.nominal_kN:.4g} kN"
    yield row(
        "phi equivalent, first run",
        LOW,
        phi,
        clause,
        "X_5% / nominal",
        ("1", f"{parts.low_kN:.4g} kN, {used}", "dependable sliding force phi V_ss", practice),
    )
    if parts.second_kN is not None:
        yield row(
            "phi equivalent, after a first earthquake",
            LOW,
            parts.second_kN / parts.nominal_kN,
            clause,
            "X_5%, second run / nominal",
            ("1", f"{parts.second_kN:.4g} kN, {used}", "dependable sliding force in a second earthquake", practice),
        )
    yield row(
        "phi_o equivalent",
        HIGH,
        phi_o,
        clause,
        "X_95% / nominal",
        ("1", f"{parts.high_kN:.4g} kN, {used}", "overstrength: capacity design of beam, column and welds", practice),
    )
