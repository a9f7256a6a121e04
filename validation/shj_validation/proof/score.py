"""One trial held against its key, and all trials counted."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import optimize, stats

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording
from shj_bayes.results.diagnosis import DependenceId
from shj_validation.proof.cases import Key
from shj_validation.proof.make import make
from shj_validation.proof.predict import predict
from shj_validation.proof.simulators.simulator import simulators_by_id
from shj_validation.proof.truth import Truth, effect_truths, kept_base, truth_of

LIKELY = 0.5  # a coordinate that is more likely there than not is claimed
FRAME, FRAME_PAIR = "frame_compliance", ("motion", "compliance")  # true of what is measured at the machine
EITHER = 2  # sets of coordinates between which an answer may leave open which is the true one
SHORT_LIST = 4  # ids for each concealed effect; a longer list holds the truth as a telephone book does
Z90 = 1.6449  # half width of a 90 % interval of a normal law, in standard deviations


def score_trial(key: Key, record: Mapping[str, Any]) -> dict[str, Any]:
    """Hold one diagnosis against its key.

    Parameters
    ----------
    key : Key
        What was concealed.
    record : mapping
        Content of ``diagnosis.json``, or ``{"error": ...}``.

    Returns
    -------
    dict
        One row of the table of trials.
    """
    made = make(key, heldout=True)
    truth = truth_of(key, made[:2])
    record = but_for_the_machine(record) if key.machine_kN_mm else record
    row: dict[str, Any] = {
        "number": key.number,
        "kind": key.kind,
        "truth": [one.id for one in key.effects],
        "effects": [simulators_by_id()[one.id].effect for one in key.effects],
        "sizes": [one.size for one in key.effects],
        "protocol": key.protocol,
        "rate_Hz": key.rate_Hz,
        "reversal": key.reversal,
        "noise": key.nuisance.noise,
        "noise_share": key.nuisance.noise_kN / key.device.Fy,
        "visible_share": truth.visible_share,
        "bare_share": truth.bare_share,
        "evidence": truth.evidence,
        "detectable": truth.detectable,
        "each": {name: list(pair) for name, pair in truth.each.items()},
    }
    if key.machine_kN_mm:
        row["machine_share"] = key.device.K / key.machine_kN_mm
    if key.first_sd:
        row["first_sd"] = key.first_sd
    if "error" in record:
        return row | {"verdict": "failed", "outcome": "failed", "found": [], "why": record["error"]}
    row |= {
        "verdict": record["verdict"],
        "p_value": record.get("p_value"),
        "found": [effect["id"] for effect in record["effects"]],
        "family": [member["id"] for member in record["family"]],
        "seconds": record["seconds"],
    }
    row["outcome"] = outcome(key, record, truth.required)
    row["coordinate_right"] = coordinate_right(key, record, truth.required)
    row["coordinates"] = [
        {name: entry[name] for name in ("action", "coordinate", "probability")}
        for entry in record.get("coordinates", [])
    ]
    row["stated"] = stated(key, record)
    row["family_holds"] = family_holds(key, record, truth.required)
    row["coverage"] = coverage(key, record, truth)
    row["heldout"] = heldout(key, record, made)
    return row


def but_for_the_machine(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """Take a machine's stretch off an answer: true where displacement is measured there, and nothing that K misses.

    An answer that names nothing else has found nothing of what is concealed.
    """
    if not any(effect["id"] == FRAME for effect in record.get("effects", [])):
        return record
    effects = [effect for effect in record["effects"] if effect["id"] != FRAME]
    places = [e for e in record.get("coordinates", []) if (e["action"], e["coordinate"]) != FRAME_PAIR]
    verdict = record["verdict"] if effects or record["verdict"] == "unknown" else "adequate"
    return {**record, "effects": effects, "coordinates": places, "verdict": verdict}


def outcome(key: Key, record: Mapping[str, Any], required: set[str] | None = None) -> str:
    """Judge the verdict: right, right family, vague, part, sibling, wrong, unknown, missed, or false alarm.

    Of two effects, one that could not be told from the noise beside the other need not be named, but may (`required`;
    all by default).
    Any form of an effect is right under its name, and so are the names that a simulator ``holds``.
    ``right family`` is the verdict "family" whose short list holds everything that is concealed, ``vague`` the same
    with a long list; ``part`` is one of two effects rightly named and nothing wrong beside it; ``sibling`` is a wrong
    name from the right family. ``unknown`` is right where a simulator says so, the coordinates are right, and what is
    concealed beside it is named.
    """
    wanted = {one.id: simulators_by_id()[one.id] for one in key.effects}
    needed = (set(wanted) & required if required else set()) or set(wanted)
    verdict = record["verdict"]
    if not wanted:
        return "quiet" if verdict == "adequate" else "false alarm"
    if verdict == "adequate":
        return "missed"
    names = {name: one.names for name, one in wanted.items()}
    if verdict == "unknown":
        named = _meant((effect["id"] for effect in record["effects"]), names)
        closed = {name for name in needed if not wanted[name].may_be_unknown}
        right = closed < needed and closed <= named <= set(wanted) and coordinate_right(key, record, required)
        return "right" if right else "unknown"
    return _of_names(names, needed, record)


def _meant(names: Iterable[str], wanted: Mapping[str, frozenset[str]]) -> set[str]:
    """List the simulators that names stand for, and the names that stand for none."""
    names = set(names)
    hit = {one for one, right in wanted.items() if right & names}
    return hit | {name for name in names if not any(name in right for right in wanted.values())}


def _of_names(wanted: Mapping[str, frozenset[str]], needed: set[str], record: Mapping[str, Any]) -> str:
    """Judge the names given under the verdicts ``named`` and ``family``; `wanted` has the right names by simulator."""
    found = _meant((effect["id"] for effect in record["effects"]), wanted)
    members = {member["id"] for member in record["family"]}
    rivals = {rival for effect in record["effects"] for rival in effect["rivals"]}
    listed = _meant({effect["id"] for effect in record["effects"]} | members | rivals, wanted)
    if record["verdict"] == "named" and needed <= found <= set(wanted):
        return "right"
    if record["verdict"] == "family" and needed <= listed and len(needed) <= len(found) <= len(wanted):
        backed = all(_meant([e["id"], *e["rivals"]], wanted) & set(wanted) for e in record["effects"])
        if backed or len(found) == 1:
            return "right family" if len(listed) <= SHORT_LIST * len(found) else "vague"
    if found and found < set(wanted):
        return "part"
    known = catalogue()
    families = sorted(known[name].family for right in wanted.values() for name in sorted(right)[:1])
    named = sorted(known[effect["id"]].family for effect in record["effects"])
    return "sibling" if named and named == families else "wrong"


def coordinate_right(key: Key, record: Mapping[str, Any], required: set[str] | None = None) -> bool | None:
    """Whether the coordinates that lead the answer are those of what is concealed.

    As many lead as effects must be found, and beside them every one that is more likely there than not. Each must be
    true of something that is concealed, and what must be found has one among them. Where the answer says that it is one
    of two sets of coordinates, travel or time for instance, it is right if either is.

    Returns
    -------
    bool or None
        None where nothing is concealed, or the answer states no coordinates.
    """
    if not key.effects or "coordinates" not in record:
        return None
    wanted = {one.id: set(simulators_by_id()[one.id].coordinates) for one in key.effects}
    needed = (set(wanted) & required if required else set()) or set(wanted)
    ranked = sorted(_once(record["coordinates"]), key=lambda entry: -float(entry["probability"]))
    lead = [entry for i, entry in enumerate(ranked) if i < len(needed) or float(entry["probability"]) >= LIKELY]
    answers = [{(entry["action"], entry["coordinate"]) for entry in lead}]
    sets = record.get("sets", []) if record["verdict"] == "family" else []
    if len(sets) == EITHER:
        answers += [set(map(DependenceId.read, one["classes"])) for one in sets]
    return any(
        all(wanted[name] & pairs for name in needed) and pairs <= set.union(*wanted.values()) for pairs in answers
    )


def _once(entries: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Give each dependence once: one that push and pull have curves of their own for stands there twice."""
    return list({(entry["action"], entry["coordinate"]): entry for entry in entries}.values())


def stated(key: Key, record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """List every probability that an answer states, and whether it came true: of coordinates, and of names.

    A name's probability is that of an effect found; in a family each member has its own.
    """
    concealed = [simulators_by_id()[one.id] for one in key.effects]
    pairs = {pair for one in concealed for pair in one.coordinates}
    right = {name for one in concealed for name in one.names}
    out = [
        {
            "of": "coordinate",
            "probability": entry["probability"],
            "true": (entry["action"], entry["coordinate"]) in pairs,
        }
        for entry in _once(record.get("coordinates", []))
    ]
    names = {one["id"]: one.get("probability") for one in [*record["effects"], *record["family"]]}
    out += [{"of": "name", "probability": p, "true": name in right} for name, p in names.items()]
    return [one for one in out if one["probability"] is not None]


def family_holds(key: Key, record: Mapping[str, Any], required: set[str]) -> bool | None:
    """Whether the set of a verdict ``family`` holds all that must be found; None under another verdict."""
    if record["verdict"] != "family" or not required:
        return None
    listed = {one["id"] for one in [*record["effects"], *record["family"]]}
    listed |= {rival for effect in record["effects"] for rival in effect["rivals"]}
    return all(listed & simulators_by_id()[name].names for name in required)


def coverage(key: Key, record: Mapping[str, Any], truth: Truth) -> dict[str, Any]:
    """For each parameter with a true value, whether the 90 % interval holds it before and after."""
    kept, out = kept_base(key), {}
    for name, row in record["shift"].items():
        if name.partition("_")[0] not in kept:
            continue
        true = truth.base[name]
        after = row["after"]
        low, high = (
            after.get("q05", after["mean"] - Z90 * after["sd"]),
            after.get("q95", after["mean"] + Z90 * after["sd"]),
        )
        out[name] = {
            "truth": true,
            "before": bool(abs(row["before"]["mean"] - true) <= Z90 * row["before"]["sd"]),
            "after": bool(low <= true <= high),
            "off_before": row["before"]["mean"] - true,
            "off_after": after["mean"] - true,
        }
    truths = effect_truths(key)
    for effect in record["effects"]:
        for name, true in truths.get(effect["id"], {}).items():
            row = effect["parameters"].get(name)
            if row is None:  # the form that was matched has other parameters
                continue
            out[f"{effect['id']}.{name}"] = {
                "truth": true,
                "before": None,
                "after": bool(row["q05"] <= true <= row["q95"]),
                "off_before": None,
                "off_after": row["mean"] - true,
            }
    return out


def heldout(key: Key, record: Mapping[str, Any], made: Sequence[Any]) -> dict[str, float]:
    """Error on cycles left out and on the slowed earthquake, as multiples of the noise floor."""
    floor = float(np.sqrt(np.mean(np.concatenate([one.noise_kN for one in made[:2]]) ** 2)))
    out = {
        "cycles_before": record["before"]["heldout_rmse_kN"] / floor,
        "cycles_after": record["after"]["heldout_rmse_kN"] / floor,
    }
    tested = [(one.recording.time_s, motion_of(one.recording)) for one in made[:2]]
    shaken = made[2].recording
    new = (shaken.time_s, motion_of(Recording(shaken.time_s, shaken.displacement_mm, shaken.force_kN)))
    own = ~new[1].unsure if new[1].unsure is not None else np.ones(shaken.n_samples, dtype=np.bool_)
    floor = float(np.sqrt(np.mean(made[2].noise_kN[own] ** 2)))
    for when in ("before", "after"):
        wrong = shaken.force_kN - predict(record, tested, new, when)
        out[f"earthquake_{when}"] = float(np.sqrt(np.mean(wrong[own] ** 2))) / floor
    return out


def rate(hits: int, n: int, level: float = 0.95) -> dict[str, Any]:
    """Share with its two-sided Clopper-Pearson interval."""
    if n == 0:
        return {"hits": 0, "n": 0, "share": None, "low": 0.0, "high": 1.0}
    tail = (1 - level) / 2
    low = float(stats.beta.ppf(tail, hits, n - hits + 1)) if hits else 0.0
    high = float(stats.beta.ppf(1 - tail, hits + 1, n - hits)) if hits < n else 1.0
    return {"hits": hits, "n": n, "share": hits / n, "low": low, "high": high}


def half_size(sizes: Sequence[float], seen: Sequence[bool]) -> tuple[float, float] | None:
    """Size detected half the time, and the slope over ln(size): logistic regression with a weak prior on the slope.

    Returns
    -------
    (float, float) or None
        None with fewer than four trials, or where all or none were seen.
    """
    x, y = np.log(np.asarray(sizes)), np.asarray(seen, dtype=np.float64)
    if y.size < 4 or y.min() == y.max():
        return None

    def loss(p: FloatArray) -> float:
        eta = np.exp(p[1]) * (x - p[0])
        return float(np.sum(np.logaddexp(0.0, eta) - y * eta) + 0.5 * (p[1] - np.log(3.0)) ** 2)

    best = optimize.minimize(loss, np.array([float(x.mean()), np.log(3.0)]), method="Nelder-Mead").x
    return float(np.exp(best[0])), float(np.exp(best[1]))
