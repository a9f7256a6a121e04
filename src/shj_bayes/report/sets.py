"""The numbers of a campaign page: sets side by side, new devices, comparisons. Nothing is drawn here."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from shj_bayes.margins.curves import CurveContrast
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.population.compare import ALONE, FEWEST, LEVEL, MOST, Contrast, Direction, direction_of
from shj_bayes.population.hierarchy import ANY_SET, DeviceSet, PopulationResult
from shj_bayes.population.predict import (
    RUN_FORCES,
    SECOND_RUN,
    LoopBand,
    loop_band,
    new_device,
    new_device_table,
    sets_suffice,
)
from shj_bayes.population.quantities import ASSUMED, HIGHEST, QUANTITIES, band_of

MEANING = {
    "Fy": "sliding force at standstill, first run",
    SECOND_RUN: "sliding force at standstill, second run",
    "ratio": "second run / first run",
    **{force: f"sliding force at standstill, run {force[-1]}" for force in RUN_FORCES if force != SECOND_RUN},
    **{ratio: f"run {ratio[-1]} / first run" for ratio in RUN_FORCES.values() if ratio != "ratio"},
    "K": "initial stiffness",
    "gamma": "speed coefficient 1/dep",
    "beta": "sharpness of the knee",
    "plateau": "mean plateau force as tested, first run",
    HIGHEST: "largest force of all runs",
    "plateau_2": "mean plateau force, second run",
    "energy": "energy of a cycle, first run",
}
FORCES = ("plateau", HIGHEST, "plateau_2", "energy")
"""What the devices make, compared before their parameters."""
SHOWN = ("Fy", *RUN_FORCES, *RUN_FORCES.values(), "K", "gamma")
MAX_MATRIX, MAX_PAIRS, MAX_LOOPS = 20, 12, 16
NEVER = "a set never tested"
Interval = tuple[float, float, float]


class SetBand(NamedTuple):
    """A new device of one set in one quantity."""

    set_name: str
    n_devices: int  # tested devices that give the quantity
    unit: str
    band: Interval  # 5, 50 and 95 % of a new device
    others: Mapping[str, tuple[float, float]]  # the 90 % band under each other prior of the spread
    # the tested devices; low and high equal the middle where only a point is known
    devices: tuple[tuple[str, Interval], ...]

    @property
    def name(self) -> str:
        """Name of the set in words."""
        return name_of(self.set_name)

    @property
    def widest(self) -> tuple[float, float]:
        """Band that holds the band under every prior."""
        ends = [(self.band[0], self.band[2]), *self.others.values()]
        return min(low for low, _ in ends), max(high for _, high in ends)


def name_of(set_name: str) -> str:
    """Name of a set in words."""
    return NEVER if set_name == ANY_SET else set_name


def title_of(quantity: str) -> str:
    """Name of a quantity above a picture."""
    said = MEANING[quantity].replace(" / ", " over ").removesuffix(" 1/dep")
    return said[0].upper() + said[1:]


def set_bands(
    result: PopulationResult, intervals: Mapping[tuple[str, str], Mapping[str, Interval]] | None = None
) -> dict[str, tuple[SetBand, ...]]:
    """Bands of a new device of every set, by quantity in the order of `SHOWN`.

    The last band of each is that of a set never tested, where enough were tested to say. `intervals` are 90 % intervals
    of the tested devices; their points stand where it says nothing.
    """
    groups, enough = {group.name: group for group in result.sets}, sets_suffice(len(result.sets))
    out: dict[str, tuple[SetBand, ...]] = {}
    table = [row for row in new_device_table(result) if row["quantity"] in SHOWN and (enough or row["set"] != ANY_SET)]
    for row in sorted(table, key=lambda row: SHOWN.index(row["quantity"])):
        name, quantity = row["set"], row["quantity"]
        group, devices = groups.get(name), []
        for index, device in enumerate(group.devices if group else ()):
            known = (intervals or {}).get((name, device), {}).get(quantity)
            if group and (point := known or _point(group, index, quantity)):
                devices.append((device, point))
        band = row["q05"], row["q50"], row["q95"]
        others = {label: (row[f"q05_{label}"], row[f"q95_{label}"]) for label in result.other_priors}
        own = SetBand(name, row["n_devices"], row["unit"], band, others, tuple(devices))
        out[quantity] = (*out.get(quantity, ()), own)
    return out


def _point(group: DeviceSet, index: int, quantity: str) -> Interval | None:
    """Point value of a device in natural units; None where it gives none."""
    if quantity in RUN_FORCES:
        parts = [_point(group, index, part) for part in ("Fy", RUN_FORCES[quantity])]
        value = float(np.prod([part[1] for part in parts if part])) if all(parts) else np.nan
    else:
        points = group.points.get(quantity, ())
        value = float(QUANTITIES[quantity].natural(points[index])) if index < len(points) else np.nan
    return (value, value, value) if np.isfinite(value) else None


def pairs(result: PopulationResult) -> tuple[tuple[str, str], ...]:
    """Pairs of sets worth a sentence: those that differ in one respect only; all pairs when nothing is said of them."""
    sets = result.sets
    apart = {
        (a.name, b.name): sum(getattr(a.tags, f.name) != getattr(b.tags, f.name) for f in fields(a.tags))
        for a, b in combinations(sets, 2)
    }
    fewest = 1 if any(apart.values()) else 0
    # What is treated is named first, so that a sentence reads "corroded against not corroded"; large sets come first.
    size = {group.name: len(group.devices) for group in sets}
    chosen = [(b, a) for (a, b), n in apart.items() if n == fewest]
    return tuple(sorted(chosen, key=lambda pair: -min(size[pair[0]], size[pair[1]]))[:MAX_PAIRS])


TRUSTED = 0.95
TESTS = {"permutation": "the exact permutation", "Welch": "Welch's test"}


PLATEAUS = ("plateau", "plateau_2", "plateau_3")  # mean forces as tested, of the runs


def plain_words(row: Mapping[str, Any], a: str, b: str) -> str:
    """Say in a sentence how much more or less one side slides at as tested; `row` is one of ``contrasts`` in files."""
    run = PLATEAUS.index(row["quantity"]) + 1
    low, middle, high = (100.0 * (row[key] - 1.0) for key in ("q05", "q50", "q95"))
    size = f"{abs(middle):.0f} % {'more' if middle > 0 else 'less'}"
    settled = "settled" if row["direction"] == Direction.SETTLED else "not settled"
    return (
        f"As tested, in run {run}, {a} slides at {size} force than {b} (90 % interval {low:+.0f} to {high:+.0f} %): "
        f"{settled} with {row['n_a']} and {row['n_b']} devices."
    )


def contrast_words(c: Contrast, side_a: str, side_b: str) -> str:
    """Say how two sides differ in one quantity, what their devices showed, how sure that is, and what would decide."""
    seen = "" if c.observed is None else f", observed {_amount(c, c.observed)}"
    between = f"{_amount(c, c.q05)} to {_amount(c, c.q95)}"
    quotient = f"is {_amount(c, c.q50)} times that of {side_b}"
    size = quotient if c.kind == "quotient" else f"differs from {side_b} by {_amount(c, c.q50)}"
    head = f"{side_a}: {c.quantity} ({MEANING.get(c.quantity, c.quantity)}) of a typical device"
    text = f"{head} {size} (90 % interval {between}{seen}); with {c.n_a} and {c.n_b} devices {_verdict(c, between)}."
    text = " ".join(filter(None, (text, _disagreement(c), _pair_by_pair(c))))
    edge = f"{100 * (c.rope[1] - 1):.0f} %" if c.kind == "quotient" else f"{c.rope[1]:.3g} {c.unit}"
    if c.probability_rope > TRUSTED:
        return f"{text} They differ by less than {edge} with a probability of {c.probability_rope:.2f}."
    if c.direction is Direction.SETTLED:
        return text
    count = f"about {c.n_to_decide}" if c.n_to_decide < MOST else f"more than {MOST}"
    return (
        f"{text} A sample of this size finds a true difference of {edge}, the smallest that matters here, with a "
        f"power of {c.power_edge:.2f}; a power of 0.80 takes {count} devices a side (if sets spread nearly alike)."
    )


def _amount(c: Contrast, value: float) -> str:
    """Write a quotient with as many digits, four at most, as tell the ends of its interval apart; a difference."""
    if c.kind != "quotient":
        return f"{value:+.3g} {c.unit}"
    return f"{value:.{next((d for d in (2, 3) if round(c.q05, d) != round(c.q95, d)), 4)}f}"


def _verdict(c: Contrast, between: str) -> str:
    test, p = c.tests.leading(1)
    told = f"{TESTS[test]} gives p = {p:.2g}" if p is not None else "they allow no test that could reach 0.05"
    if c.direction is Direction.SETTLED:
        return f"the direction is settled at 90 %, whatever is assumed of the spread ({told})"
    if c.direction is Direction.ASSUMED:
        left_open = (label for label, (low, high) in c.other_priors.items() if low < c.none < high)
        against = ", ".join(ASSUMED.get(label, f"under the {label} prior") for label in left_open)
        return f"the direction hangs on what is assumed of the spread (not settled {against})"
    if c.direction is Direction.OPEN:
        kind = "a factor of anything from" if c.kind == "quotient" else "anything from"
        return f"the direction is not settled: {kind} {between} is compatible with them"
    opposite = "they showed the opposite" if p is not None and p <= ALONE else told
    why = "a set of one device tells nothing of its own spread" if c.fewest < FEWEST else opposite
    return f"every assumption on the spread that was tried gives this direction, but these devices alone do not ({why})"


def _disagreement(c: Contrast) -> str:
    """Say why a test finds what the posterior leaves open; empty where they agree."""
    test, p = c.tests.leading(1)
    if p is None or p > LEVEL or c.observed is None or c.direction in (Direction.SETTLED, Direction.TRIED):
        return ""
    after = "" if c.holm_p is None else f", {c.holm_p:.2g} after Holm"
    return (
        f"Yet {TESTS[test]} finds a difference (p = {p:.2g}{after}): it takes these devices as they are. The posterior "
        f"draws each set towards the others, the more so the fewer its devices (here from {c.fewest} on) and the more "
        f"these scatter; of the observed {_amount(c, c.observed)} that leaves {_amount(c, c.q50)}."
    )


def _pair_by_pair(c: Contrast) -> str:
    known = [(pair.observed, pair) for pair in c.pairs if pair.observed is not None]
    if len(known) < 2 or c.observed is None:
        return ""
    turned = [(seen, p) for seen, p in known if (seen - c.none) * (c.observed - c.none) < 0]
    if turned:
        listed = ", ".join(f"{p.set_a} over {p.set_b} {_amount(c, seen)}" for seen, p in turned)
        return f"The {len(known)} pairs do not agree in direction; against the mean of all: {listed}."
    ends = (_amount(c, of(seen for seen, _ in known)) for of in (min, max))
    return f"Pair by pair {' to '.join(ends)} was observed."


def multiplicity_words(of_forces: Sequence[Contrast], of_parameters: Sequence[Contrast], n_strata: int) -> str:
    """Say how many comparisons were made at once, by which test of each quantity, and how that is allowed for."""
    over = f", each averaged over {n_strata} pairs of sets alike in all else" if n_strata > 1 else ""
    counts = [f"{len(part)} {word}" for part, word in ((of_forces, "forces"), (of_parameters, "parameters")) if part]
    said = {
        "permutation": "on the exact permutation",
        "Welch": "on Welch's test where so few devices cannot bring the permutation to 0.05 (its least p is beside it)",
    }
    tests = {c.holm_test for c in (*of_forces, *of_parameters)}
    basis = " and ".join(words for name, words in said.items() if name in tests)
    rest = [f"The p-values marked Holm allow for the number in each group; they rest {basis}."] if basis else []
    rest += ["Where neither permutation nor Welch's test can reach 0.05 there is none."] if "" in tests else []
    return (
        f"{' and '.join(counts)} were compared{over}. {' '.join(rest)} The posterior draws the sets towards each "
        "other by itself. Whoever picks among many pairs must divide once more."
    )


def curve_words(curve: CurveContrast) -> str:
    """Say how the force of two sets changes along a coordinate, value by value and all values together."""
    title, unit = coordinate_named(curve.coordinate).title, "" if curve.unit == "1" else f" {curve.unit}"
    said = "; ".join(
        f"{middle:+.1f} % ({low:+.1f} to {high:+.1f}) at {at:.3g}{unit}"
        for at, (low, middle, high) in zip(curve.at, curve.percent, strict=True)
    )
    return (
        f"{curve.set_a} over {curve.set_b} along {title}, both as 1 at {curve.reference:.3g}{unit}: the force of a "
        f"typical device differs by {said}. That the curves are not the same has a probability of "
        f"{curve.probability_other:.2f} under the least favourable assumption on the spread; that they differ by less "
        f"than {100 * curve.rope:.0f} % at all of these values one of {curve.probability_rope:.2f} ({curve.n_a} and "
        f"{curve.n_b} devices)."
    )


def force_matrix(result: PopulationResult) -> list[list[tuple[Interval, bool] | None]]:
    """Force of a typical device of the row's set over that of the column's, and whether its direction is settled.

    The mean plateau force where the forces were pooled, else Fy. Empty when there are too many sets to show, or one.
    """
    n = len(result.sets)
    name = next((q for q in (FORCES[0], "Fy") if q in result.posteriors), "")
    if not (2 <= n <= MAX_MATRIX and name):
        return []
    mu = result.fit(name).mu

    def cell(i: int, j: int) -> tuple[Interval, bool]:
        low, middle, high = (float(v) for v in np.exp(band_of(mu[:, i] - mu[:, j])))
        return (low, middle, high), direction_of(result, name, [([i], [j])]) is Direction.SETTLED

    return [[cell(i, j) if i != j else None for j in range(n)] for i in range(n)]


def loop_bands(result: PopulationResult, amplitude_mm: float, peak_speed_mm_s: float) -> tuple[LoopBand, ...]:
    """Band of the loop of a new device of each set, both runs where both are known, of a set never tested last."""
    out = []
    untested = (ANY_SET,) if sets_suffice(len(result.sets)) else ()
    for name in (*result.set_names[:MAX_LOOPS], *untested):
        device = new_device(result, name)
        if not all(q in device.draws for q in ("K", "Fy", "beta", "gamma")):
            continue
        for run in (1, 2) if SECOND_RUN in device.draws else (1,):
            out.append(loop_band(device, amplitude_mm=amplitude_mm, peak_speed_mm_s=peak_speed_mm_s, run=run))
    return tuple(out)
