"""Limits by a factor on a spread: EN 1990 Annex D and ISO 16269-6.

EN 1990 Annex D, D7.2 and D7.3: characteristic and design values by testing.

The factors are those of the predictive distribution of one more device under a vague prior (the basis of Tables D1
and D2), computed instead of looked up: the printed tables round and, at n = 20, truncate. Table D1 was checked against
a public implementation, Table D2 against memory (both in the tests).

V, when not known from prior knowledge, is to be assumed no smaller than 0.10, and a conservative estimate taken as
known is preferred to "V unknown": D7.1 as remembered. The text of the clause could not be read here; check it against
your edition. "Known" means known from elsewhere than these tests, so it is stated by the user with a reason
(``--v-known``, ``--v-reason``) and never taken from a posterior of the same tests.

ISO 16269-6: statistical tolerance limits, normal populations, one sample or several with a common unknown variance.

The text of the standard could not be read beyond its scope; factors are checked against its exact definitions, printed
tables of others and simulation (in the tests).
Factors k are for limits mean -+ k s. A limit of a log-normal quantity is that of its logarithm, taken back. Numbers of
the standard's own tables come out to the last printed digit, because the factors are exact and not approximations.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
from scipy import optimize, special

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import PopulationError
from shj_bayes.margins.codes.code import Code, Given
from shj_bayes.margins.spread import (
    HIGH,
    LOGNORMAL,
    LOW,
    NORMAL,
    TESTING,
    TOLERANCE,
    V_COMMON,
    V_UNKNOWN,
    Margin,
    Spread,
    sd_of_log,
)

CHARACTERISTIC = 0.05
"""Fractile of a characteristic value, Table D1."""
DESIGN = 0.001
"""Fractile of a design value taken straight from tests, Table D2 (alpha_R beta = 0.8 x 3.8 = 3.04)."""
LEAST_VARIATION = 0.10
"""Least coefficient of variation where it is not known from elsewhere (D7.1)."""
PURPOSE = {
    (CHARACTERISTIC, LOW): "lower characteristic value X_k, to be divided by gamma_m",
    (CHARACTERISTIC, HIGH): "upper characteristic value X_k: never divided by gamma_m, which would lower it",
    (DESIGN, LOW): "lower design value X_d straight from tests, no gamma_m to follow",
    (DESIGN, HIGH): "upper design value X_d straight from tests, no gamma_m to follow",
}
FEWEST = {CHARACTERISTIC: 3, DESIGN: 4}
"""Fewest devices for which Tables D1 and D2 give a factor with the coefficient of variation unknown."""


def factor_known(n: float, fractile: float = CHARACTERISTIC) -> float:
    """k_n, k_d,n with the coefficient of variation known beforehand: z sqrt(1 + 1/n)."""
    _check(n, math.inf, "an EN 1990 value")
    return float(-special.ndtri(fractile) * math.sqrt(1.0 + 1.0 / n))


def factor_unknown(n: float, fractile: float = CHARACTERISTIC, degrees: float | None = None) -> float:
    """k_n, k_d,n with the coefficient of variation taken from tests: t(degrees) sqrt(1 + 1/n).

    The degrees of freedom of the spread are n - 1 from the same devices (Tables D1 and D2), more when it is pooled over
    several sets.
    """
    nu = n - 1 if degrees is None else degrees
    _check(n, nu, "an EN 1990 value")
    return float(-special.stdtrit(nu, fractile) * math.sqrt(1.0 + 1.0 / n))


def floored(way: Spread) -> Spread:
    """Raise a spread that was taken from tests to the least that is allowed for one that is not known."""
    if math.isinf(way.degrees) or way.variation >= LEAST_VARIATION:
        return way
    raised = f"V raised from {way.variation:.3f} to {LEAST_VARIATION:g}: not known beforehand"
    return replace(
        way,
        variation=LEAST_VARIATION,
        sd_log=sd_of_log(LEAST_VARIATION),
        note="; ".join(filter(None, (raised, way.note))),
    )


def _en1990(given: Given) -> Iterator[Margin]:
    """Characteristic and design values, low and high, normal and lognormal, for every way to come by the spread."""
    for quantity in given.samples:
        for fractile, word, clause in (
            (CHARACTERISTIC, "characteristic", "D7.2, Table D1"),
            (DESIGN, "design", "D7.3, Table D2"),
        ):
            for way in map(floored, given.ways(quantity)):
                factor = (
                    factor_known(way.n_mean, fractile)
                    if math.isinf(way.degrees)
                    else factor_unknown(way.n_mean, fractile, way.degrees)
                )
                few = way.degrees < FEWEST[fractile] - 1
                missing = f"{clause} has no factor for n = {way.degrees + 1:.3g} with V unknown" if few else ""
                for law, side in product((LOGNORMAL, NORMAL), (LOW, HIGH)):
                    kind, purpose = f"EN 1990 {word}, {law}, {way.name}", PURPOSE[fractile, side]
                    words = {"clause": f"EN 1990 {clause}", "purpose": purpose, "missing": missing}
                    yield given.limit(quantity, TESTING, kind, way, factor, law, side, **words)


def _check(n: float, degrees: float, what: str) -> None:
    if n < 1 or degrees < 1:
        raise PopulationError(
            f"{what} from {n:g} devices with {degrees:g} degrees of freedom cannot be given: the spread needs two "
            "devices of one set at least; test more, or use the spread of several sets together"
        )


CLAUSE = "ISO 16269-6"
LIMITS = ((0.95, 0.75), (0.95, 0.95), (0.90, 0.95))
"""Coverage and confidence of the limits."""
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(101)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


@cache
def one_sided(n: float, coverage: float, confidence: float, degrees: float | None = None) -> float:
    """Factor of a one-sided limit from n devices, spread unknown: exact, from the noncentral t distribution.

    k = t'(confidence; degrees, z sqrt(n)) / sqrt(n) with z the normal quantile of the coverage. The degrees of freedom
    of the spread are n - 1 when it comes from the same devices, more when it is pooled over several sets.
    """
    nu = n - 1 if degrees is None else degrees
    _check(n, nu, "a tolerance limit")
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
    _check(n, nu, "a tolerance limit")
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


def _iso16269_6(given: Given) -> Iterator[Margin]:
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


CODES = (Code("en1990", _en1990, 1), Code("iso16269_6", _iso16269_6, 2))
