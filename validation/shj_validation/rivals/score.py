"""Rivals and our own diagnosis scored alike, on the keys of an opened proof."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from shj_bayes._util.arrays import FloatArray
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording
from shj_validation.proof.cases import Key
from shj_validation.proof.make import make
from shj_validation.proof.score import rate
from shj_validation.proof.simulators.simulator import simulators_by_id
from shj_validation.proof.summary import FALSE_ALARMS, HELD_OUT
from shj_validation.rivals.question import rms

OURS = "shj-bayes"
# Words of what a regression has no input for, and by which inputs it can be seen; a position is right for a distance.
SEEN_BY = {
    "distance": ("position", "distance"),
    "position": ("position", "distance"),
    "constant": ("direction",),
    "speed_by_travel": ("speed", "travel"),
    "rest": ("slip",),
    "slack": ("slip", "position"),
    "second surface": ("slip", "position"),
    "delay": ("slip", "speed", "acceleration"),
    "stick-slip": ("slip", "speed", "acceleration"),
    "compliance": ("slip",),
    "reversal": ("slip",),
}


def threshold(gains: Sequence[float], level: float = FALSE_ALARMS) -> float:
    """Gain that so many of devices with nothing concealed exceed at most; never below 0."""
    ordered = sorted(gains, reverse=True)
    return max(0.0, ordered[int(level * len(ordered))])


def mcnemar(ours: Sequence[bool], theirs: Sequence[bool]) -> tuple[int, int, float]:
    """Trials that only one of two got right, ours first, and the exact two-sided probability of that or more."""
    ours_only = sum(a and not b for a, b in zip(ours, theirs, strict=True))
    theirs_only = sum(b and not a for a, b in zip(ours, theirs, strict=True))
    n = ours_only + theirs_only
    return ours_only, theirs_only, float(stats.binomtest(ours_only, n, 0.5).pvalue) if n else 1.0


def median(values: Sequence[float], level: float = 0.95) -> tuple[float, float, float]:
    """Median with an interval between order statistics that holds whatever the distribution."""
    x = np.sort(np.asarray(values))
    k = int(stats.binom.ppf((1.0 - level) / 2.0, x.size, 0.5))
    return float(np.median(x)), float(x[max(k - 1, 0)]), float(x[min(x.size - k, x.size - 1)])


def is_right(word: str, row: Mapping[str, Any]) -> bool:
    """Whether one word is a coordinate of anything that a trial conceals, whatever it acts on.

    Of two effects one may be too small to be seen beside the other: it need not be named, but may be, as in the proof.
    """
    true = {coordinate for name in row["each"] for _, coordinate in simulators_by_id()[name].coordinates}
    return word in true or any(word in SEEN_BY.get(one, ()) for one in true)


def our_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Give our answer to a trial, from the row of the proof's table."""
    if row["outcome"] == "failed":
        return failed()
    first = max(row["coordinates"], key=lambda one: float(one["probability"]), default=None)
    return {
        "right": first is not None and is_right(first["coordinate"], row),
        "found": row["verdict"] != "adequate",
        "cycles": row["heldout"]["cycles_after"],
        "earthquake": row["heldout"]["earthquake_after"],
        "seconds": row["seconds"],
    }


def failed() -> dict[str, Any]:
    """Give what counts for a trial without an answer."""
    return {"right": False, "found": False, "cycles": np.inf, "earthquake": np.inf, "seconds": np.nan}


def rival_rows(key: Key, row: Mapping[str, Any], answers: Mapping[str, Any], limits: Mapping[str, float]) -> Any:
    """Give what each rival answered to a trial, held against the key; one that ranks in two ways has two rows."""
    made = make(key, heldout=True)
    floor = rms(np.concatenate([one.noise_kN for one in made[:2]]))
    last = made[2].recording
    unsure = motion_of(Recording(last.time_s, last.displacement_mm, last.force_kN)).unsure
    own = np.ones(last.n_samples, dtype=np.bool_) if unsure is None else ~unsure

    def shaken_error(force_kN: FloatArray) -> float:
        return rms((last.force_kN - force_kN)[own]) / rms(made[2].noise_kN[own])

    out: dict[str, dict[str, Any]] = {}
    for name, limit in limits.items():
        one = answers.get(name, {"error": "no answer"})
        for how, words in (("by_permutation", name), ("by_itself", f"{name} {BY_ITSELF.get(name, '')}")):
            if "error" in one:
                out |= {} if how == "by_itself" and name not in BY_ITSELF else {words: failed()}
            elif one[how] is not None:
                found = one["gain"] > limit  # else the base law is its model
                shaken = shaken_error(np.array(one["earthquake_kN"])) if found else row["heldout"]["earthquake_before"]
                out[words] = {
                    "right": bool(one[how]) and is_right(one[how][0]["coordinate"], row),
                    "found": found,
                    "cycles": one["after_kN" if found else "before_kN"] / floor,
                    "earthquake": shaken,
                    "seconds": one["seconds"],
                }
    return out


COLUMNS = ("right coordinate first", "missing, and right", "false alarms", "cycles left out", "earthquake", "seconds")
BY_ITSELF = {"gaussian process": "by its lengths", "sparse regression": "by its terms"}


def summary(
    rows: Sequence[Mapping[str, Any]], answers: Mapping[str, Sequence[Mapping[str, Any]]]
) -> list[dict[str, Any]]:
    """Count each method: rows of the proof's table, and by name what it answered to each."""
    seen = [i for i, row in enumerate(rows) if row["detectable"]]
    null = [i for i, row in enumerate(rows) if row["kind"] == "nothing"]
    out = []

    def binary(name: str) -> dict[str, list[bool]]:
        own = answers[name]
        return {
            "right": [bool(own[i]["right"]) for i in seen],
            "found and right": [bool(own[i]["right"] and own[i]["found"]) for i in seen],
            "cycles": [bool(own[i]["cycles"] <= HELD_OUT) for i in seen],
            "earthquake": [bool(own[i]["earthquake"] <= HELD_OUT) for i in seen],
            "quiet": [not own[i]["found"] for i in null],
        }

    ours = binary(OURS)
    for name, own in answers.items():
        held = binary(name)
        out.append(
            {
                "name": name,
                "right": rate(sum(held["right"]), len(seen)),
                "found": rate(sum(held["found and right"]), len(seen)),
                "alarms": rate(len(null) - sum(held["quiet"]), len(null)),
                "cycles": median([own[i]["cycles"] for i in seen]),
                "earthquake": median([own[i]["earthquake"] for i in seen]),
                "seconds": float(np.nanmedian([one["seconds"] for one in own])),
                "against": {word: mcnemar(ours[word], held[word]) for word in ours},
            }
        )
    return out


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Two tables in Markdown: what each method reached, and ours against each in the same trials."""
    out = [f"| method | {' | '.join(COLUMNS)} |", "|---" * (1 + len(COLUMNS)) + "|"]
    for one in lines:
        shares = (share(one[word]) for word in ("right", "found", "alarms"))
        middles = ("{:.2f} ({:.2f} to {:.2f})".format(*one[word]) for word in ("cycles", "earthquake"))
        out.append(f"| {one['name']} | {' | '.join((*shares, *middles))} | {one['seconds']:.1f} |")
    words = {
        "right": "right coordinate first",
        "found and right": "missing, and right",
        "quiet": "no false alarm",
        "cycles": f"cycles left out within {HELD_OUT:g} x noise",
        "earthquake": f"earthquake within {HELD_OUT:g} x noise",
    }
    head = f"| {OURS} only : rival only, exact McNemar p | {' | '.join(words.values())} |"
    out += ["", head, "|---" * (1 + len(words)) + "|"]
    for one in lines:
        if one["name"] != OURS:
            cells = ("{} : {}, p = {:.2g}".format(*one["against"][word]) for word in words)
            out.append(f"| {one['name']} | {' | '.join(cells)} |")
    return "\n".join(out)


def share(one: Mapping[str, Any]) -> str:
    """Count, of how many, and the interval."""
    if not one["n"]:
        return "none"
    middle, low, high = (100 * one[word] for word in ("share", "low", "high"))
    return f"{one['hits']} of {one['n']}: {middle:.0f} % ({low:.0f} to {high:.0f})"


def better(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    """List columns in which rivals are ahead of ours, with their names."""
    ours = next(one for one in lines if one["name"] == OURS)
    columns: dict[str, tuple[str, Callable[[Mapping[str, Any]], float]]] = {
        "right": ("right coordinate first", lambda one: -one["right"]["share"]),
        "found": ("missing, and right", lambda one: -one["found"]["share"]),
        "alarms": ("fewer false alarms", lambda one: one["alarms"]["share"]),
        "cycles": ("cycles left out", lambda one: one["cycles"][0]),
        "earthquake": ("the earthquake", lambda one: one["earthquake"][0]),
        "seconds": ("seconds", lambda one: one["seconds"]),
    }
    out = []
    for words, value in columns.values():
        ahead = [one["name"] for one in lines if value(one) < value(ours)]
        if ahead:
            out.append(f"{words} ({', '.join(ahead)})")
    return out
