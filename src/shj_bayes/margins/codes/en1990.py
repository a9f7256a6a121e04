"""EN 1990 Annex D, D7.2 and D7.3: characteristic and design values by testing.

The factors are those of the predictive distribution of one more device under a vague prior (the basis of Tables D1
and D2), computed instead of looked up: the printed tables round and, at n = 20, truncate. Table D1 was checked against
a public implementation, Table D2 against memory (both in the tests).

V, when not known from prior knowledge, is to be assumed no smaller than 0.10, and a conservative estimate taken as
known is preferred to "V unknown": D7.1 as remembered. The text of the clause could not be read here; check it against
your edition. "Known" means known from elsewhere than these tests, so it is stated by the user with a reason
(``--v-known``, ``--v-reason``) and never taken from a posterior of the same tests.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

from scipy import special

from shj_bayes.errors import PopulationError
from shj_bayes.margins.codes.code import Code, Given
from shj_bayes.margins.spread import HIGH, LOGNORMAL, LOW, NORMAL, TESTING, Margin, Spread, sd_of_log

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
    _check(n, math.inf)
    return float(-special.ndtri(fractile) * math.sqrt(1.0 + 1.0 / n))


def factor_unknown(n: float, fractile: float = CHARACTERISTIC, degrees: float | None = None) -> float:
    """k_n, k_d,n with the coefficient of variation taken from tests: t(degrees) sqrt(1 + 1/n).

    The degrees of freedom of the spread are n - 1 from the same devices (Tables D1 and D2), more when it is pooled over
    several sets.
    """
    nu = n - 1 if degrees is None else degrees
    _check(n, nu)
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


def _rows(given: Given) -> Iterator[Margin]:
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


def _check(n: float, degrees: float) -> None:
    if n < 1 or degrees < 1:
        raise PopulationError(
            f"EN 1990 Annex D needs a device for the mean and two for the spread; got {n:g} with {degrees:g} degrees "
            "of freedom. Test more, or take the spread of several sets together"
        )


CODE = Code("en1990", _rows, 1)
