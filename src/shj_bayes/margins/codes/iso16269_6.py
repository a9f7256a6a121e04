"""ISO 16269-6: statistical tolerance limits, normal populations, one sample or several with a common unknown variance.

The text of the standard could not be read beyond its scope; factors are checked against its exact definitions, printed
tables of others and simulation (in the tests).
Factors k are for limits mean -+ k s. A limit of a log-normal quantity is that of its logarithm, taken back. Numbers of
the standard's own tables come out to the last printed digit, because the factors are exact and not approximations.
"""

import math
from collections.abc import Iterator
from functools import cache
from itertools import product

import numpy as np
from scipy import optimize, special

from shj_bayes.errors import PopulationError
from shj_bayes.margins.codes.code import Code, Given
from shj_bayes.margins.spread import HIGH, LOGNORMAL, LOW, NORMAL, TOLERANCE, V_COMMON, V_UNKNOWN, Margin
from shj_bayes.population.quantities import FloatArray

CLAUSE = "ISO 16269-6"
LIMITS = ((0.95, 0.75), (0.95, 0.95), (0.90, 0.95))
"""Coverage and confidence of the limits."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(101)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def _check(n: float, degrees: float, coverage: float, confidence: float) -> None:
    if n < 1 or degrees < 1:
        raise PopulationError(
            f"a tolerance limit from {n:g} devices with {degrees:g} degrees of freedom cannot be given: the spread "
            "needs two devices of one set at least; test more, or use the spread of several sets together"
        )
    if not (0 < coverage < 1 and 0 < confidence < 1):
        raise PopulationError(
            f"coverage {coverage:g} and confidence {confidence:g} are shares: both must lie between 0 and 1"
        )


@cache
def one_sided(n: float, coverage: float, confidence: float, degrees: float | None = None) -> float:
    """Factor of a one-sided limit from n devices, spread unknown: exact, from the noncentral t distribution.

    k = t'(confidence; degrees, z sqrt(n)) / sqrt(n) with z the normal quantile of the coverage. The degrees of freedom
    of the spread are n - 1 when it comes from the same devices, more when it is pooled over several sets.
    """
    nu = n - 1 if degrees is None else degrees
    _check(n, nu, coverage, confidence)
    if math.isinf(nu):  # spread known
        return float(special.ndtri(coverage) + special.ndtri(confidence) / math.sqrt(n))
    return float(special.nctdtrit(nu, special.ndtri(coverage) * math.sqrt(n), confidence) / math.sqrt(n))


@cache
def two_sided(n: float, coverage: float, confidence: float, degrees: float | None = None) -> float:
    """Factor of a two-sided limit mean +- k s, spread unknown: exact, by quadrature over the error of the mean.

    The k that solves E[P(chi2 > degrees r(Z)^2 / k^2)] = confidence, Z the error of the mean in standard deviations,
    r(Z) the half-width that covers the share from there (ISO 16269-6, exact form). Arguments as for `one_sided`.
    """
    nu = n - 1 if degrees is None else degrees
    _check(n, nu, coverage, confidence)
    if math.isinf(nu):  # spread known: the mean alone is in error, and its share covered falls with the error
        return float(_half_widths(np.array([special.ndtri(0.5 * (1.0 + confidence)) / math.sqrt(n)]), coverage)[0])
    z = np.abs(_NODES) / math.sqrt(n)
    half = _half_widths(z, coverage)

    def confidence_missing(k: float) -> float:
        return float(_WEIGHTS @ special.chdtrc(nu, nu * (half / k) ** 2)) - confidence

    return float(optimize.brentq(confidence_missing, 1e-3, 1e6, xtol=1e-9, rtol=1e-12))


def _half_widths(z: FloatArray, coverage: float) -> FloatArray:
    """Half-widths r with Phi(z + r) - Phi(z - r) = coverage, from above, where Newton's steps never overshoot."""

    def coverage_beyond(r: FloatArray) -> FloatArray:
        return np.asarray(special.ndtr(z + r) - special.ndtr(z - r) - coverage)

    def slope(r: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-0.5 * (z + r) ** 2) + np.exp(-0.5 * (z - r) ** 2)) / math.sqrt(2.0 * math.pi)

    first = z + float(special.ndtri(0.5 * (1.0 + coverage)))
    return np.asarray(optimize.newton(coverage_beyond, first, slope, tol=1e-12, maxiter=100))


def _rows(given: Given) -> Iterator[Margin]:
    """One- and two-sided limits: of the set's own devices, and with the variance common to all sets."""
    for quantity in given.samples:
        for way, (coverage, confidence) in product(given.ways(quantity), LIMITS):
            several = ", several samples with a common variance" if way.name == V_COMMON else ""
            share, sure = 100 * coverage, 100 * confidence
            for form, factor_of, covered in (
                ("one-sided", one_sided, {LOW: "above it", HIGH: "below it"}),
                ("two-sided", two_sided, dict.fromkeys((LOW, HIGH), "between both limits")),
            ):
                factor = factor_of(way.n_mean, coverage, confidence, degrees=way.degrees)
                for law, side in product((LOGNORMAL, NORMAL) if way.name == V_UNKNOWN else (LOGNORMAL,), (LOW, HIGH)):
                    purpose = f"{share:.0f} % of devices lie {covered[side]}, with a confidence of {sure:.0f} %"
                    kind = f"tolerance {share:.0f}/{sure:.0f} {form}, {law}, {way.name}"
                    words = {"clause": f"{CLAUSE}, {form}{several}", "purpose": purpose}
                    yield given.limit(quantity, TOLERANCE, kind, way, factor, law, side, **words)


CODE = Code("iso16269_6", _rows, 2)
