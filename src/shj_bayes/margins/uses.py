"""What a designer does with the force of one connection: single events, many connections, bolts, joint, acceptance."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import PredictiveDevices, least_favourable, levels_of, own_devices, reading_error
from shj_bayes.margins.codes.code import Given
from shj_bayes.margins.spread import HIGH, LOW, MIDDLE, USE, Margin
from shj_bayes.options import in_mm
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.quantities import BATCHES, HIGHEST, LOWEST, THIRD_CYCLE, Ordered, quantity, stream
from shj_bayes.results.campaign import Connection

DECISION = "decision 0006"
FIRST, LATER = "in a first event", "in a second event"
SUM, LARGEST = "sum of connections that act together", "largest of connections that act together"
TIGHTENED = "with the tightening tolerance"
PER_BOLT, FRICTION = "per bolt and sliding surface", "effective friction coefficient"
WANTED_BOLTS, WANTED_CLAMPING = "bolts for the force wanted", "clamping of one bolt for the force wanted"
WANTED_CAPACITY = "capacity design with the bolts for the force wanted"
MOMENT, STOREY = "moment at the joint", "storey force of one brace"
PASSES, BATCH_PASSES = "production test passed by one device", "production tests passed by all connections"
TOLERANCE = 0.15
"""By which a production test may lie off the nominal property (EN 15129; ASCE 7 18.6, as remembered)."""
WHAT = {LOW: "smallest plateau", HIGH: "largest force"}
FOR = {LOW: "displacement and drift", MIDDLE: "first analysis", HIGH: "forces on what is connected"}
Number = tuple[float, float]
"""Value and its Monte-Carlo error."""


@dataclass(frozen=True)
class OneSet:
    """What is known of one set."""

    given: Given
    result: PopulationResult
    devices: PredictiveDevices
    connection: Connection

    def row(self, kind: str, side: str, unit: str, number: Number, *origin: str) -> Margin:
        """Row of the force; `origin` is its formula, inputs, purpose and, where there is one, note."""
        value, error = number
        head = (self.given.set_name, "force", USE, kind, side, value, unit, self.given.devices.get(LOWEST, 0), math.nan)
        return Margin(*head, DECISION, *origin, monte_carlo_error=error)

    @property
    def forces(self) -> dict[str, Number]:
        """Bounds of the force of all runs and the nominal force, by side."""
        basis = self.given.basis
        values = {LOW: basis.force.low, MIDDLE: basis.nominal_kN, HIGH: basis.force.high}
        return {side: (value, value * basis.errors.get(side, 0.0)) for side, value in values.items()}

    @property
    def bolts(self) -> int | None:
        """Bolts of the connection as tested."""
        return self.given.request.bolts or self.connection.bolts

    def bolts_for(self, flag: str) -> int | None:
        """Give the bolts that an option needs; None for a set never tested, of which nothing is said then."""
        if self.bolts is None and self.given.set_name != ANY_SET:
            raise PopulationError(
                f"{flag} needs the number of bolts of {self.given.set_name} as tested: --bolts, or bolts in "
                "[set.connection] of the manifest; or leave the set out by --set"
            )
        return self.bolts

    @property
    def surfaces(self) -> int:
        """Sliding surfaces of each bolt; the option goes with bolts of the options."""
        stated = None if self.given.request.bolts else self.connection.surfaces
        return stated or self.given.request.surfaces

    @property
    def clamping_kN(self) -> float | None:
        """Clamping force of one bolt as tested."""
        return self.given.request.clamping_kN or self.connection.clamping_kN


def uses(
    given: Given, result: PopulationResult, devices: PredictiveDevices, connection: Connection
) -> Iterator[Margin]:
    """All rows of one set that are asked for, or that what is known of its connection allows."""
    one = OneSet(given, result, devices, connection)
    for rows in (_events, _together, _of_bolts, _wanted, _at_the_joint, _accepted):
        yield from rows(one)


def _events(one: OneSet) -> Iterator[Margin]:
    """Force of the first run alone, and of those after it."""
    force, errors = one.given.basis.force, one.given.basis.errors
    for kind, low, high, which in (
        (FIRST, force.first_low, force.first_high, "the first run"),
        (LATER, force.later_low, force.later_high, "the later runs"),
    ):
        for side, value in ((LOW, low), (HIGH, high)):
            if value is not None:
                said = f"{force.level(side)} % of the {WHAT[side]} of {which}, at any speed"
                number = (value, value * errors.get(side, 0.0))
                yield one.row(kind, side, "kN", number, said, force.words, f"{FOR[side]} of that event")


def drawn_together(
    result: PopulationResult, device: FloatArray, name: str, prior: str, set_name: str, n: int, own_sd: float = 0.0
) -> FloatArray:
    """Draw `n` devices of one set together, shape (n, n_draws), natural unit: what a project is delivered.

    Level and spread of the set, and what is not known of them, are common to all devices of a draw; the scatter about
    the level, and `own_sd` (of the logarithm), are each device's own. The first is the new device that was drawn
    already (`device`, shape (n_draws,)), so that one connection is what the two numbers are of.
    """
    index = None if set_name == ANY_SET else result.index(set_name)
    level, spread = result.fit(name, prior).level_and_spread(
        index, np.random.default_rng(stream(result.seed, "new device", set_name, name, prior))
    )
    sd = np.hypot(spread, reading_error(result, set_name, name))
    rng = np.random.default_rng(stream(result.seed, "together", set_name, name, prior))
    out = np.empty((n, device.size))
    out[0] = device
    out[1:] = quantity(name).natural(level + sd * rng.standard_normal((n - 1, device.size)))
    return out * np.exp(own_sd * rng.standard_normal(out.shape)) if own_sd else out


def of_many(one: OneSet, side: str, n: int, take: Callable[[FloatArray], FloatArray], own_sd: float = 0.0) -> Number:
    """Bound of what is taken of `n` connections, at the reliability asked for: the least favourable prior that counts.

    As of one connection, a run that fewer devices have gone through than there are counts as well.
    """
    names = [LOWEST if side == LOW else HIGHEST]
    part = {LOW: "least", HIGH: "most"}[side]
    counts = one.given.devices
    names += [q for q in one.result.posteriors if q.partition("_")[0] == part and counts[q] < counts[names[0]]]
    found = []
    for name in names:
        ends = {}
        for label, device in one.devices.items():
            drawn = drawn_together(one.result, device.draws[name], name, label, one.given.set_name, n, own_sd)
            ends[label] = Ordered(take(drawn)).with_error(levels_of(one.given.request.probability)[side])
        found.append(least_favourable(ends, side, own_devices(one.result, one.given.set_name, (name,))))
    return (min if side == LOW else max)(found)


def _together(one: OneSet) -> Iterator[Margin]:
    """Sum and largest of the connections that are asked for, and the effect of the tightening tolerance on one."""
    request, force = one.given.request, one.given.basis.force
    own_sd, said = 0.0, ""
    if request.clamping_cov is not None and (bolts := one.bolts_for("--clamping-cov")):
        own_sd = math.sqrt(math.log1p(request.clamping_cov**2 / bolts))
        said = f"; tightening V = {request.clamping_cov:g} a bolt, / sqrt({bolts}) a connection"
        note = "beside the scatter of the tests, in which the tightening of the laboratory is already"
        for side in (LOW, HIGH):
            number = of_many(one, side, 1, lambda drawn: drawn[0], own_sd)
            formula = f"{force.level(side)} % of the {WHAT[side]} x tightening"
            yield one.row(TIGHTENED, side, "kN", number, formula, f"{force.words}{said}", FOR[side], note)
    if (n := request.connections) is None:
        return
    inputs = f"{n} connections of one delivery: the level of the set is common, the scatter about it is their own{said}"
    note = "smallest plateaus, and largest forces, need not come at the same moment: their sum is on the safe side"
    for kind, take, side, what in (
        (SUM, np.sum, LOW, "drift of the storey"),
        (SUM, np.sum, HIGH, "base shear, foundation"),
        (LARGEST, np.max, HIGH, f"members beside any of {n} connections"),
    ):
        number = of_many(one, side, n, lambda drawn, take=take: take(drawn, axis=0), own_sd)  # type: ignore[misc]
        formula = f"{force.level(side)} % of the {kind.partition(' ')[0]} of {n} x {WHAT[side]}"
        yield one.row(kind, side, "kN", number, formula, inputs, what, note if kind == SUM else "")


def _of_bolts(one: OneSet) -> Iterator[Margin]:
    """Force per bolt and sliding surface, and the friction coefficient that it is of the clamping."""
    if one.bolts is None:
        return
    parts, clamping = one.bolts * one.surfaces, one.clamping_kN
    taken = one.given.request.bolts is None and one.connection.surfaces is None
    said = f"{one.bolts} bolts x {one.surfaces} surfaces{' (taken, not said)' if taken else ''}"
    for side, (value, error) in one.forces.items():
        told = ("force / (bolts x surfaces)", f"{value:.4g} kN / ({said})", FOR[side])
        yield one.row(PER_BOLT, side, "kN", (value / parts, error / parts), *told)
        if clamping is not None:
            whole = parts * clamping
            inputs = f"{value:.4g} kN / ({said} x {clamping:g} kN)"
            note = "of the clamping force stated, which was not measured while it slid"
            told = ("force / (bolts x surfaces x clamping)", inputs, f"{FOR[side]}, by bolts and clamping")
            yield one.row(FRICTION, side, "1", (value / whole, error / whole), *told, note)


def _wanted(one: OneSet) -> Iterator[Margin]:
    """Bolts, or clamping, that the lower force of a connection needs to reach the force wanted."""
    wanted = one.given.request.force_wanted_kN
    if wanted is None or (bolts := one.bolts_for("--force-wanted")) is None:
        return
    (low, low_error), (high, high_error) = one.forces[LOW], one.forces[HIGH]
    n = math.ceil(wanted * bolts / low - 1e-9)
    note = "force in proportion to bolts and clamping: shims, holes and plates as tested"
    inputs = f"{wanted:g} kN, {low:.4g} kN of {bolts} bolts as tested"
    yield one.row(WANTED_BOLTS, LOW, "1", (n, 0.0), "wanted / (lower force / bolts), up", inputs, FOR[LOW], note)
    upper = (high * n / bolts, high_error * n / bolts)
    told = ("upper force x bolts / bolts as tested", f"{high:.4g} kN x {n} / {bolts}", FOR[HIGH])
    yield one.row(WANTED_CAPACITY, HIGH, "kN", upper, *told, note)
    if one.clamping_kN is not None:
        value = one.clamping_kN * wanted / low
        number = (value, value * low_error / low)
        inputs = f"{one.clamping_kN:g} kN x {wanted:g} / {low:.4g} kN"
        told = ("clamping as tested x wanted / lower force", inputs, FOR[LOW])
        yield one.row(WANTED_CLAMPING, LOW, "kN", number, *told, f"{note}; not above the proof load")


def _at_the_joint(one: OneSet) -> Iterator[Margin]:
    """Moment of a joint with its lever arm, storey force of a brace at its angle."""
    request = one.given.request
    arms: list[tuple[str, str, float, str, str]] = []
    if request.lever_arm is not None:
        arm = in_mm(request.lever_arm) / 1000.0
        arms.append((MOMENT, "kNm", arm, "force x lever arm", f"kN x {arm:g} m"))
    if (angle := request.brace_angle_deg) is not None:
        share = math.cos(math.radians(angle))
        arms.append((STOREY, "kN", share, "force x cos angle", f"kN (force of the brace) x cos {angle:g} deg"))
    for side, (value, error) in one.forces.items():
        for kind, unit, factor, formula, inputs in arms:
            number = (value * factor, error * factor)
            yield one.row(kind, side, unit, number, formula, f"{value:.4g} {inputs}", FOR[side])


def _accepted(one: OneSet) -> Iterator[Margin]:
    """Share of devices, and of deliveries, like those tested that pass production tests about the nominal force."""
    nominal, n = one.given.basis.nominal_kN, one.given.request.connections
    for kind, count, who in ((PASSES, 1, "one device"), (BATCH_PASSES, n, f"all of {n}")):
        if count is None:
            continue
        shares: dict[str, Number] = {}
        for label, device in one.devices.items():
            third = device.draws[THIRD_CYCLE]
            drawn = drawn_together(one.result, third, THIRD_CYCLE, label, one.given.set_name, count)
            passed = np.all(np.abs(drawn / nominal - 1.0) <= TOLERANCE, axis=0).astype(np.float64)
            parts = passed[: passed.size // BATCHES * BATCHES].reshape(BATCHES, -1).mean(axis=1)
            shares[label] = float(passed.mean()), float(parts.std(ddof=1) / math.sqrt(BATCHES))
        number = least_favourable(shares, LOW, own_devices(one.result, one.given.set_name, (THIRD_CYCLE,)))
        told = (
            f"share of draws with the third cycle of {who} within {100 * TOLERANCE:g} % of the nominal force",
            f"nominal {nominal:.4g} kN ({one.given.basis.nominal_words})",
            "chance that good devices, like those tested, are accepted (EN 15129; ASCE 7 18.6)",
            "the 15 % are given from knowledge of the codes: check them against your edition",
        )
        yield one.row(kind, LOW, "1", number, *told)
