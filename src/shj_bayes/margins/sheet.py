"""All margins of a population in one sheet: two numbers first, then bands, codes, and where the width comes from."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import (
    DEFAULT,
    DEGRADATION,
    RANK,
    SIDES,
    PredictiveDevices,
    design_basis,
    force_ends,
    is_part,
    least_favourable,
    own_devices,
    predictive_devices,
    priors_that_count,
)
from shj_bayes.margins.codes.code import Given, catalogue
from shj_bayes.margins.history import LoadingHistory, channel_words, published_factors
from shj_bayes.margins.spread import (
    BANDS,
    DESIGN,
    FACTORS,
    HIGH,
    LOW,
    MIDDLE,
    MORE,
    NOT_NORMAL,
    SPREAD,
    TESTING,
    TOLERANCE,
    USE,
    Key,
    Margin,
    Origin,
    Sample,
    between_sets,
    common_spread,
    of_set,
    samples,
    spreading_more,
)
from shj_bayes.margins.uses import uses
from shj_bayes.margins.virtual_test import CyclePoint, VirtualTestResult, over_amplitude
from shj_bayes.model.parameters import base_of
from shj_bayes.options import PLAIN, MarginOptions
from shj_bayes.population.device import RangeTested
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult, QuantityPosterior, fit_population
from shj_bayes.population.predict import never_tested_words, sets_suffice
from shj_bayes.population.quantities import HIGHEST, LEAST, LOWEST, MOST, THIRD_CYCLE
from shj_bayes.population.quantities import quantity as described
from shj_bayes.results.campaign import Connection

POOLED = "partially pooled model, decision 0004"
OWN_TEST = "the test that each device went through"
DRIFT, CAPACITY = "for drift and displacement", "for capacity design"
NOMINAL = "nominal sliding force"
EXTRAPOLATED = "extrapolated, not tested"
Samples = Mapping[str, Mapping[str, Sample]]
"""Devices by quantity and set."""


LAWS_PART = 1.1
"""Greatest over least force by the laws of what was not tested, from which on no code value is given."""
PURPOSE = {
    LOW: "lower bound: displacement and drift demand",
    MIDDLE: "best estimate: first analysis",
    HIGH: "upper bound: forces on beam, column, welds and bolts",
}
SERVICE = {(LOW, q): ", slip at service loads" for q in (LOWEST, LEAST)}  # these hold at every speed
LOSS = {
    LOW: "least loss of sliding force to count on",
    MIDDLE: "best estimate of the loss of sliding force after a first earthquake",
    HIGH: "greatest loss of sliding force to allow for in a second earthquake",
}


@dataclass(frozen=True)
class Sheet:
    """Margins of a population."""

    rows: tuple[Margin, ...] = field(repr=False)  # set by set, quantity by quantity
    history: str  # displacement history that the devices were driven through, in words
    tested: RangeTested | None  # amplitudes and speeds that every device went through; None where not known
    extrapolated: bool  # whether the history leaves what was tested
    # sets that page and terminal tell of: those asked for, else all that were tested and, where these are enough to say
    # anything of it, one never tested
    spoken: tuple[str, ...]
    n_sets: int  # sets that were tested
    warnings: tuple[str, ...]  # what to mind, one sentence each
    diagnoses: tuple[str, ...] = ()  # what the diagnoses found, device by device
    tests: tuple[VirtualTestResult, ...] = field(repr=False, default=())  # the devices of the sets that it holds
    withheld: str = ""  # why it gives no code values; empty where it does
    fastest_mm_s: float = math.nan  # bounds hold for every peak speed of a stroke from standstill to this one
    reliability: float = SIDES[HIGH]  # share of new devices within a bound of the force
    connections: Mapping[str, Connection] = field(repr=False, default_factory=dict)  # as tested, by set
    lifts: str = ""  # which tests would let an extrapolated history stand
    together: int | None = None  # connections that act together; None where none were asked for

    @property
    def share(self) -> str:
        """Share of new devices within a bound."""
        return f"{100.0 * self.reliability:.4g} %"

    @property
    def holds(self) -> str:
        """For which speeds the two numbers hold."""
        fastest = f"{self.fastest_mm_s:.3g} mm/s" if self.fastest_mm_s > 0 else "the highest tested"
        return f"at every speed from standstill to {fastest}"

    @property
    def untested(self) -> str:
        """Why nothing is said of a set that was never tested; empty where something is, or where none was asked for."""
        held = {row.set_name for row in self.rows}
        return never_tested_words(self.n_sets) if ANY_SET in held - set(self.spoken) else ""

    @cached_property
    def over_amplitude(self) -> tuple[CyclePoint, ...]:
        """Effective stiffness and damping of the devices over the amplitude."""
        return over_amplitude(self.tests)

    @cached_property
    def by_key(self) -> dict[Key, Margin]:
        """Margins by set, quantity, kind and side."""
        return {row.key: row for row in self.rows}


def pool(
    tests: Sequence[VirtualTestResult],
    result: PopulationResult,
    *,
    progress: bool = False,
    known: Mapping[str, Mapping[str, QuantityPosterior]] | None = None,
) -> PopulationResult:
    """Pool the design quantities of devices after their virtual test, with tags and seed of `result`.

    What an earlier call found is `known`, by prior and quantity.
    """
    if not tests:
        raise PopulationError("no device gives all of K, Fy, beta and gamma; there are no margins without them")
    tags = {group.name: group.tags for group in result.sets}
    devices = [test.estimate(tags[test.set_name]) for test in tests]
    design = fit_population(devices, seed=result.seed, progress=progress, brief=True, known=known)
    design = replace(design, tested=result.tested)
    if known is not None or not any(test.carried for test in tests):
        return design

    def wider(label: str, fits: Mapping[str, QuantityPosterior]) -> dict[str, QuantityPosterior]:
        """Add the error that a model had in its own test to the level of each set.

        It is common to all devices of a rig: as one more error of each device it would average out.
        """
        out = {}
        for q, fit in fits.items():
            rng = np.random.default_rng([design.seed, *label.encode(), *q.encode()])
            mu = fit.mu.copy()
            for i, name in enumerate(design.set_names):
                gaps = [t.model_errors[q] for t in tests if t.set_name == name and q in t.model_errors]
                if gaps:
                    mu[:, i] += float(np.sqrt(np.mean(np.square(gaps)))) * rng.standard_normal(mu.shape[0])
            out[q] = replace(fit, mu=mu)
        return out

    others = {label: wider(label, fits) for label, fits in design.other_priors.items()}
    return replace(design, posteriors=wider(DEFAULT, design.posteriors), other_priors=others)


def margins(
    design: PopulationResult,
    tests: Sequence[VirtualTestResult],
    request: MarginOptions = PLAIN,
    *,
    asked: LoadingHistory | None = None,
    words: Sequence[str] = (),
    connections: Mapping[str, Connection] | None = None,
    lifts: str = "",
) -> Sheet:
    """Draw up the margins of a population from its pooled design quantities and the devices behind it.

    `asked` is the history of the virtual test, None for the devices' own; `words` say what the diagnoses found,
    `connections` what was tested, by set, `lifts` which tests would let a history stand that leaves what was tested.
    """
    n_sets = len(design.sets)
    # Of a set never tested the files keep numbers that are mostly assumption until enough sets were tested.
    spoken = request.sets or ((*design.set_names, ANY_SET) if sets_suffice(n_sets) else design.set_names)
    own = tuple(test for test in tests if ANY_SET in spoken or test.set_name in spoken)
    apart = max((test.laws_apart for test in own), default=1.0)
    laws = next((test.laws for test in own if len(test.laws) > 1), ())
    withheld = f"withheld: the laws of what was not tested part by a factor of {apart:.2g}" if apart > LAWS_PART else ""
    tested = math.nan if design.tested is None else design.tested.fastest_mm_s
    fastest = tested if asked is None else max(tested, float(asked.motion.speed_mm_s.max()))
    history = OWN_TEST if asked is None else asked.words
    said = connections or {}
    by_set = {group.name: samples(group) for group in design.sets}
    together = {q: {name: own[q] for name, own in by_set.items() if q in own} for q in design.posteriors}
    wider = {q: spreading_more(of_sets) for q, of_sets in together.items()}
    drawn_up = _rows(design, own, request, said, together, wider)
    rows = tuple(_as_tested(row, history, withheld, laws) for row in drawn_up)
    compared, contradictions = agreement([row for row in rows if row.set_name in spoken], request.probability)
    warnings = (
        *(() if asked is None else asked.found),
        *contradictions,
        *_warnings(design, request, spoken, asked, laws, together, wider),
        *channel_words([test.channels for test in own], own_test=asked is None),
        compared,
    )
    head = (rows, history, design.tested, bool(laws), spoken, n_sets, warnings, tuple(words), own, withheld, fastest)
    return Sheet(*head, request.probability, said, lifts if laws else "", request.connections)


def _as_tested(row: Margin, history: str, withheld: str, laws: Sequence[str]) -> Margin:
    """Say of the two numbers what history they are of and whether it was tested; hold code values back if laws part."""
    if row.method == USE and laws:
        return replace(row, warning=EXTRAPOLATED)
    if row.method == DESIGN:
        row = replace(row, inputs=f"{history}; {row.inputs}")
        purpose = f"to see how far laws may part ({', '.join(laws)}): no value for design"
        return replace(row, purpose=purpose, warning=EXTRAPOLATED) if laws else row
    if withheld and row.method in (TESTING, TOLERANCE, FACTORS):
        return replace(row, value=math.nan, note=withheld, warning="")
    return row


def _rows(
    result: PopulationResult,
    tests: Sequence[VirtualTestResult],
    request: MarginOptions,
    connections: Mapping[str, Connection],
    together: Samples,
    wider: Mapping[str, Collection[str]],
) -> Iterator[Margin]:
    common = {q: common_spread(list(of_sets.values())) for q, of_sets in together.items()}
    for name in request.sets or (*result.set_names, ANY_SET):
        devices = predictive_devices(result, name)
        third = float(np.median([t.third_mm_s for t in tests if name in (ANY_SET, t.set_name)] or [math.nan]))
        basis = design_basis(result, name, devices, request.stated_nominal, third, request.probability)
        if name == ANY_SET:  # the sets are the sample
            each = {q: between_sets(list(of_sets.values())) for q, of_sets in together.items() if of_sets}
            n = {q: sum(sample.n for sample in together[q].values()) for q in each}
        else:
            own = {q: of_sets[name] for q, of_sets in together.items() if name in of_sets}
            each = {q: (s, of_set(s, common[q], MORE if name in wider[q] else "")) for q, s in own.items()}
            n = {q: sample.n for q, sample in own.items()}
        own, spreads = {q: sample for q, (sample, _) in each.items()}, {q: ways for q, (_, ways) in each.items()}
        given = Given(name, own, spreads, n, basis, request)
        yield from _first(given)
        yield from uses(given, result, devices, connections.get(name, Connection()))
        found = list(bands_of_set(result, name, devices, n))
        found += [row for code in catalogue() for row in code.rows(given)]
        yield from found
        yield from (_degradation(row) for row in found if row.quantity == "ratio" and row.method != BANDS)
        if name != ANY_SET:
            yield from _spreads(result, name, [t for t in tests if t.set_name == name])


def bands_of_set(
    result: PopulationResult, set_name: str, devices: PredictiveDevices, n_devices: Mapping[str, int]
) -> Iterator[Margin]:
    """Bands of a new device of a set: the default prior of the spread, with few devices the outermost of all.

    `n_devices` are those behind each quantity. No force passes one that it is a part of (`force_ends`).
    """
    forces = force_ends(devices, n_devices)
    for quantity, draws in devices[DEFAULT].draws.items():
        of_ratio = quantity == DEGRADATION
        source = "ratio" if of_ratio else quantity
        own, unit = own_devices(result, set_name, (source,)), described(source).unit
        count = len(priors_that_count(tuple(devices), own))
        for side, level in SIDES.items():
            by_prior = {label: d.ordered(quantity).with_error(level) for label, d in devices.items()}
            listed = "; ".join(f"{value:.4g} under the prior '{label}'" for label, (value, _) in by_prior.items())
            value, error = least_favourable(by_prior, side, own)
            notes = []
            if count > 1 and side != MIDDLE:
                notes.append(f"outermost of {count} priors of the spread: the set has {own} devices of its own")
            if (held := forces.get((quantity, side), (value,))[0]) != value:
                notes.append(f"by itself {value:.4g} {unit}, held within those of all runs")
            origin = (
                "predictive distribution, decision 0004",
                f"{100 * level:.0f} % quantile over draws of set level and spread",
                f"{draws.size} draws; {listed}",
                (LOSS if of_ratio else PURPOSE)[side] + SERVICE.get((side, base_of(source)), ""),
            )
            head = (set_name, quantity, BANDS, f"new device, {100 * level:.0f} %", side, held, unit)
            n = n_devices.get(source, 0)
            yield Margin(*head, n, math.nan, *origin, "; ".join(notes), monte_carlo_error=error)


def _first(given: Given) -> Iterator[Margin]:
    """Give the one number for drift and the one for capacity design."""
    force = given.basis.force
    age = f"as tested: ageing is in the ASCE 7 and EN 15129 bounds alone ({given.basis.age.words})"
    for kind, side, value, what in (
        (DRIFT, LOW, force.low, "smallest plateau force of all runs (quantity lowest), at any speed"),
        (CAPACITY, HIGH, force.high, "largest force of all runs (quantity highest), at any speed"),
    ):
        purpose, said = PURPOSE[side] + SERVICE.get((side, LOWEST), ""), f"{force.level(side)} % of the {what}"
        origin = Origin("predictive distribution, decision 0006", said, force.words, purpose, age)
        yield given.of_force(kind, side, value, "kN", origin, DESIGN)


def _spreads(result: PopulationResult, name: str, tests: Sequence[VirtualTestResult]) -> Iterator[Margin]:
    """Where the width of a band comes from: device to device, within a device, model (EN 1990 D8)."""
    index = result.index(name)
    for q, fit in result.posteriors.items():
        within = [test.errors[q] for test in tests if q in test.errors]
        gaps = np.array([test.model_errors[q] for test in tests if q in test.model_errors])
        cycles = np.concatenate([np.empty(0), *(test.cycle_errors for test in tests)])
        least = float(np.sqrt(np.mean(np.square(within)))) if within else math.nan
        found = [
            (POOLED, "device to device", float(np.median(fit.tau[:, index])), "median of the spread of the set",
             "how much devices differ"),
            (POOLED, "within a device", least, "posterior of each device and reading of its recording",
             "how well a tested device is known"),
        ]  # fmt: skip
        half_cycles = f"measured over predicted plateau of {cycles.size} half-cycles, each predicted without it"
        for logs, where, said in (
            (gaps, "", "measured over predicted"),
            (cycles if q == "plateau" and cycles.size > 1 else np.empty(0), " of a half-cycle left out", half_cycles),
        ):
            if logs.size:
                bias, scatter = float(np.exp(logs.mean())), float(logs.std(ddof=1)) if logs.size > 1 else math.nan
                found += [
                    ("EN 1990 D8", f"model, b{where}", bias, f"mean of {said}", "bias of the model"),
                    ("EN 1990 D8", f"model, V_delta{where}", scatter, f"scatter of {said}", "error of the model"),
                ]
        for clause, kind, value, formula, purpose in found:
            note = "one device tells no scatter" if math.isnan(value) else ""
            origin = (clause, formula, f"{len(within)} devices", purpose, note)
            yield Margin(name, q, SPREAD, kind, MIDDLE, value, "1", len(within), math.nan, *origin)


def _degradation(row: Margin) -> Margin:
    """1 - ratio: the low side of the ratio is the high side of the degradation."""
    side = {LOW: HIGH, HIGH: LOW, MIDDLE: MIDDLE}[row.side]
    return replace(
        row,
        quantity=DEGRADATION,
        side=side,
        value=1.0 - row.value,
        formula=f"1 - ratio; {row.formula}",
        inputs=f"of the ratio: {row.inputs}",
        note=row.note.replace(NOT_NORMAL, "more than all: the normal law does not suit so wide a spread"),
        purpose=LOSS[side],
    )


def _warnings(
    result: PopulationResult,
    request: MarginOptions,
    spoken: Sequence[str],
    asked: LoadingHistory | None,
    laws: Sequence[str],
    together: Samples,
    wider: Mapping[str, Mapping[str, tuple[float, float]]],
) -> Iterator[str]:
    """Say what limits the use of the margins: what was taken as known, what was not tested, where tests are too few."""
    tested = result.tested
    if request.v_known is not None:
        yield (
            f"V = {request.v_known:g} of the sliding force, of every run, is taken as known in values by testing (EN "
            f"1990, ISO 16269-6), because: {request.v_reason}. Bands of a new device and factors do not use it."
        )
    if laws and asked is not None:
        speed = float(asked.motion.speed_mm_s.max())
        yield (
            f"EXTRAPOLATED: {asked.words} was NOT tested. Its forces are the outermost of laws that agree with the "
            f"tests and stay bounded ({', '.join(laws)}). "
            + (published_factors(speed) if tested is None or not tested.holds_speed(speed) else "")
        )
    if tested is not None and tested.one_speed:
        yield (
            f"All cycles had nearly one peak speed ({tested.slowest_mm_s:.3g} to {tested.fastest_mm_s:.3g} mm/s): "
            "speed dependence and a loss of friction away from mid-stroke cannot be told apart; gamma may "
            "be either."
        )
    if request.sets:
        yield (
            "Drawn up for what --set names alone. How much devices of a set differ is learnt from all sets that were "
            f"tested ({len(result.sets)}); without --set the sheet holds them all."
        )
    told = []
    for name in spoken:
        found = [(p, times, q) for q, sets in wider.items() for times, p in [sets.get(name, (0.0, math.nan))] if times]
        if found:
            _, times, q = min(found)
            values, unit = together[q][name].values, described(q).unit
            seen = f"{q} {values.min():.3g} to {values.max():.3g}{'' if unit == '1' else f' {unit}'}"
            told.append(f"{name} {times:.1f} times as much ({seen}; so in {len(found)} quantities)")
    if told:
        yield (
            f"The sets do not spread alike (F test of each against all others): {', '.join(told)}. EN 1990 and ISO "
            "16269-6 values with the spread common to all sets are too narrow for these and too wide for the others; "
            "take the bands of a new device, which allow for it."
        )
    counts = [n for name, n in zip(result.set_names, result.fit(THIRD_CYCLE).n_devices, strict=True) if name in spoken]
    if few := sum(n < 3 for n in counts):
        which = f"{few} of {len(counts)} sets rest" if len(counts) > 1 else "The set rests"
        yield (
            f"{which} on one or two devices. The smallest and largest of two hold 90 % "
            "of all devices with a confidence of only 1 %: two devices are not a band. Three devices of a "
            "set, tested alike, give EN 1990 X_k from their own spread, four X_d as well."
        )
    if f"{MOST}_2" not in result.posteriors:
        yield "No device has a second run, so nothing is said of a second earthquake."


SLACK = 0.02
"""Share of the typical value by which two numbers may differ before they count as contradicting: noise of draws."""


def agreement(rows: Sequence[Margin], reliability: float = SIDES[HIGH]) -> tuple[str, tuple[str, ...]]:
    """Compare the bounds of every set with each other and with the bands of a new device.

    Bounds of another reliability than that of the bands are held against them on the side on which they must lie.
    Gives what was compared, in words, and every contradiction in a sentence with both numbers.
    """
    names = list(dict.fromkeys(row.set_name for row in rows))
    by_set = {name: [row for row in rows if row.set_name == name] for name in names}
    found = [text for name, own in by_set.items() for text in _disagreements(name, own, reliability)]
    sets = f"{len(names)} set{'s' * (len(names) != 1)}"
    words = (
        f"Compared in {sets}: the two numbers with the 5 % end of the smallest plateau and the 95 % end of the largest "
        "force of all runs, which they are; these, and the bound forces of the codes (ASCE 7, LBDP, UBDP), with the "
        "same ends of the smallest plateau, mean plateau, third cycle and largest force of every run, and each of "
        "these with those that it is a part of; lower with upper bounds; low, middle and high value of every other "
        f"margin. {f'{len(found)} contradict.' if found else 'None contradict.'} Values by testing (EN 1990, ISO "
        "16269-6) are of one quantity each, and may pass one another."
    )
    return words, tuple(found)


def _disagreements(name: str, rows: Sequence[Margin], reliability: float) -> Iterator[str]:
    forces = [row for row in rows if row.method in (FACTORS, DESIGN) and row.unit == "kN"]
    lower, upper = ([row for row in forces if row.side == side] for side in (LOW, HIGH))
    ends = [row for row in rows if row.method == BANDS and base_of(row.quantity) in RANK]
    lows, highs = ([row for row in ends if row.side == side and reliability >= SIDES[HIGH]] for side in (LOW, HIGH))
    pairs = [(bound, end) for bound in lower for end in (*lows, *upper)]
    pairs += [(end, bound) for bound in upper for end in highs]
    pairs += [(a, b) for a in ends for b in ends if a.side == b.side and is_part(a.quantity, b.quantity)]
    two = [row for row in forces if row.method == DESIGN and reliability == SIDES[HIGH]]
    own = {(LOWEST, LOW), (HIGHEST, HIGH)}  # the two numbers are what they are said to be
    same = [(row, e) for row in two for e in ends if (e.quantity, e.side) in own and row.side == e.side]
    pairs += [p for row, e in same for p in ((row, e), (e, row))]
    scale = max((abs(row.value) for row in rows if row.quantity == "third" and row.side == MIDDLE), default=0.0)
    ordered = [(lesser, greater, scale) for lesser, greater in dict.fromkeys(pairs)]
    ladder: dict[tuple[str, str], dict[str, Margin]] = {}
    for row in rows:
        kind = "new device" if row.method == BANDS else row.kind
        ladder.setdefault((row.quantity, kind), {})[row.side] = row
    for steps in ladder.values():
        ordered += [(a, b, abs(a.value)) for a, b in pairwise(steps[s] for s in (LOW, MIDDLE, HIGH) if s in steps)]
    for lesser, greater, whole in ordered:
        if lesser.value > greater.value + SLACK * whole:  # NaN, which stands for no value, contradicts nothing
            yield (
                f"CONTRADICTION, {name}: {lesser.kind} ({lesser.quantity}, {lesser.value:.4g} {lesser.unit}) lies "
                f"above {greater.kind} ({greater.quantity}, {greater.value:.4g} {greater.unit}). Use neither before it "
                "is settled"
            )
