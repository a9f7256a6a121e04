"""What a diagnosis page says: rows of its tables and its sentences, as plain values."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from shj_bayes.errors import ModelError
from shj_bayes.mismatch.schema import Verdict
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.model.device import meaning_of
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.measured import PREFIX
from shj_bayes.model.parameters import FloatArray, base_of
from shj_bayes.recording.limits import CHANNEL_GAP
from shj_bayes.report import words
from shj_bayes.report.diagnosis_data import DiagnosisData, number
from shj_bayes.report.residual_file import FEWEST_CYCLES

# Word and sign first; the colour only repeats them.
VERDICTS = {
    Verdict.ADEQUATE: ("✓", "holds", "The model describes these recordings: nothing beyond noise was found."),
    Verdict.NAMED: ("●", "part", "The model left something out, and these recordings say what it is."),
    Verdict.FAMILY: (
        "◐",
        "part",
        "The model left something out; these recordings cannot tell which of a family it is.",
    ),
    Verdict.UNKNOWN: ("?", "failed", "The model left something out that no effect of the catalogue explains."),
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
COORDINATES = {
    "position": "the position",
    "distance": "the distance from mid-stroke",
    "travel": "the distance travelled",
    "time": "the time",
    "heat": "the heat that sliding has left",
    "amplitude": "the amplitude",
    "slip": "the distance slid since the reversal",
    "speed": "the speed",
    "acceleration": "the acceleration",
    "direction": "the direction of motion",
    "constant": "nothing that was varied: it is constant",
    "slack": "a clearance",
    "second surface": "a second sliding surface",
    "compliance": "an elastic part in series",
    "delay": "a delay of the force channel",
    "reversal": "the rule at reversals",
    "stick-slip": "stick and slip",
}
LIKELY, LIMIT = 0.5, 0.05  # probabilities from which a dependence is stated, and mentioned
SIGMA_90 = 1.6449  # standard deviations to either side that hold 90 % of a normal law


def title_of(name: Any) -> str:
    """Plain name of an effect, the id itself where the catalogue does not know it."""
    effect = catalogue().get(str(name))
    if effect is None and str(name).startswith(PREFIX):
        return f"Sliding force follows {over_words(name)}"
    return effect.title if effect else str(name)


def over_words(name: Any) -> str:
    """Say on what the force depends: a coordinate, or a further channel; the word itself where neither is known."""
    word = str(name)
    return coordinate_named(word).title if word.startswith(PREFIX) else COORDINATES.get(word, word)


def channel_words(record: Mapping[str, Any]) -> list[str]:
    """Say of each further channel that the force was held against it without a dependence, or why it was not.

    Parameters
    ----------
    record : mapping
        Content of ``diagnosis.json``.
    """
    found = {c.get("coordinate") for c in record.get("coordinates") or () if number(c.get("probability")) >= LIKELY}
    out = []
    for c in record.get("channels") or ():
        share = percent(c.get("share"))
        why = {
            "missing": f"{share} of the runs are without it; name its column for every run",
            "gaps": f"a gap in it is {share} of a run, and only {percent(CHANNEL_GAP)} are bridged; fill it in, or cut "
            "the recording there",
            "constant": f"it is constant within its noise, which is {share} of the variance of its smoothed values",
            "follows_force": f"the measured force explains {share} of its variance, so it is a reaction to the force, "
            "such as a second load cell, and no cause of it",
        }.get(str(c.get("refused")))
        if why is not None:
            out.append(f"The force was not held against the measured {c.get('name')}: {why}.")
        elif c.get("range") and c.get("coordinate") not in found:
            low, high = (words.short(number(v)) for v in c["range"])
            unit = f" {c['unit']}" if c.get("unit") else ""
            span = f"{low} to {high}{unit}"
            out.append(f"The force was held against the measured {c.get('name')} ({span}): it does not follow it.")
    return out


def verdict_words(record: Mapping[str, Any]) -> tuple[str, str, str]:
    """Sign, class of the colour and sentence of a verdict; two cycles that show nothing prove nothing."""
    sign, colour, sentence = VERDICTS[record["verdict"]]
    cycles = number((record["heldout"] or {}).get("n_blocks"))
    if record["verdict"] == Verdict.ADEQUATE and cycles < FEWEST_CYCLES:
        few = f"{cycles:.0f} cycle{'s' * (cycles != 1)}"
        return "?", "part", f"Nothing beyond noise was found, but {few} are too few to say that nothing is missing."
    return sign, colour, sentence


def sentences(record: Mapping[str, Any]) -> list[str]:
    """Say what a diagnosis found, the verdict left out: each mechanism, what it may also be, what has no name."""
    found, verdict = record["effects"], record["verdict"]
    out = []
    for e in found:
        # Of several effects the first screen names each; their causes stand where each is described. What may be
        # another effect has no cause yet, and nothing to be done about it.
        told = len(found) == 1 and verdict == Verdict.NAMED and e.get("cause")
        cause = f" Likely cause: {e['cause']}" if told else ""
        lead = (
            "A part of it: "
            if e.get("partial")
            else "Most probable: "
            if verdict == Verdict.FAMILY and e.get("rivals")
            else ""
        )
        out.append(spaced(f"{lead}{e['statement']}{cause}"))
    if verdict == Verdict.FAMILY:
        members = [f"{title_of(m.get('id')).lower()} ({percent(m.get('probability'))})" for m in record["family"]]
        out.append(f"These recordings cannot tell: {', or '.join(members)}.")
    for c in record.get("coordinates") or ():
        if not c.get("matches") and number(c.get("probability")) >= LIKELY:
            out.append(f"{curve_words(c)} No known mechanism has this curve.")
    out += fluctuation_words(record)
    out += channel_words(record)
    if verdict == Verdict.UNKNOWN:
        left = number(record.get("left_over_percent"))
        if math.isfinite(left) and left >= 1.0:
            out.append(f"What is left beside what was found reaches {per_cent(left / 100)} % of the sliding force.")
        if (record.get("unknown") or {}).get("words"):  # files of schema 1
            out.append(str(record["unknown"]["words"]))
    gamma = record["shift"].get("gamma")
    if gamma and found:
        before, after = gamma["before"]["mean"], gamma["after"]["mean"]
        out.append(f"Including this changes gamma from {before:+.4f} to {after:+.4f} s/mm.")
    if record.get("next_test"):
        out.append(f"Next test: {record['next_test']}")
    return out


def curve_words(c: Mapping[str, Any]) -> str:
    """Say on what the force depends, and by how much."""
    what = {"capacity": "The sliding force", "added": "An added force"}.get(str(c.get("action")), "The motion")
    size = number(c.get("range_percent"))
    period = number(c.get("period"))
    over = f"every {period:.3g} {c.get('unit')}, again and again" if math.isfinite(period) else "over what was tested"
    much = f": it changes by {per_cent(size / 100)} % of Fy {over}" if math.isfinite(size) else ""
    return f"{what} depends on {over_words(c.get('coordinate'))}{much}."


def fluctuation_words(record: Mapping[str, Any]) -> list[str]:
    """Say what a force that fluctuates by more than noise can may be, and what would tell."""
    return [
        f"The force fluctuates within a stroke by {per_cent(number(c.get('size_percent')) / 100)} % of the sliding "
        "force, more than the noise of a load cell. Surfaces that stick and jump do that, and so does a frame that "
        "swings. Effects below a fifth of it cannot be told. Sample at 20 times the frequency of the jumps, and lower "
        "the speed or stiffen the grip: stick-slip changes with both."
        for c in record.get("coordinates") or ()
        if record["verdict"] == Verdict.UNKNOWN and (c.get("action"), c.get("coordinate")) == ("motion", "stick-slip")
    ]


def coordinates(data: DiagnosisData) -> list[dict[str, str]]:
    """Tabulate what the force depends on."""
    out = []
    for c in data.record.get("coordinates") or ():
        evidence, size = number(c.get("evidence")), number(c.get("size_percent"))
        out.append(
            {
                "words": curve_words(c),
                "probability": percent(c.get("probability")),
                "evidence": f"{evidence:+.0f}" if math.isfinite(evidence) else "",
                "size": f"{per_cent(size / 100)} %" if math.isfinite(size) else "",
                "names": "; ".join(title_of(name) for name in c.get("matches") or ()) or "none known",
            }
        )
    return out


def limits_words(data: DiagnosisData) -> str:
    """Say what is not excluded where nothing was found."""
    open_ = [c for c in data.record.get("coordinates") or () if number(c.get("probability")) >= LIMIT]
    if data.record["verdict"] != Verdict.ADEQUATE or not open_:
        return ""
    named = (f"{over_words(c['coordinate'])} ({percent(c['probability'])})" for c in open_)
    return f"Not excluded: a dependence on {', '.join(named)}."


def spaced(text: str) -> str:
    """Put the space between a number and its per cent sign that the rest of the page has."""
    return re.sub(r"(?<=\d)%", " %", text)


def size_words(data: DiagnosisData) -> str:
    """Say how much the law misses, and what is left when what was found is added."""
    before, after = data.record["before"], data.record["after"]
    capacity = data.capacity_kN
    text = (
        f"The base law misses the force by {words.short(number(before.get('rmse_kN')))} kN in root mean square "
        f"({per_cent(number(before.get('rmse_kN')) / capacity)} % of the sliding force)"
    )
    if not data.channels.changed:
        return f"{text}."
    return f"{text}; with what was found, by {words.short(number(after.get('rmse_kN')))} kN."


def p_words(p: Any) -> str:
    """Say a p value as a chance, or that there is none."""
    value = number(p)
    if not math.isfinite(value):
        return "not known"
    return "below 0.001" if value < 1e-3 else f"{value:.2g}"


def chance_words(record: Mapping[str, Any]) -> str:
    """Say how probable such a misfit is by chance; nothing where something else than that decided the verdict."""
    p = number(record["p_value"])
    return "" if record["verdict"] != Verdict.ADEQUATE and p >= LIMIT else p_words(p)


def cards(data: DiagnosisData) -> list[dict[str, str]]:
    """Give the numbers of the first screen: parameters before and after, held-out error, chance."""
    out = []
    for name in ("gamma", "Fy"):
        row = data.record["shift"].get(name)
        if row is None:
            continue
        unit = _unit(name)
        note = f"Spread {spread(row['before'])} before, {spread(row['after'])} after."
        if not data.channels.changed:
            note = f"{_first_up(dep(row['after']))}." if name == "gamma" else f"Spread {spread(row['after'])}."
        out.append(_card(f"{name}: {meaning_of(name).meaning}", value(row["before"]), value(row["after"]), unit, note))
    before, after = (number(data.record[k].get("heldout_rmse_kN")) for k in ("before", "after"))
    floor = words.short(number(data.record["after"].get("noise_kN")))
    # Where no effect takes up the whole, the scatter about the law holds the misfit too: it must not pass for noise.
    misfit = data.record["verdict"] == Verdict.UNKNOWN
    noise = "This holds what no effect explains, beside the noise." if misfit else f"Noise: {floor} kN."
    out.append(_card("Error on cycles that were held out", words.short(before), words.short(after), "kN", noise))
    if not data.channels.changed:
        out = [card | {"before": ""} for card in out]
    if chance := chance_words(data.record):
        note = "An upper limit, corrected for everything that was tried. Small: something is missing."
        out.append(_card("Chance of so large a misfit if nothing were missing", "", chance, "", note))
    return out


def effects(data: DiagnosisData) -> list[dict[str, Any]]:
    """Describe the effects found."""
    out = []
    for e in data.record["effects"]:
        known = catalogue().get(str(e["id"]))
        size = number(e.get("size_kN"))
        # An effect acts on the sliding force that stands beside it in the law: that of the law with what was found.
        whole = number((data.record["shift"].get("Fy") or {}).get("after", {}).get("mean"))
        whole = whole if data.channels.changed and whole > 0 else data.capacity_kN
        out.append(
            {
                "id": e["id"],
                "title": e.get("title") or title_of(e["id"]),
                "family": FAMILIES.get(str(e.get("family")), str(e.get("family") or "not known")),
                "statement": spaced(str(e["statement"])),
                "cause": e.get("cause") or (known.cause if known else ""),
                "shows": e.get("shows") or (known.shows if known else ""),
                "equation": e.get("equation") or "",
                "partial": bool(e.get("partial")),
                "probability": percent(e.get("probability")),
                "size": f"up to {words.short(size)} kN, {per_cent(size / whole)} % of the sliding force"
                if math.isfinite(size)
                else "not known",
                "rivals": [title_of(name) for name in e.get("rivals") or ()],
                "parameters": [
                    {
                        "name": name,
                        "unit": "" if p.get("unit") in (None, "1") else p["unit"],
                        "mean": value(p),
                        "exact": repr(number(p.get("mean"))),
                        "sd": spread(p),
                        "interval": f"{_like(p, 'q05')} to {_like(p, 'q95')}",
                    }
                    for name, p in (e.get("parameters") or {}).items()
                ],
            }
        )
    return out


def family(data: DiagnosisData) -> list[dict[str, str]]:
    """List the members of the family, most probable first."""
    known = catalogue()
    return [
        {
            "id": str(member["id"]),
            "title": title_of(member["id"]),
            "probability": percent(member.get("probability")),
            "shows": known[member["id"]].shows if member["id"] in known else "",
        }
        for member in data.record["family"] or ()
    ]


def shift(data: DiagnosisData) -> list[dict[str, str]]:
    """Tabulate every base parameter before and after."""
    out = []
    for name, row in data.record["shift"].items():
        before, after = row["before"], row["after"]
        gamma = base_of(name) == "gamma"
        moved = number(after.get("mean")) - number(before.get("mean"))
        out.append(
            {
                "name": name,
                "meaning": _meaning(name),
                "unit": _unit(name),
                "before": value(before),
                "before_exact": repr(number(before.get("mean"))),
                "before_sd": spread(before),
                "after": value(after),
                "after_exact": repr(number(after.get("mean"))),
                "after_sd": spread(after),
                "before_dep": dep(before) if gamma else "",
                "after_dep": dep(after) if gamma else "",
                "change": _change(moved, number(before.get("mean")), gamma=gamma),
            }
        )
    return out


def locations(data: DiagnosisData) -> list[dict[str, str]]:
    """Tabulate where the base law fails."""
    out = []
    for where in data.record["location"]:
        low, high = (number(v) for v in where["interval"])
        # Along the motion everywhere on the page; the record keeps the sign of the force for one direction alone.
        size = number(where["size_kN"]) * (-1 if where["direction"] == "pull" else 1)
        unit = "" if where["unit"] == "1" else f" {where['unit']}"
        span = f"{words.short(low)} to {words.short(high)}{unit}"
        if where["coordinate"] == "run":
            span = ", ".join(str(i) for i in range(math.ceil(low), math.ceil(high)))
        out.append(
            {
                "coordinate": where["coordinate"],
                "span": span,
                "direction": DIRECTIONS.get(where["direction"], where["direction"]),
                "runs": ", ".join(str(run) for run in where["runs"]),
                "size": f"{size:+.3g}",
                "exact": repr(size),
                "percent": f"{'+' if size > 0 else ''}{per_cent(size / data.capacity_kN)}",
                "share": percent(where.get("share")),
                "p": p_words(where["p_value"]),
            }
        )
    return out


def aliases(data: DiagnosisData) -> list[dict[str, str]]:
    """Say in words what the displacement history cannot separate."""
    out = []
    for alias in data.record["aliases"]:
        (first, second), correlation = alias["pair"], number(alias.get("correlation"))
        if second == "base law":
            text = f"“{title_of(first)}” cannot be seen: the base law takes it up."
        else:
            text = f"“{title_of(first)}” looks like “{title_of(second)}”"
            text += ": more of the one is like less of the other." if correlation < 0 else "."
        out.append({"ids": f"{first}, {second}", "text": text, "correlation": f"{correlation:+.2f}"})
    return out


def candidates(data: DiagnosisData) -> list[dict[str, str]]:
    """Tabulate every effect tried."""
    return [
        {
            "id": c["id"],
            "title": c.get("title") or title_of(c["id"]),
            "gain": f"{number(c.get('elpd_gain')) + 0.0:+.1f}".replace("-0.0", "0.0").replace("+0.0", "0.0"),
            "exact": repr(number(c.get("elpd_gain"))),
            "probability": percent(c.get("probability")),
            "size": f"{size:.2f}" if (size := number(c.get("size_kN"))) >= 0.005 else "below 0.01",
            "reason": str(c.get("reason") or ""),
            "kept": "kept" if c.get("kept") else "",
        }
        for c in data.record["candidates"]
    ]


def quality(data: DiagnosisData) -> list[dict[str, str]]:
    """Tabulate errors before and after."""
    rows = (
        ("rmse_kN", "Error on all samples (root mean square, kN)"),
        ("heldout_rmse_kN", "Error on cycles that were held out (kN)"),
        ("noise_kN", "Noise floor (kN)"),
        ("energy_error_percent", "Error of the energy of a cycle (mean, %)"),
    )
    before, after = data.record["before"], data.record["after"]
    return [
        {"name": name, "before": words.short(number(before.get(key))), "after": words.short(number(after.get(key)))}
        for key, name in rows
    ]


def heldout_words(data: DiagnosisData) -> str:
    """Say how much better held-out cycles are predicted."""
    h = data.record["heldout"] or {}
    gain, error, blocks = number(h.get("elpd_gain")), number(h.get("se")), number(h.get("n_blocks"))
    scheme = str(h.get("scheme", "not stated")).replace("_", " ")
    many = f", {blocks:.0f} times" if math.isfinite(blocks) else ""
    text = f"Held out ({scheme}{many}): a cycle is predicted by a law that was fitted without it."
    if not math.isfinite(gain):
        return text
    if not data.channels.changed:
        return f"{text} Nothing was added to the law, so there is nothing to gain."
    sure = "far more" if gain > 5 * error else "more" if gain > 2 * error else "not clearly more"
    return (
        f"{text} With what was found these predictions are better, by {sure} than chance: log predictive density "
        f"+{gain:.0f}, standard error {error:.0f}."
    )


def unknown(data: DiagnosisData) -> dict[str, str] | None:
    """Describe what no effect explains."""
    u = data.record.get("unknown")
    if not u:
        return None
    size, period = number(u.get("size_kN")), u.get("period")
    return {
        "coordinate": u.get("coordinate") or "not known",
        "size": f"{words.short(size)} kN, {per_cent(size / data.capacity_kN)} % of the sliding force",
        "formula": u.get("formula") or "",
        "formula_words": u.get("formula_words") or "",
        "period": f"{words.short(number(period['length']))} {period['unit']} of {period['coordinate']}"
        if period
        else "",
        "words": u.get("words") or "",
    }


def shape_columns(shape: Any) -> dict[str, FloatArray]:
    """Give the shape of what no effect explains, rows of names and numbers, as columns; none where it cannot be drawn.

    The first column is the coordinate.
    """
    rows = list(shape or ())
    columns = {name: np.array([number(row.get(name)) for row in rows]) for name in rows[0]} if len(rows) > 1 else {}
    if len(columns) < 2 or not np.isfinite(next(iter(columns.values()))).all():
        return {}
    return columns


def percent(share: Any) -> str:
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


def value(row: Mapping[str, Any]) -> str:
    """Mean with the digits that its spread makes meaningful."""
    return words.rounded(number(row.get("mean")), number(row.get("sd")))


def spread(row: Mapping[str, Any]) -> str:
    """Return a standard deviation to two digits."""
    sd = number(row.get("sd"))
    return words.rounded(sd, sd) if math.isfinite(sd) else "not known"


def dep(row: Mapping[str, Any]) -> str:
    """Say the 90 % interval of gamma as dep."""
    mean, sd = number(row.get("mean")), number(row.get("sd"))
    low, high = number(row.get("q05")), number(row.get("q95"))
    if not (math.isfinite(low) and math.isfinite(high)):
        low, high = mean - SIGMA_90 * sd, mean + SIGMA_90 * sd
    if not (math.isfinite(low) and math.isfinite(high)):
        return "dep not known"
    return words.dep_words({"q05": low, "q95": high})


def _card(what: str, before: str, after: str, unit: str, note: str) -> dict[str, str]:
    return {"what": what, "before": before, "after": after, "unit": unit, "note": note}


def _first_up(text: str) -> str:
    return text[:1].upper() + text[1:]


def _meaning(name: str) -> str:
    """Meaning of a parameter; a name that this version does not know is shown without one."""
    try:
        return meaning_of(name).meaning
    except ModelError:
        return ""


def _unit(name: str) -> str:
    try:
        unit = meaning_of(name).unit
    except ModelError:
        return ""
    return "" if unit == "1" else unit


def _like(row: Mapping[str, Any], key: str) -> str:
    return words.rounded(number(row.get(key)), number(row.get("sd")))


def _change(moved: float, before: float, *, gamma: bool) -> str:
    """Change of a parameter: per cent, but of gamma, which may be 0, the difference."""
    if not math.isfinite(moved):
        return "not known"
    if gamma or before == 0:
        return f"{moved:+.2g}" if abs(moved) >= 5e-5 else "none"
    share = 100 * moved / before
    return f"{share:+.1f} %" if abs(share) >= 0.05 else "none"
