"""ASCE/SEI 7, 18.2.4: property modification factors of damping devices, and the two bounds of the force.

lambda_max = [1 + 0.75 (lambda_ae,max - 1)] lambda_test,max lambda_spec,max, and the same for the lower bound; 18.2.4.5
sets the least spread. The text of the standard could not be read here (public copies showed only their first page):
formula, the 0.75 and the limits 1.2 and 0.85 for dampers are given from knowledge of it. Check them against your
edition.

The nominal property is the force of the third cycle of the first run. What happened to it in the tests (first cycle,
travel, later runs, speed, whatever else) stands in lambda_test: smallest plateau and largest force of all runs over
that third cycle. It is the larger change of two, that of a typical device and that of the 5 (95) % devices, so that
lambda_test x lambda_spec reaches the force that 95 % of new devices deliver even where devices wear differently.
"""

from collections.abc import Iterator, Sequence

from shj_bayes.margins.basis import Bounds, SlidingForceBounds
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


def _rows(given: Given) -> Iterator[Margin]:
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


CODE = Code("asce7", _rows, 3)
