"""All trials counted: the targets written down in advance, and whether they were met."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.proof.score import half_size, rate

# Written down before the proof was run (issue 4); see docs/decisions/0007-proof.md.
FALSE_ALARMS, FALSE_ALARMS_LIMIT = 0.05, 0.09
RIGHT = 0.90
HELD_OUT = 1.2
COVERAGE = (0.85, 0.95)
RIGHT_OUTCOMES = ("right", "right family")
Row = dict[str, Any]


def summarise(rows: Sequence[Row]) -> dict[str, Any]:
    """Count all trials.

    Parameters
    ----------
    rows : sequence of dict
        From `shj_bayes.proof.score.score_trial`.

    Returns
    -------
    dict
        ``targets`` (words, value, aim, verdict), ``false_alarms``, ``power``, ``confusion``, ``outcomes``,
        ``located``, ``coverage``, ``heldout``.
    """
    done = [row for row in rows if row["outcome"] != "failed"]
    null = [row for row in done if row["kind"] == "nothing"]
    inside = [row for row in done if row["kind"] in ("one", "two")]
    outside = [row for row in done if row["kind"] == "outside"]
    seen = [row for row in inside if row["detectable"]]
    alarms = rate(sum(row["outcome"] == "false alarm" for row in null), len(null))
    right = rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in seen), len(seen))
    single = [row for row in seen if row["kind"] == "one"]
    summary: dict[str, Any] = {
        "failed": [row["number"] for row in rows if row["outcome"] == "failed"],
        "false_alarms": alarms
        | {
            "by_noise": _by(null, "noise", lambda r: r["outcome"] == "false alarm"),
            "by_protocol": _by(null, "protocol", lambda r: r["outcome"] == "false alarm"),
        },
        "detected": rate(sum(row["verdict"] != "adequate" for row in seen), len(seen)),
        "right": right,
        "right_single": rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in single), len(single)),
        "right_of_detected": _right_of_detected(inside),
        "outcomes": {
            kind: dict(Counter(_word(row) for row in done if row["kind"] == kind))
            for kind in ("nothing", "one", "two", "outside")
        },
        "unknown_outside": rate(
            sum(row["outcome"] == "unknown" for row in outside if row["detectable"]),
            sum(row["detectable"] for row in outside),
        ),
        "power": _power(done),
        "confusion": _confusion([row for row in inside if row["kind"] == "one" and row["detectable"]]),
        "located": _located(seen + [row for row in outside if row["detectable"]]),
        "coverage": _coverage(done),
        "heldout": _heldout(seen, null),
    }
    summary["targets"] = _targets(summary)
    return summary


def _word(row: Row) -> str:
    """Outcome, with what was too small to be seen kept apart."""
    return row["outcome"] if row["detectable"] or row["kind"] == "nothing" else f"{row['outcome']} (too small to see)"


def _by(rows: Sequence[Row], name: str, hit: Callable[[Row], bool]) -> dict[str, dict[str, float]]:
    groups = sorted({str(row[name]) for row in rows})
    return {g: rate(sum(hit(r) for r in rows if r[name] == g), sum(r[name] == g for r in rows)) for g in groups}


def _right_of_detected(rows: Sequence[Row]) -> dict[str, float]:
    raised = [row for row in rows if row["verdict"] != "adequate"]
    return rate(sum(row["outcome"] in RIGHT_OUTCOMES for row in raised), len(raised))


def _power(rows: Sequence[Row]) -> dict[str, Any]:
    """Count detection against the visible size: all physics together, by family and by effect."""
    have = [row for row in rows if row["kind"] in ("one", "outside")]
    known = catalogue()
    groups: dict[str, dict[str, list[Row]]] = {"by_family": {}, "by_effect": {}}
    for row in have:
        name = row["truth"][0]
        family = known[name].family if name in known else "outside the catalogue"
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
    by_effect = Counter((row["truth"][0], _answer(row)) for row in rows)
    by_family = Counter(
        (known[row["truth"][0]].family, known[a].family if (a := _answer(row)) in known else a) for row in rows
    )
    return {
        "by_effect": [{"truth": t, "answer": a, "n": n} for (t, a), n in sorted(by_effect.items())],
        "by_family": [{"truth": t, "answer": a, "n": n} for (t, a), n in sorted(by_family.items())],
    }


def _answer(row: Row) -> str:
    """Say what the diagnosis answered to a single effect: its name, or adequate, unknown, several."""
    if row["verdict"] in ("adequate", "unknown"):
        return str(row["verdict"])
    if row["outcome"] == "right family":
        return str(row["truth"][0])
    return row["found"][0] if len(row["found"]) == 1 else "several"


def _located(rows: Sequence[Row]) -> dict[str, Any]:
    named = [row["located"] for row in rows if row["located"]]
    lifts = [place["lift"] for place in named]
    return rate(sum(place["overlaps"] for place in named), len(named)) | {
        "median_lift": float(np.median(lifts)) if lifts else None
    }


def _coverage(rows: Sequence[Row]) -> dict[str, Any]:
    """Coverage of 90 % intervals: trials with nothing, and trials whose effects were named rightly."""
    named = [row for row in rows if row["outcome"] in RIGHT_OUTCOMES]
    null = [row for row in rows if row["outcome"] == "quiet"]
    out: dict[str, Any] = {}
    for word, chosen in (("nothing concealed", null), ("rightly named", named)):
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
    everything = [e for row in named for e in row["coverage"].values()]
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
    alarms, right, cover = summary["false_alarms"], summary["right"], summary["coverage"]["after"]
    lines = [
        (
            "false alarms, of devices with nothing concealed",
            _share(alarms),
            f"<= {FALSE_ALARMS:.0%}",
            alarms["n"] and alarms["share"] <= FALSE_ALARMS,
        ),
        (
            "upper 95 % limit of that rate",
            f"{100 * alarms['high']:.1f} %",
            f"<= {FALSE_ALARMS_LIMIT:.0%}",
            alarms["high"] <= FALSE_ALARMS_LIMIT,
        ),
        (
            "name or family right, of the detectable",
            _share(right),
            f">= {RIGHT:.0%}",
            right["n"] and right["share"] >= RIGHT,
        ),
    ]
    for what, words in (("cycles", "held-out cycles"), ("earthquake", "another displacement history")):
        entry = summary["heldout"]["detectable"][f"{what}_after"]
        before = summary["heldout"]["detectable"][f"{what}_before"]
        value = "none" if entry["median"] is None else f"{entry['median']:.2f} (before {before['median']:.2f})"
        lines.append(
            (
                f"error on {words}, median x noise floor",
                value,
                f"<= {HELD_OUT}",
                entry["median"] is not None and entry["median"] <= HELD_OUT,
            )
        )
    lines.append(
        (
            "coverage of 90 % intervals after, rightly named",
            _share(cover),
            f"{COVERAGE[0]:.0%} to {COVERAGE[1]:.0%}",
            bool(cover["n"]) and COVERAGE[0] <= cover["share"] <= COVERAGE[1],
        )
    )
    return [{"words": w, "value": v, "aim": a, "verdict": "met" if ok else "NOT MET"} for w, v, a, ok in lines]


def _share(entry: dict[str, Any]) -> str:
    return f"{entry['hits']} of {entry['n']}, {100 * entry['share']:.1f} %" if entry["n"] else "none"
