"""A formula of one variable as a sum of terms: evaluated and compared, never executed as text.

A term is a number times x^n times functions of (c x + d). Whatever symbolic regression comes up with is brought into
this one form, so that two programs that mean the same are the same; what does not fit it is not simple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.model.parameters import FloatArray

MAX_DEGREE = 4
LIMIT = {"sin": 200.0, "exp": 200.0}  # of a factor in front of x: what is shorter is not seen in a profile
NARROWEST = 60.0  # the same for bumps and steps
CANCEL = 4.0  # times the profile's largest value; larger terms cancel one another
NARROW = 2.5  # a bump or step as wide as the range is none


@dataclass(frozen=True)
class Factor:
    """A function of (slope x + shift), in a term.

    Parameters
    ----------
    name : {"sin", "exp", "bell", "step", "abs"}
        ``bell(u)`` is exp(-u^2), ``step(u)`` is (1 + tanh(u))/2.
    slope, shift : float
        Of its argument.
    """

    name: str
    slope: float
    shift: float


@dataclass(frozen=True)
class Term:
    """A number times x^degree times functions.

    Parameters
    ----------
    size : float
        The number.
    degree : int
        Power of x.
    factors : tuple of Factor
        Functions.
    """

    size: float
    degree: int = 0
    factors: tuple[Factor, ...] = ()

    @property
    def key(self) -> tuple[object, ...]:
        """What must be equal for two terms to be one."""
        return (self.degree, self.factors)


Sum = tuple[Term, ...]


def number(value: float) -> Sum:
    """Write a number as a sum."""
    return (Term(float(value)),)


def variable(slope: float = 1.0, shift: float = 0.0) -> Sum:
    """Write slope x + shift as a sum."""
    return tidy((Term(slope, 1), Term(shift)))


def tidy(terms: Sequence[Term]) -> Sum:
    """Merge equal terms, drop those that are 0, and order the rest."""
    merged: dict[tuple[object, ...], Term] = {}
    for term in terms:
        same = merged.get(term.key)
        merged[term.key] = term if same is None else replace(same, size=same.size + term.size)
    kept = [t for t in merged.values() if t.size != 0.0]
    return tuple(sorted(kept, key=lambda t: (len(t.factors), t.degree, t.factors and (t.factors[0].name,))))


def times(first: Sum, second: Sum) -> Sum | None:
    """Multiply two sums; None when the product is no longer simple."""
    terms = [
        Term(a.size * b.size, a.degree + b.degree, tuple(sorted((*a.factors, *b.factors), key=lambda f: f.name)))
        for a in first
        for b in second
    ]
    if any(t.degree > MAX_DEGREE or len(t.factors) > 2 for t in terms) or len(terms) > 6:
        return None
    return tidy(terms)


def apply(name: str, inner: Sum) -> Sum | None:
    """Write a function of a sum as a sum; None when its argument is not linear in x."""
    if any(t.factors or t.degree > 1 for t in inner):
        return None
    slope = sum(t.size for t in inner if t.degree == 1)
    shift = sum(t.size for t in inner if t.degree == 0)
    if slope == 0.0:
        value = float(value_of(name, np.asarray(shift)))
        return number(value) if np.isfinite(value) else None
    scale = 1.0
    if name == "abs":
        scale, shift, slope = abs(slope), shift / slope, 1.0
    if abs(slope) > LIMIT.get(name, NARROWEST):
        return None
    if name == "exp":  # exp(c x + d) = exp(d) exp(c x)
        scale, shift = float(np.exp(np.clip(shift, -20, 20))), 0.0
    return (Term(scale, 0, (Factor(name, slope, shift),)),)


def value_of(name: str, u: FloatArray) -> FloatArray:
    """Evaluate one of the functions of a `Factor`."""
    if name == "sin":
        return np.asarray(np.sin(u))
    if name == "exp":
        return np.asarray(np.exp(np.clip(u, -30.0, 30.0)))
    if name == "bell":
        return np.asarray(np.exp(-np.minimum(u**2, 700.0)))
    if name == "step":
        return np.asarray((1.0 + np.tanh(u)) / 2)
    return np.asarray(np.abs(u))


def shape(term: Term, x: FloatArray) -> FloatArray:
    """Evaluate a term without its number."""
    out = x**term.degree
    for factor in term.factors:
        out = out * value_of(factor.name, factor.slope * x + factor.shift)
    return np.asarray(out)


def evaluate(terms: Sum, x: FloatArray) -> FloatArray:
    """Value of a sum at x, the same shape."""
    out = np.zeros_like(x)
    for term in terms:
        out = out + term.size * shape(term, x)
    return out


def sensible(terms: Sum, x: FloatArray, y: FloatArray) -> bool:
    """Whether a sum says what it looks like over this range.

    Terms that cancel one another, a wave of less than one turn, a bump or a step outside the range fit something, but
    tell a reader what is not there.
    """
    low, high = float(x.min()), float(x.max())
    for term in terms:
        if float(np.max(np.abs(term.size * shape(term, x)))) > CANCEL * float(np.max(np.abs(y))):
            return False
        for f in term.factors:
            if f.name == "sin" and abs(f.slope) * (high - low) < 0.9 * 2 * np.pi:
                return False
            if f.name in ("bell", "step", "abs") and not low <= -f.shift / (f.slope or 1e-300) <= high:
                return False
            if f.name in ("bell", "step") and abs(f.slope) * (high - low) < NARROW:
                return False
    return True


def n_numbers(terms: Sum) -> int:
    """How many numbers a reader must take in."""
    return sum(1 + sum(len(free_numbers(f)) for f in t.factors) for t in terms)


def free_numbers(factor: Factor) -> tuple[str, ...]:
    """Numbers of a factor that can be chosen; the slope of a modulus goes into the size of its term."""
    slope = () if factor.name == "abs" else ("slope",)
    return (*slope, "shift") if factor.shift != 0.0 else slope
