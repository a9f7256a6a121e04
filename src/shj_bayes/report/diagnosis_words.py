"""What a diagnosis page says: rows of its tables and its sentences, as plain values."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError
from shj_bayes.model.coordinates import coordinate_named, coordinates
from shj_bayes.model.device import meaning_of
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.model.history import PREFIX
from shj_bayes.model.parameters import base_of
from shj_bayes.recording.limits import CHANNEL_GAP
from shj_bayes.report import words
from shj_bayes.report.words import ForceUnit, unit_for
from shj_bayes.results.device import DiagnosisData
from shj_bayes.results.diagnosis import (
    FEWEST_CYCLES,
    NOTHING_MISSING,
    SIGMA_90,
    DependenceId,
    DependenceRecord,
    DiagnosisRecord,
    DiagnosisVerdict,
    DrawsInShort,
    EffectParameter,
    EffectRecord,
    Location,
)


def number(value: float | None) -> float:
    """Return a number of a record; nan where there is none."""
    return math.nan if value is None else value


# Word and sign first; the colour only repeats them.
VERDICTS = {
    DiagnosisVerdict.ADEQUATE: ("✓", "holds", "The model describes these recordings: nothing beyond noise was found."),
    DiagnosisVerdict.NAMED: ("●", "part", "The model left something out, and these recordings say what it is."),
    DiagnosisVerdict.FAMILY: (
        "◐",
        "part",
        "The model left something out; these recordings cannot tell which of a family it is.",
    ),
    DiagnosisVerdict.UNKNOWN: ("?", "failed", "The model left something out that no effect of the catalogue explains."),
}
FAMILIES = {
    "even_in_position": "alike on both sides of mid-stroke",
    "low_speed": "at low speed",
    "start_of_stroke": "after a reversal",
    "end_of_stroke": "at the end of the stroke",
    "slow_change": "changing slowly",
    "even_in_direction": "push and pull differ",
    "odd_in_position": "growing to one side",
    "oscillation": "oscillation",
}
DIRECTIONS = {"push": "push", "pull": "pull", "both": "push and pull alike"}
COORDINATES = {  # where what is said of a dependence is not the title of a coordinate
    "speed_by_travel": "the speed, in a way that changes with the distance slid",
    "heat": "the heat that sliding has left",
    "direction": "the direction of motion",
    "constant": "nothing that was varied: it is constant",
    "slack": "a clearance",
    "second surface": "a second sliding surface",
    "compliance": "an elastic part in series",
    "delay": "a delay of the force channel",
    "reversal": "the rule at reversals",
    "stick-slip": "stick and slip",
}
ACTS = {"capacity": "sliding force", "added": "added force"}  # what a dependence acts on; else the motion
NOT_DETERMINED = "not determined"
LIKELY, LIMIT = 0.5, 0.05  # probabilities from which a dependence is stated, and mentioned


def title_of(name: str) -> str:
    """Plain name of an effect, the id itself where the catalogue does not know it."""
    effect, over = catalogue().get(name), over_words(name)
    if effect is None and over != name:
        return f"Sliding force follows {over}"
    return effect.title if effect else name


def titles(names: Sequence[str]) -> str:
    """Plain names of effects in a row."""
    return "; ".join(map(title_of, names))


def over_words(name: str) -> str:
    """Say on what the force depends: a coordinate, or a further channel; the word itself where neither is known."""
    if name in COORDINATES:
        return COORDINATES[name]
    return coordinate_named(name).title if name in coordinates() or name.startswith(PREFIX) else name


def along_words(name: str) -> str:
    """Say along what the curve of a dependence is drawn."""
    one = coordinates().get(name)
    return one.title if one else over_words(name)


def channel_words(record: DiagnosisRecord) -> list[str]:
    """Say of each further channel that the force was held against it without a dependence, or why it was not."""
    found = {c.coordinate for c in record.coordinates if c.probability >= LIKELY}
    out = []
    for c in record.channels:
        share = percent(c.share)
        why = {
            "missing": f"{share} of the runs are without it; name its column for every run",
            "gaps": f"a gap in it is {share} of a run, and only {percent(CHANNEL_GAP)} are bridged; fill it in, or cut "
            "the recording there",
            "constant": f"it is constant within its noise, which is {share} of the variance of its smoothed values",
            "follows_force": f"the measured force explains {share} of its variance, so it is a reaction to the force, "
            "such as a second load cell, and no cause of it",
        }.get(str(c.refused))
        if why is not None:
            out.append(f"The force was not held against the measured {c.name}: {why}.")
        elif c.range and c.coordinate not in found:
            span = f"{words.short(c.range[0])} to {words.short(c.range[1])} {c.unit}".strip()
            out.append(f"The force was held against the measured {c.name} ({span}): it does not follow it.")
    return out


def verdict_words(record: DiagnosisRecord) -> tuple[str, str, str]:
    """Sign, class of the colour and sentence of a verdict; two cycles that show nothing prove nothing."""
    sign, colour, sentence = VERDICTS[record.verdict]
    if record.verdict == DiagnosisVerdict.FAMILY and record.nothing_missing > 0.0:
        sentence = "The model may have left something out; these recordings cannot tell whether it did."
    cycles = record.heldout.n_blocks
    if record.verdict == DiagnosisVerdict.ADEQUATE and cycles < FEWEST_CYCLES:
        few = f"{cycles} cycle{'s' * (cycles != 1)}"
        return "?", "part", f"Nothing beyond noise was found, but {few} are too few to say that nothing is missing."
    return sign, colour, sentence


def sentences(record: DiagnosisRecord) -> list[str]:
    """Say what a diagnosis found, the verdict left out: each mechanism, what it may also be, what has no name."""
    out, verdict, nothing = [], record.verdict, record.nothing_missing
    for e in record.effects:
        # Of several effects the first screen names each; their causes stand where each is described. What may be
        # another effect has no cause yet, and nothing to be done about it.
        told = len(record.effects) == 1 and verdict == DiagnosisVerdict.NAMED and e.cause
        open_ = verdict == DiagnosisVerdict.FAMILY and (e.rivals or nothing)
        lead = "A part of it: " if e.partial else "Most probable: " if open_ else ""
        out.append(spaced(f"{lead}{e.statement}{f' Likely cause: {e.cause}' if told else ''}"))
    if verdict == DiagnosisVerdict.FAMILY:
        members = [f"{title_of(m.id).lower()} ({percent(m.probability)})" for m in record.family]
        members += [f"{NOTHING_MISSING} ({percent(nothing)})"] if nothing else []
        lead = "Not excluded" if record.effects and len(members) == 1 else "These recordings cannot tell"
        out.append(f"{lead}: {', or '.join(members)}.")
    for c in record.coordinates:
        if not c.matches and c.probability >= LIKELY:
            out.append(f"{curve_words(c)} No known mechanism has this curve.")
    for one in record.heldout.dropped:
        of, errors = DependenceId.read(one.class_), (number(one.without_kN), number(one.with_kN))
        told = f" ({' to '.join(map(words.short, errors))} kN)" if all(map(math.isfinite, errors)) else ""
        out.append(
            f"Excluded: a dependence of the {ACTS.get(of.action, 'motion')} on {over_words(of.coordinate)} fits these "
            f"recordings, but does not improve cycles that were left out{told}."
        )
    out += fluctuation_words(record) + channel_words(record)
    if verdict == DiagnosisVerdict.UNKNOWN:
        if (left := record.left_over_percent or 0.0) >= 1.0:
            out.append(f"What is left beside what was found reaches {per_cent(left / 100)} % of the sliding force.")
        out += [record.unknown.words] if record.unknown and record.unknown.words else []
    gamma = record.shift.get("gamma")
    if gamma and record.modelled:
        before, after = (f"{stage.mean:+.4f}" for stage in (gamma.before, gamma.after))
        if float(before) != float(after):
            out.append(f"Including this changes gamma from {before} to {after} s/mm.")
    return [*out, f"Next test: {record.next_test}"] if record.next_test else out


def shift_lines(record: DiagnosisRecord) -> list[str]:
    """Say, as lines of a terminal, what the parameters are without and with what was found, and the held-out error."""
    # Where nothing was added to the law there is one law and one set of numbers.
    stages = ("before", "after") if record.modelled else ("after",)
    rough = ", a first look: approximate, and not the numbers of a fit" if record.quick else ""
    lines = [f"  {' -> '.join(stages) if len(stages) > 1 else 'base law'}{rough}"]
    forces = unit_for(record.shift["Fy"].after.mean if "Fy" in record.shift else None)
    for name, row in record.shift.items():
        unit, factor = forces.of(meaning_of(name).unit)
        shown = " -> ".join(
            f"{NOT_DETERMINED:24}"
            if undetermined(name, own)
            else f"{own.mean * factor:11.5g} +- {own.sd * factor:<9.2g}"
            for own in (getattr(row, stage) for stage in stages)
        )
        lines.append(f"  {name:8}{shown} {unit}")
    errors = " -> ".join(words.short(getattr(record, stage).heldout_rmse_kN * forces.factor) for stage in stages)
    return [*lines, f"  error on held-out cycles {errors} {forces.name}.{worse_words(record)}"]


def undetermined(name: str, row: DrawsInShort) -> bool:
    """Whether a parameter that is above zero is known to no better than its own size."""
    return name.partition("_")[0] in ("K", "Fy", "beta") and row.sd >= abs(row.mean)


def worse_words(record: DiagnosisRecord) -> str:
    """Warn of what describes the recording and predicts cycles that were left out worse than the law alone."""
    worse = record.after.heldout_rmse_kN > record.before.heldout_rmse_kN
    return " Larger: what was found does not carry over to cycles that it did not see." if worse else ""


def way_words(c: DependenceRecord) -> str:
    """Say in which direction a dependence has a curve of its own; nothing where one curve holds in both."""
    return {"push": " in push", "pull": " in pull"}.get(c.direction, "")


def curve_words(c: DependenceRecord) -> str:
    """Say on what the force depends, and by how much."""
    what = {"capacity": "The sliding force", "added": "An added force"}.get(c.action, "The motion")
    size = c.range_percent
    over = f"every {c.period:.3g} {c.unit}, again and again" if c.period is not None else "over what was tested"
    much = f": it changes by {per_cent(size / 100)} % of Fy {over}" if size is not None else ""
    return f"{what}{way_words(c)} depends on {over_words(c.coordinate)}{much}."


def fluctuation_words(record: DiagnosisRecord) -> list[str]:
    """Say what a force that fluctuates by more than noise can may be, and what would tell."""
    return [
        f"The force fluctuates within a stroke by {per_cent(number(c.size_percent) / 100)} % of the sliding "
        "force, more than the noise of a load cell. Surfaces that stick and jump do that, and so does a frame that "
        "swings. Effects below a fifth of it cannot be told. Sample at 20 times the frequency of the jumps, and lower "
        "the speed or stiffen the grip: stick-slip changes with both."
        for c in record.coordinates
        if record.verdict == DiagnosisVerdict.UNKNOWN
        and (c.action, c.coordinate) == ("motion", "stick-slip")
        and not any(e.id in c.matches for e in record.effects)
    ]


def limits_words(data: DiagnosisData) -> str:
    """Say what is not excluded where nothing was found."""
    open_ = [c for c in data.record.coordinates if c.probability >= LIMIT]
    if data.record.verdict != DiagnosisVerdict.ADEQUATE or not open_:
        return ""
    named = (f"{over_words(c.coordinate)} ({percent(c.probability)})" for c in open_)
    return f"Not excluded: a dependence on {', '.join(named)}."


def unit_of(data: DiagnosisData) -> ForceUnit:
    """Choose the unit in which the page shows forces."""
    return unit_for(data.capacity_kN)


def spaced(text: str) -> str:
    """Put the space between a number and its per cent sign that the rest of the page has."""
    return re.sub(r"(?<=\d)%", " %", text)


def size_words(data: DiagnosisData) -> str:
    """Say how much the law misses, and what is left when what was found is added."""
    before, after = data.record.before.rmse_kN, data.record.after.rmse_kN
    text = (
        f"The base law misses the force by {unit_of(data).shown(before)} in root mean square "
        f"({per_cent(before / data.capacity_kN)} % of the sliding force)"
    )
    if not data.changed:
        return f"{text}."
    return f"{text}; with what was found, by {unit_of(data).shown(after)}."


def p_words(p: float) -> str:
    """Say a p value as a chance."""
    return "below 0.001" if p < 1e-3 else f"{p:.2g}"


def chance_words(record: DiagnosisRecord) -> str:
    """Say how probable such a misfit is by chance; nothing where something else than that decided the verdict."""
    p = record.p_value
    return "" if record.verdict != DiagnosisVerdict.ADEQUATE and p >= LIMIT else p_words(p)


def cards(data: DiagnosisData) -> list[dict[str, str]]:
    """Give the numbers of the first screen: parameters before and after, held-out error, chance."""
    record, force, rows, out = data.record, unit_of(data), shift_rows(data), []

    def card(what: str, before: str, after: str, unit: str, note: str) -> None:
        out.append({"what": what, "before": before if data.changed else "", "after": after, "unit": unit, "note": note})

    for name in ("gamma", "Fy"):
        if row := rows.get(name):
            note = f"Spread {spread(row['before'])} before, {spread(row['after'])} after."
            if not data.changed:
                said = dep(row["after"])
                note = f"{said[:1].upper()}{said[1:]}." if name == "gamma" else f"Spread {spread(row['after'])}."
            card(f"{name}: {row['meaning']}", value(row["before"]), value(row["after"]), row["unit"], note)
    before, after = (words.short(stage.heldout_rmse_kN * force.factor) for stage in (record.before, record.after))
    # Where no effect takes up the whole, the scatter about the law holds the misfit too: it must not pass for noise.
    misfit = record.verdict == DiagnosisVerdict.UNKNOWN
    noise = f"Noise: {force.shown(record.after.noise_kN)}."
    noise = "This holds what no effect explains, beside the noise." if misfit else noise
    card("Error on cycles that were held out", before, after, force.name, noise + worse_words(record))
    if chance := chance_words(record):
        note = "An upper limit, corrected for everything that was tried. Small: something is missing."
        card("Chance of so large a misfit if nothing were missing", "", chance, "", note)
    return out


def effect_size(data: DiagnosisData, effect: EffectRecord) -> str:
    """Say how large an effect is beside the sliding force of the law that it acts in: that with what was found."""
    whole = data.record.shift["Fy"].after.mean if "Fy" in data.record.shift else 0.0
    whole = whole if data.changed and whole > 0 else data.capacity_kN
    return "not known" if effect.size_kN is None else f"up to {with_share(effect.size_kN, whole, unit_of(data))}"


def with_share(kN: float | None, whole: float, force: ForceUnit) -> str:
    """Write a force in the unit of the page, and as a percentage of `whole`, the sliding force in kN."""
    return f"{force.shown(number(kN))}, {per_cent(number(kN) / whole)} % of the sliding force"


def shift_rows(data: DiagnosisData) -> dict[str, dict[str, Any]]:
    """Give meaning, unit, before, after and change of each parameter, in the units that are shown.

    The change is in per cent, but of gamma, which may be 0, the difference. A name that this version does not know has
    neither meaning nor unit.
    """
    force, out = unit_of(data), {}
    for name, shift in data.record.shift.items():
        try:
            known = meaning_of(name)
            meaning, unit = known.meaning, "" if known.unit == "1" else known.unit
        except ModelError:
            meaning, unit = "", ""
        before, after = (force.row(EffectParameter(**vars(own), unit=unit)) for own in (shift.before, shift.after))
        moved, share = after.mean - before.mean, base_of(name) != "gamma" and before.mean != 0
        size, form, least = (100 * moved / before.mean, "+.1f", 0.05) if share else (moved, "+.2g", 5e-5)
        change = f"{size:{form}}{' %' * share}" if abs(size) >= least else "none"
        if undetermined(name, before) or undetermined(name, after):
            change = "not known"
        row = {"meaning": meaning, "unit": force.of(unit)[0], "change": change}
        out[name] = row | {"before": before, "after": after}
    return out


def parameter_rows(data: DiagnosisData, effect: EffectRecord) -> dict[str, EffectParameter]:
    """Give the parameters of an effect in the units that are shown; an empty unit where it has none."""
    rows = {name: replace(row, unit="" if row.unit == "1" else row.unit) for name, row in effect.parameters.items()}
    return {name: unit_of(data).row(row) for name, row in rows.items()}


def span_words(where: Location) -> str:
    """Say between which values of a coordinate, or in which runs, the base law fails."""
    low, high = where.interval
    if where.coordinate == "run":
        return ", ".join(str(i) for i in range(math.ceil(low), math.ceil(high)))
    return f"{words.short(low)} to {words.short(high)} {where.unit}".removesuffix(" 1")


def heldout_words(data: DiagnosisData) -> str:
    """Say how much better held-out cycles are predicted."""
    h = data.record.heldout
    gain, error = h.elpd_gain, h.se
    text = (
        f"Held out ({h.scheme.replace('_', ' ')}; {h.n_blocks} cycles): a cycle is predicted by a law that was fitted "
        "without it."
    )
    if not data.changed:
        return f"{text} Nothing was added to the law, so there is nothing to gain."
    if gain < 0:
        return (
            f"{text} With what was found these predictions are worse: log predictive density {gain:.0f}, standard "
            f"error {error:.0f}. It describes these recordings and may not hold beyond them."
        )
    sure = "far more" if gain > 5 * error else "more" if gain > 2 * error else "not clearly more"
    return (
        f"{text} With what was found these predictions are better, by {sure} than chance: log predictive density "
        f"+{gain:.0f}, standard error {error:.0f}."
    )


def shape_columns(shape: Sequence[Mapping[str, float | None]]) -> dict[str, FloatArray]:
    """Give the shape of what no effect explains, rows of names and numbers, as columns; none where it cannot be drawn.

    The first column is the coordinate.
    """
    rows = list(shape)
    columns = {name: np.array([number(row.get(name)) for row in rows]) for name in rows[0]} if len(rows) > 1 else {}
    if len(columns) < 2 or not np.isfinite(next(iter(columns.values()))).all():
        return {}
    return columns


def percent(share: float | None) -> str:
    """Return a share as per cent."""
    p = number(share)
    if not math.isfinite(p):
        return "not known"
    return "below 1 %" if 0 < p < 0.005 else f"{100 * p:.0f} %"


def per_cent(share: float) -> str:
    """Return a share times 100 to two digits, without exponents."""
    if not math.isfinite(share):
        return "not known"
    return f"{100 * share:.2g}" if abs(share) < 0.1 else f"{100 * share:.0f}"


def more_words(error: float) -> str:
    """Say by how many per cent a model misses the measured energy."""
    if abs(error) < 0.05:
        return "the measured energy to better than 0.1 %"
    return f"{abs(error):.1f} % {'more' if error > 0 else 'less'} energy than was measured"


def value(row: DrawsInShort, key: str = "mean") -> str:
    """Mean, or another value, with the digits that its spread makes meaningful."""
    return words.rounded(number(getattr(row, key)), row.sd)


def spread(row: DrawsInShort) -> str:
    """Return a standard deviation to two digits."""
    return words.rounded(row.sd, row.sd)


def dep(row: DrawsInShort) -> str:
    """Say the 90 % interval of gamma as dep."""
    if row.q05 is None or row.q95 is None:
        return words.dep_words(row.mean - SIGMA_90 * row.sd, row.mean + SIGMA_90 * row.sd)
    return words.dep_words(row.q05, row.q95)
