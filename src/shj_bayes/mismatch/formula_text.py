"""A formula as a line of text with units."""

from __future__ import annotations

import numpy as np

from shj_bayes.mismatch.expression import Factor, Sum, Term


def write_sum(terms: Sum, symbol: str, scale: float, unit: str) -> str:
    """Write a sum with its numbers to three digits.

    Parameters
    ----------
    terms : Sum
        Of x = coordinate / scale; sizes in the unit of the result.
    symbol, unit : str
        Of the coordinate.
    scale : float
        What the coordinate was divided by.

    Returns
    -------
    str
        Such as ``3.1 sin(2 pi x / 24.8 mm) - 0.4``.
    """
    out = ""
    for term in sorted(terms, key=lambda t: t.key == (0, ())):  # the constant last
        size, words = _term(term, symbol, scale, unit)
        sign = "-" if size < 0 else "+"
        lead = f" {sign} " if out else ("-" if size < 0 else "")
        out += lead + " ".join([f"{abs(size):.3g}", *words])
    return out


def _term(term: Term, symbol: str, scale: float, unit: str) -> tuple[float, list[str]]:
    """Size and further factors of one term."""
    size, words = term.size, []
    if term.degree == 1:
        words.append(f"{symbol} / {scale:.3g} {unit}" if not term.factors else f"({symbol} / {scale:.3g} {unit})")
    elif term.degree > 1:
        words.append(f"({symbol} / {scale:.3g} {unit})^{term.degree}")
    for factor in term.factors:
        if factor.name == "sin":
            sign, text = _sine(factor, symbol, scale, unit)
            size *= sign
        else:
            text = _other(factor, symbol, scale, unit)
        words.append(text)
    return size, words


def _sine(factor: Factor, symbol: str, scale: float, unit: str) -> tuple[float, str]:
    """Write a wave with a phase between -pi/2 and pi/2, and return the sign that this takes."""
    sign = float(np.sign(factor.slope) or 1.0)
    phase = (sign * factor.shift + np.pi / 2) % (2 * np.pi) - np.pi / 2
    if phase > np.pi / 2:
        sign, phase = -sign, phase - np.pi
    length = 2 * np.pi * scale / max(abs(factor.slope), 1e-300)
    shifted = f" {'-' if phase < 0 else '+'} {abs(phase):.2g}" if abs(phase) >= 0.005 else ""
    return sign, f"sin(2 pi {symbol} / {length:.3g} {unit}{shifted})"


def _other(factor: Factor, symbol: str, scale: float, unit: str) -> str:
    """Write a decay, a bump, a step or a modulus."""
    width = scale / max(abs(factor.slope), 1e-300)
    if factor.name == "exp":
        return f"exp({'-' if factor.slope < 0 else ''}{symbol} / {width:.3g} {unit})"
    centre = -factor.shift / (factor.slope or 1e-300) * scale
    away = symbol
    if abs(centre) >= 5e-4 * scale:
        away = f"{symbol} {'-' if centre > 0 else '+'} {abs(centre):.3g} {unit}"
    if factor.name == "abs":
        return f"|{away}| / {scale:.3g} {unit}"
    inside = away if away == symbol else f"({away})"
    if factor.name == "bell":
        return f"exp(-({inside} / {width:.3g} {unit})^2)"
    if factor.slope < 0:
        inside = f"({centre:.3g} {unit} - {symbol})" if away != symbol else f"-{symbol}"
    return f"step({inside} / {width:.3g} {unit})"
