"""New Zealand practice for sliding hinge joints: dependable and overstrength factors phi and phi_o.

V_ss = n_b n_s mu N_tf; phi V_ss is dependable, phi_o V_ss is what beam, column and welds are designed for. phi = 0.70
and phi_o = 1.40 are recalled from the literature on asymmetric friction connections of 2012 to 2014 (shims of
Bisalloy 400 and harder); they could not be read again. Equivalents from tests stand beside them: the force delivered
at any speed up to the highest tested, phi the smallest plateau of the first and of the later runs, phi_o the largest
force of all, over the nominal. Few devices say less than the practice that rests on many, so an equivalent on the
unsafe side of it carries a warning; so does one on the other side, where the tests do not support practice.
"""

from collections.abc import Iterator

from shj_bayes.errors import PopulationError
from shj_bayes.margins.codes.code import Code, Given
from shj_bayes.margins.spread import HIGH, LOW, Margin, Origin

PRACTICE_PHI, PRACTICE_PHI_O = 0.70, 1.40
"""Values in use for high-hardness shims (Bisalloy 400 and harder), recalled from the AFC literature of 2012-14."""


def equivalent_factors(low: float, high: float, nominal: float) -> tuple[float, float]:
    """Return phi = X_5% / nominal and phi_o = X_95% / nominal; refuses a nominal value that is not above zero."""
    if nominal <= 0:
        raise PopulationError(f"a nominal sliding force must be above zero; got {nominal:g} kN")
    return low / nominal, high / nominal


def warning(value: float, side: str) -> str:
    """Say in the cell of an equivalent on which side of practice it lies.

    On the unsafe side few devices promise more than practice does; on the other the tests do not support practice, so
    that its value would be unsafe.
    """
    practice, word = (PRACTICE_PHI, "above") if side == LOW else (PRACTICE_PHI_O, "below")
    if value == practice:
        return ""
    unsafe = (value > practice) is (side == LOW)
    return f"{word} {practice:.2f} of practice" if unsafe else f"{practice:.2f} not supported"


def _rows(given: Given) -> Iterator[Margin]:
    basis = given.basis
    force, nominal = basis.force, basis.nominal_kN
    phi, phi_o = equivalent_factors(force.first_low, force.high, nominal)
    found = [("phi equivalent, first run", LOW, phi, force.first_low, "dependable sliding force phi V_ss")]
    if force.later_low is not None:
        later, purpose = "phi equivalent, after a first earthquake", "dependable sliding force in a second earthquake"
        found.append((later, LOW, force.later_low / nominal, force.later_low, purpose))
    purpose = "overstrength: capacity design of beam, column and welds"
    found.append(("phi_o equivalent", HIGH, phi_o, force.high, purpose))
    for kind, side, value, force_kN, purpose in found:
        formula = f"{force.level(side)} % of the delivered force / nominal"
        inputs = f"{force_kN:.4g} kN, nominal {nominal:.4g} kN ({basis.nominal_words}); {force.words}"
        note = f"practice for hardened shims: phi {PRACTICE_PHI:.2f}, phi_o {PRACTICE_PHI_O:.2f}"
        origin = Origin("NZ practice for sliding hinge joints", formula, inputs, purpose, note, warning(value, side))
        yield given.of_force(kind, side, value, "1", origin)


CODE = Code("nz", _rows, 5)
