"""All trials counted: the targets written down in advance, and whether they were met."""

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from shj_bayes.model.effects.effect import catalogue
from shj_validation.proof.score import LIKELY, half_size, rate
from shj_validation.proof.simulators.simulator import simulators_by_id

# Written down before the proof was run; see docs/decisions/0007-proof.md.
FALSE_ALARMS, FALSE_ALARMS_LIMIT = 0.03, 0.05
COORDINATE, RIGHT, RIGHT_TWO, FAMILY = 0.95, 0.93, 0.88, 0.90
WRONG_OUTSIDE, COORDINATE_OUTSIDE = 0.03, 0.80
HELD_OUT, HELD_OUT_90 = 1.1, 1.5  # times the noise floor: in the middle, and in 90 % of the trials
COVERAGE = (0.85, 0.95)
CALIBRATION, IN_BIN = 0.05, 20  # stated and observed may differ by this in every bin that holds as many
FEWEST, TOLD = 10, 0.8  # trials below which nothing is said; lower limit from which a coordinate can be told
SETTINGS = ("protocol", "displacement", "rate_Hz", "noise", "first reading", "reversal")
BINS = (0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0)
RIGHT_OUTCOMES = ("right", "right family")
Row = dict[str, Any]


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Count all trials.

    Parameters
    ----------
    rows : sequence of dict
        From `shj_validation.proof.score.score_trial`.

    Returns
    -------
    dict
        ``targets`` (words, value, aim, verdict), ``false_alarms``, ``power``, ``confusion``, ``outcomes``,
        ``settings``, ``coordinates``, ``reliability``, ``family_holds``, ``adequate``, ``coverage``, ``heldout``.
    """
    done = [row for row in rows if row["outcome"] != "failed"]
    null = [row for row in done if row["kind"] == "nothing"]
    inside = [row for row in done if row["kind"] in ("one", "two")]
    outside = [row for row in done if row["kind"] == "outside"]
    seen = [row for row in inside if row["detectable"]]
    alarms = rate(sum(row["outcome"] == "false alarm" for row in null), len(null))
    right = rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in seen), len(seen))
    single, both = ([row for row in seen if row["kind"] == kind] for kind in ("one", "two"))
    foreign = [row for row in outside if row["detectable"]]
    summary: dict[str, Any] = {
        "failed": [row["number"] for row in rows if row["outcome"] == "failed"],
        "false_alarms": alarms,
        "detected": rate(sum(row["verdict"] != "adequate" for row in seen), len(seen)),
        "right": right,
        "right_single": rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in single), len(single)),
        "right_two": rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in both), len(both)),
        "coordinates": {
            word: _share_of(own, "coordinate_right") for word, own in (("inside", seen), ("outside", foreign))
        },
        "coordinates_by_effect": {
            name: _share_of([row for row in seen if name in row["effects"]], "coordinate_right")
            for name in sorted({name for row in seen for name in row["effects"]})
        },
        "family_holds": _share_of(seen, "family_holds"),
        "adequate": {
            "nothing concealed": rate(sum(row["verdict"] == "adequate" for row in null), len(null)),
            "detectable": rate(
                sum(row["verdict"] == "adequate" for row in [*seen, *foreign]), len(seen) + len(foreign)
            ),
        },
        "reliability": {of: _reliability(done, of) for of in ("coordinate", "name")},
        "right_of_detected": _right_of_detected(inside),
        "outcomes": {
            kind: dict(Counter(_word(row) for row in done if row["kind"] == kind))
            for kind in ("nothing", "one", "two", "outside")
        },
        "unknown_outside": rate(sum(row["outcome"] == "unknown" for row in foreign), len(foreign)),
        "wrong_outside": rate(sum(row["outcome"] in ("wrong", "sibling", "part") for row in foreign), len(foreign)),
        "power": _power(done),
        "confusion": _confusion([row for row in inside if row["kind"] == "one" and row["detectable"]]),
        "coverage": _coverage(done),
        "heldout": _heldout(seen, null),
        "settings": {name: {word: _setting(own) for word, own in _groups(done, name).items()} for name in SETTINGS},
    }
    summary["targets"] = _targets(summary)
    return summary


def _word(row: Row) -> str:
    """Outcome, with what was too small to be seen kept apart."""
    return row["outcome"] if row["detectable"] or row["kind"] == "nothing" else f"{row['outcome']} (too small to see)"


def _groups(rows: Sequence[Row], name: str) -> dict[str, list[Row]]:
    """Trials by one of `SETTINGS`, or by another entry of a row, in order."""
    of: Callable[[Row], Any] = {
        "displacement": lambda row: "at the machine" if row.get("machine_share") else "across the slip",
        "first reading": lambda row: "off by three deviations" if row.get("first_sd") else "like the others",
    }.get(name, lambda row: row[name])
    groups: dict[str, list[Row]] = {}
    for row in sorted(rows, key=of):
        value = of(row)
        groups.setdefault(f"{value:g} Hz" if isinstance(value, float) else str(value), []).append(row)
    return groups


def _setting(rows: Sequence[Row]) -> dict[str, Any]:
    """Count trials of one setting; coordinates of what the catalogue holds, and of what it does not, together."""
    holds = [row for row in rows if row["kind"] != "nothing"]
    seen, null = [row for row in holds if row["detectable"]], [row for row in rows if row["kind"] == "nothing"]
    inside = [row for row in seen if row["kind"] != "outside"]
    coordinate = _share_of(seen, "coordinate_right")
    mistaken = Counter(_mistaken(row) for row in seen if row["coordinate_right"] is False)
    return {
        "n": len(rows),
        "alarms": rate(sum(row["outcome"] == "false alarm" for row in null), len(null)),
        "visible": rate(len(seen), len(holds)),
        "coordinate": coordinate,
        "right": rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in inside), len(inside)),
        "missed": rate(sum(row["verdict"] == "adequate" for row in seen), len(seen)),
        "told": _told(coordinate),
        "mistaken": [{"truth": truth, "answer": said, "n": n} for (truth, said), n in sorted(mistaken.items())],
    }


def _told(coordinate: dict[str, Any]) -> str:
    """Say from the counts whether a coordinate can be told."""
    if coordinate["n"] < FEWEST:
        return "too few to say"
    if coordinate["high"] < COORDINATE:
        return "cannot be told as often as aimed at"
    return "can be told" if coordinate["low"] >= TOLD else "open: within the aim, or not"


def _mistaken(row: Row) -> tuple[str, str]:
    """Give what was concealed, and the coordinates that led the answer."""
    ranked = sorted(row["coordinates"], key=lambda entry: -entry["probability"])
    lead = [e for i, e in enumerate(ranked) if i < len(row["truth"]) or e["probability"] >= LIKELY]
    pairs = sorted({f"{e['action']} over {e['coordinate']}" for e in lead})
    known = simulators_by_id()
    true = (" or ".join(f"{act} over {over}" for act, over in known[name].coordinates) for name in row["truth"])
    words = [f"{name} ({where})" for name, where in zip(row["truth"], true, strict=True)]
    return " + ".join(words), ", ".join(pairs) or "nothing"


def _right_of_detected(rows: Sequence[Row]) -> dict[str, float]:
    raised = [row for row in rows if row["verdict"] != "adequate"]
    return rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in raised), len(raised))


def _share_of(rows: Sequence[Row], name: str) -> dict[str, Any]:
    """Share in which something is true, of the rows that say so or not."""
    said = [row[name] for row in rows if row[name] is not None]
    return rate(sum(said), len(said))


def _reliability(rows: Sequence[Row], of: str) -> list[dict[str, Any]]:
    """Mean of the stated probabilities in each bin, and how many came true."""
    pairs = [(one["probability"], one["true"]) for row in rows for one in row["stated"] if one["of"] == of]
    out = []
    for low, high in itertools.pairwise(BINS):
        own = [(p, true) for p, true in pairs if low <= p < high or (p == high == BINS[-1])]
        mean = float(np.mean([p for p, _ in own])) if own else None
        out.append({"low": low, "high": high, "stated": mean, "true": rate(sum(true for _, true in own), len(own))})
    return out


def _power(rows: Sequence[Row]) -> dict[str, Any]:
    """Count detection against the visible size: all physics together, by family and by effect."""
    have = [row for row in rows if row["kind"] in ("one", "outside")]
    known = catalogue()
    groups: dict[str, dict[str, list[Row]]] = {"by_family": {}, "by_effect": {}}
    for row in have:
        name = row["truth"][0]
        effect = row["effects"][0]
        family = known[effect].family if effect in known else "outside the catalogue"
        groups["by_family"].setdefault(family, []).append(row)
        groups["by_effect"].setdefault(name, []).append(row)
    out: dict[str, Any] = {"all": _curve(have)}
    return out | {by: {name: _curve(own) for name, own in sorted(group.items())} for by, group in groups.items()}


def _curve(rows: Sequence[Row]) -> dict[str, Any]:
    visible = [max(row["visible_share"], 1e-5) for row in rows]
    seen = [row["verdict"] != "adequate" for row in rows]
    sizes = [abs(row["sizes"][0]) for row in rows]
    fit, own = half_size(visible, seen), half_size(sizes, seen)
    return {
        "n": len(rows),
        "visible_share": visible,
        "sizes": sizes,
        "seen": seen,
        "half_seen_at": fit[0] if fit else None,
        "slope": fit[1] if fit else None,
        "half_seen_at_size": own[0] if own else None,
    }


def _confusion(rows: Sequence[Row]) -> dict[str, Any]:
    """Concealed against named, by effect and by family."""
    known = catalogue()
    by_effect = Counter((row["effects"][0], _answer(row)) for row in rows)
    by_family = Counter(
        (known[row["effects"][0]].family, known[a].family if (a := _answer(row)) in known else a) for row in rows
    )
    return {
        "by_effect": [{"truth": t, "answer": a, "n": n} for (t, a), n in sorted(by_effect.items())],
        "by_family": [{"truth": t, "answer": a, "n": n} for (t, a), n in sorted(by_family.items())],
    }


def _answer(row: Row) -> str:
    """Say what the diagnosis answered to a single effect: its name, or adequate, unknown, several."""
    if row["verdict"] in ("adequate", "unknown"):
        return str(row["verdict"])
    if row["outcome"] in RIGHT_OUTCOMES:
        return str(row["effects"][0])
    return row["found"][0] if len(row["found"]) == 1 else "several"


def _coverage(rows: Sequence[Row]) -> dict[str, Any]:
    """Coverage of 90 % intervals: all trials whatever their verdict, those with nothing, those named rightly."""
    named = [row for row in rows if row["outcome"] in RIGHT_OUTCOMES]
    null = [row for row in rows if row["outcome"] == "quiet"]
    out: dict[str, Any] = {}
    for word, chosen in (("all verdicts", rows), ("nothing concealed", null), ("rightly named", named)):
        pairs = [(name, entry) for row in chosen for name, entry in row["coverage"].items()]
        base = [(n, e) for n, e in pairs if "." not in n]
        own = [e for n, e in pairs if "." in n]
        out[word] = {
            "base_before": rate(sum(e["before"] for _, e in base), len(base)),
            "base_after": rate(sum(e["after"] for _, e in base), len(base)),
            "effect_after": rate(sum(e["after"] for e in own), len(own)),
            "by_parameter": {
                name: {
                    "before": rate(sum(e["before"] for n, e in base if n == name), sum(n == name for n, _ in base)),
                    "after": rate(sum(e["after"] for n, e in base if n == name), sum(n == name for n, _ in base)),
                }
                for name in sorted({n for n, _ in base})
            },
        }
    everything = [e for row in rows for e in row["coverage"].values()]
    out["after"] = rate(sum(e["after"] for e in everything), len(everything))
    return out


def _heldout(seen: Sequence[Row], null: Sequence[Row]) -> dict[str, Any]:
    """Held-out error in multiples of the noise floor."""
    out: dict[str, Any] = {}
    named = [row for row in seen if row["outcome"] in RIGHT_OUTCOMES]
    for word, rows in (("detectable", seen), ("rightly named", named), ("nothing concealed", null)):
        out[word] = {}
        for what in ("cycles_before", "cycles_after", "earthquake_before", "earthquake_after"):
            values = [row["heldout"][what] for row in rows]
            out[word][what] = {
                "n": len(values),
                "median": float(np.median(values)) if values else None,
                "q90": float(np.quantile(values, 0.9)) if values else None,
                "within": rate(sum(v <= HELD_OUT for v in values), len(values)),
            }
    return out


def _targets(summary: dict[str, Any]) -> list[dict[str, str]]:
    """Compare what was found with what was written down."""
    alarms, places = summary["false_alarms"], summary["coordinates"]
    least = (
        ("coordinate right, of the detectable", places["inside"], COORDINATE),
        ("name or family right, of the detectable", summary["right"], RIGHT),
        ("of two effects both right", summary["right_two"], RIGHT_TWO),
        ("a family holds what is concealed", summary["family_holds"], FAMILY),
        ("outside the catalogue: coordinate right", places["outside"], COORDINATE_OUTSIDE),
    )
    most = (
        ("false alarms, of devices with nothing concealed", alarms, FALSE_ALARMS),
        ("outside the catalogue: a wrong mechanism", summary["wrong_outside"], WRONG_OUTSIDE),
    )
    lines = [(words, _share(e), f"<= {aim:.0%}", bool(e["n"]) and e["share"] <= aim) for words, e, aim in most]
    lines += [(words, _share(e), f">= {aim:.0%}", bool(e["n"]) and e["share"] >= aim) for words, e, aim in least]
    high = alarms["high"]
    limit = (
        "upper 95 % limit of that rate",
        f"{100 * high:.1f} %",
        f"<= {FALSE_ALARMS_LIMIT:.0%}",
        high <= FALSE_ALARMS_LIMIT,
    )
    lines.insert(1, limit)
    lines += [_calibrated(summary["reliability"][of], of) for of in ("coordinate", "name")]
    for what, words in (("cycles", "held-out cycles"), ("earthquake", "another displacement history")):
        entry = summary["heldout"]["detectable"][f"{what}_after"]
        before = summary["heldout"]["detectable"][f"{what}_before"]
        for part, aim, of in (("median", HELD_OUT, "median"), ("q90", HELD_OUT_90, "90 % of the trials")):
            value = "none" if entry[part] is None else f"{entry[part]:.2f} (before {before[part]:.2f})"
            met = entry[part] is not None and entry[part] <= aim
            lines.append((f"error on {words}, x noise floor, {of}", value, f"<= {aim}", met))
    cover = summary["coverage"]["after"]
    inside = bool(cover["n"]) and COVERAGE[0] <= cover["share"] <= COVERAGE[1]
    between = f"{COVERAGE[0]:.0%} to {COVERAGE[1]:.0%}"
    lines.append(("coverage of 90 % intervals after, all verdicts", _share(cover), between, inside))
    return [{"words": w, "value": v, "aim": a, "verdict": "met" if ok else "NOT MET"} for w, v, a, ok in lines]


def _calibrated(bins: Sequence[dict[str, Any]], of: str) -> tuple[str, str, str, bool]:
    """Largest difference between stated and observed, over the bins that hold enough."""
    full = [one for one in bins if one["true"]["n"] >= IN_BIN]
    off = max((abs(one["stated"] - one["true"]["share"]) for one in full), default=None)
    value = "none" if off is None else f"off by {100 * off:.1f} points at most ({len(full)} of {len(bins)} bins)"
    words = f"stated probability of a {of}, bins with {IN_BIN} or more"
    return words, value, f"<= {100 * CALIBRATION:.0f} points", off is not None and off <= CALIBRATION


def _share(entry: dict[str, Any]) -> str:
    return f"{entry['hits']} of {entry['n']}, {100 * entry['share']:.1f} %" if entry["n"] else "none"
