"""Bounds of the force by factors: ASCE/SEI 7, EN 15129 with EN 1998-2, and New Zealand practice.

ASCE/SEI 7, 18.2.4: property modification factors of damping devices, and the two bounds of the force.

lambda_max = [1 + 0.75 (lambda_ae,max - 1)] lambda_test,max lambda_spec,max, and the same for the lower bound; 18.2.4.5
sets the least spread. The text of the standard could not be read here (public copies showed only their first page):
formula, the 0.75 and the limits 1.2 and 0.85 for dampers are given from knowledge of it. Check them against your
edition.

The nominal property is the force of the third cycle of the first run. What happened to it in the tests (first cycle,
travel, later runs, speed, whatever else) stands in lambda_test: smallest plateau and largest force of all runs over
that third cycle. It is the larger change of two, that of a typical device and that of the 5 (95) % devices, so that
lambda_test x lambda_spec reaches the force that 95 % of new devices deliver even where devices wear differently.

EN 15129 with EN 1998-2 Annex J: upper and lower bound design properties.

Bound = X x product over the influences of lambda_fi, with lambda_fi = 1 + (lambda_extreme,fi - 1) psi_fi, psi_fi
0.90, 0.70 and 0.60 for importance classes III, II and I; influences f1 ageing, f2 temperature, f3 contamination, f4
cumulative travel. Neither standard could be read here: this is given from knowledge of them. Check it against your
edition.

psi allows for extremes that do not happen all at once. A loss that was measured has happened, so psi does not shrink
it: X is the smallest plateau (largest force) of all runs of the test, which holds travel (f4) and speed in full; of
ageing (f1) the measured middle counts in full, and psi acts on what lies between it and the 5 (95) % end of what is
known.

New Zealand practice for sliding hinge joints: dependable and overstrength factors phi and phi_o.

V_ss = n_b n_s mu N_tf; phi V_ss is dependable, phi_o V_ss is what beam, column and welds are designed for. phi = 0.70
and phi_o = 1.40 are recalled from the literature on asymmetric friction connections of 2012 to 2014 (shims of
Bisalloy 400 and harder); they could not be read again. Equivalents from tests stand beside them: the force delivered
at any speed up to the highest tested, phi the smallest plateau of the first and of the later runs, phi_o the largest
force of all, over the nominal. Few devices say less than the practice that rests on many, so an equivalent on the
unsafe side of it carries a warning; so does one on the other side, where the tests do not support practice.
"""

from collections.abc import Iterator, Sequence

from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import Bounds, Environment, SlidingForceBounds
from shj_bayes.margins.codes.code import Code, Given
from shj_bayes.margins.spread import HIGH, LOW, MIDDLE, Margin, Origin

CLAUSE = "ASCE 7 18.2.4"
ADJUSTMENT = 0.75
"""Share of the environmental factor that is taken: not all extremes happen at once."""
FLOOR = (0.85, 1.2)
"""Least spread of (lower, upper) that must be assumed for a damper."""


def modification(environment: Bounds, testing: Bounds, specification: Bounds) -> Bounds:
    """Lambda = [1 + 0.75 (lambda_ae - 1)] lambda_test lambda_spec, for either bound."""
    return Bounds(
        (1.0 - ADJUSTMENT * (1.0 - environment.low)) * testing.low * specification.low,
        (1.0 + ADJUSTMENT * (environment.high - 1.0)) * testing.high * specification.high,
    )


def with_floor(bounds: Bounds) -> Bounds:
    """Bounds no narrower than the standard's least spread."""
    return Bounds(min(bounds.low, FLOOR[0]), max(bounds.high, FLOOR[1]))


def specification(force: SlidingForceBounds, nominal_kN: float) -> Bounds:
    """Device to device: 5 and 95 % of the third cycle over the nominal force."""
    return Bounds.around(force.third_low / nominal_kN, force.third_high / nominal_kN)


def testing(force: SlidingForceBounds) -> Bounds:
    """First cycle, travel, later runs and speed: what the tests did to the force of the third cycle."""
    change = force.low / force.third_low, force.high / force.third_high
    return Bounds.around(force.typical.low, force.typical.high, *change)


def _asce7(given: Given) -> Iterator[Margin]:
    basis, nominal = given.basis, given.basis.nominal_kN
    origin = Origin("ASCE 7, NZ practice", basis.nominal_words, f"{nominal:.4g} kN", "what the factors below multiply")
    yield given.of_force("nominal sliding force", MIDDLE, nominal, "kN", origin)
    spec, test = specification(basis.force, nominal), testing(basis.force)
    total = modification(basis.age.measured, test, spec)
    factors = (spec, test, basis.age.measured, total, with_floor(total))
    yield from _of_bound(given, LOW, [factor.low for factor in factors])
    yield from _of_bound(given, HIGH, [factor.high for factor in factors])


def _of_bound(given: Given, side: str, factors: Sequence[float]) -> Iterator[Margin]:
    """Factors of the lower or upper bound (specification, tests, ageing, all, all with the floor), and its force."""
    basis, force, nominal = given.basis, given.basis.force, given.basis.nominal_kN
    spec, test, age, both, final = factors
    if side == LOW:
        word, bound, what, floor = "min", "lower", "smallest plateau", "not above"
        reached, third, sign = force.low, force.third_low, "1 - 0.75 (1 - ae)"
    else:
        word, bound, what, floor = "max", "upper", "largest force", "not below"
        reached, third, sign = force.high, force.third_high, "1 + 0.75 (ae - 1)"
    limit, level = FLOOR[side == HIGH], force.level(side)
    rows = (
        (f"lambda_spec,{word}", spec, f"{level} % of a new device, third cycle of the first run / nominal",
         ("1", f"{force.third_low:.4g} to {force.third_high:.4g} kN", "manufacturing: device to device"), CLAUSE),
        (f"lambda_test,{word}", test, f"{what} of all runs over the third cycle: typical device, or the "
         f" {level} % devices where those change more",
         ("1", f"{force.words}; {level} % devices {reached:.4g} / {third:.4g} kN",
          "first cycle, cumulative travel, later runs and speed in the tests"), CLAUSE),
        (f"lambda_ae,{word}", age, "corroded / uncorroded, typical devices",
         ("1", basis.age.words, "ageing and environment: corrosion only"), CLAUSE),
        (f"lambda_{word}", both, f"({sign}) x test x spec",
         ("1", f"ae {age:.3f}, test {test:.3f}, spec {spec:.3f}", "factor on the nominal force, before the floor"),
         CLAUSE),
        (f"lambda_{word} with the floor for dampers", final, f"{floor} {limit:g}",
         ("1", f"{both:.3f}", f"{bound}-bound analysis"), f"{CLAUSE}.5"),
        (f"ASCE 7 {bound} bound force", final * nominal, f"lambda_{word} x nominal",
         ("kN", f"{final:.3f} x {nominal:.4g} kN ({basis.nominal_words})", f"{bound}-bound analysis"), CLAUSE),
    )  # fmt: skip
    for kind, value, formula, (unit, inputs, purpose), clause in rows:
        yield given.of_force(kind, side, value, unit, Origin(clause, formula, inputs, purpose))


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


def _en15129(given: Given) -> Iterator[Margin]:
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


def _nz(given: Given) -> Iterator[Margin]:
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


CODES = (Code("asce7", _asce7, 3), Code("en15129", _en15129, 4), Code("nz", _nz, 5))
