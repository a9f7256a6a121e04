"""EN 15129 with EN 1998-2 Annex J: upper and lower bound design properties.

Bound = X x product over the influences of lambda_fi, with lambda_fi = 1 + (lambda_extreme,fi - 1) psi_fi, psi_fi
0.90, 0.70 and 0.60 for importance classes III, II and I; influences f1 ageing, f2 temperature, f3 contamination, f4
cumulative travel. Neither standard could be read here: this is given from knowledge of them. Check it against your
edition.

psi allows for extremes that do not happen all at once. A loss that was measured has happened, so psi does not shrink
it: X is the smallest plateau (largest force) of all runs of the test, which holds travel (f4) and speed in full; of
ageing (f1) the measured middle counts in full, and psi acts on what lies between it and the 5 (95) % end of what is
known.
"""

from collections.abc import Iterator

from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import Bounds, Environment
from shj_bayes.margins.codes.code import Code, Given
from shj_bayes.margins.spread import HIGH, LOW, Margin, Origin

COMBINATION = {"III": 0.90, "II": 0.70, "I": 0.60}
"""psi_fi by importance class of the structure."""


def combined(factor: float, importance: str = "II") -> float:
    """lambda_fi = 1 + (lambda_extreme,fi - 1) psi_fi, for an upper or a lower extreme that was not measured."""
    if importance not in COMBINATION:
        raise PopulationError(f"importance class {importance!r} is not known; choose I, II or III")
    return 1.0 + (factor - 1.0) * COMBINATION[importance]


def ageing(age: Environment, importance: str = "II") -> Bounds:
    """Take what was measured in full, and what lies beyond it up to the extreme with psi."""
    return Bounds(
        age.measured.low * combined(age.extreme.low / age.measured.low, importance),
        age.measured.high * combined(age.extreme.high / age.measured.high, importance),
    )


LBDP, UBDP = "EN 15129 LBDP", "EN 15129 UBDP"


def kind_of(bound: str, importance: str) -> str:
    """Kind of the lower (`LBDP`) or upper (`UBDP`) bound design property for an importance class."""
    return f"{bound}, importance class {importance}"


def _rows(given: Given) -> Iterator[Margin]:
    basis, importance = given.basis, given.request.importance
    factors = ageing(basis.age, importance)
    for side, supply, factor, word in (
        (LOW, basis.force.low, factors.low, LBDP),
        (HIGH, basis.force.high, factors.high, UBDP),
    ):
        what = "smallest plateau" if side == LOW else "largest force"
        origin = Origin(
            "EN 15129; EN 1998-2 Annex J",
            "X x lambda_f1; travel (f4) and speed are in X as measured, psi on what was not measured",
            f"X = {supply:.4g} kN, {basis.force.level(side)} % of the {what} of all runs ({basis.force.words}); "
            f"ageing {factor:.3f} ({basis.age.words}); psi = {COMBINATION[importance]:g}",
            f"{'lower' if side == LOW else 'upper'} bound design property, one of two analyses",
            "temperature and contamination were not tested and stand as 1",
        )
        yield given.of_force(kind_of(word, importance), side, supply * factor, "kN", origin)


CODE = Code("en15129", _rows, 4)
