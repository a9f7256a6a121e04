"""One trial held against its key, and all trials counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import optimize, stats

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Priors
from shj_bayes.proof.cases import Key
from shj_bayes.proof.make import make
from shj_bayes.proof.predict import predict
from shj_bayes.proof.simulators.simulator import simulators_by_id
from shj_bayes.proof.truth import Truth, effect_truths, kept_base, truth_of
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.recording import Recording

SHORT_LIST = 4  # ids for each concealed effect; a longer list holds the truth as a telephone book does
Z90 = 1.6449  # half width of a 90 % interval of a normal law, in standard deviations


def score_trial(key: Key, record: Mapping[str, Any], priors: Priors) -> dict[str, Any]:
    """Hold one diagnosis against its key.

    Parameters
    ----------
    key : Key
        What was concealed.
    record : mapping
        Content of ``diagnosis.json``, or ``{"error": ...}``.
    priors : Priors
        Of the base parameters.

    Returns
    -------
    dict
        One row of the table of trials.
    """
    made = make(key, heldout=True)
    truth = truth_of(key, priors, made[:2])
    row: dict[str, Any] = {
        "number": key.number,
        "kind": key.kind,
        "truth": [one.id for one in key.effects],
        "sizes": [one.size for one in key.effects],
        "protocol": key.protocol,
        "noise": key.nuisance.noise,
        "noise_share": key.nuisance.noise_kN / key.device.Fy,
        "visible_share": truth.visible_share,
        "bare_share": truth.bare_share,
        "evidence": truth.evidence,
        "detectable": truth.detectable,
        "each": {name: list(pair) for name, pair in truth.each.items()},
    }
    if "error" in record:
        return row | {"verdict": "failed", "outcome": "failed", "found": [], "why": record["error"]}
    row |= {
        "verdict": record["verdict"],
        "p_value": record["p_value"],
        "found": [effect["id"] for effect in record["effects"]],
        "family": [member["id"] for member in record["family"]],
        "seconds": record["seconds"],
    }
    row["outcome"] = outcome(key, record, truth.required)
    row["located"] = located(record, truth) if key.effects else None
    row["coverage"] = coverage(key, record, truth)
    row["heldout"] = heldout(key, record, made)
    return row


def outcome(key: Key, record: Mapping[str, Any], required: set[str] | None = None) -> str:
    """Judge the verdict: right, right family, vague, part, sibling, wrong, unknown, missed, or false alarm.

    Of two effects, one that could not be told from the noise beside the other need not be named, but may (`required`;
    all by default).
    ``right family`` is the verdict "family" whose short list holds everything that is concealed, ``vague`` the same
    with a long list; ``part`` is one of two effects rightly named and nothing wrong beside it; ``sibling`` is a wrong
    name from the right family.
    """
    wanted = {one.id for one in key.effects}
    verdict = record["verdict"]
    if not wanted:
        return "quiet" if verdict == "adequate" else "false alarm"
    if verdict == "adequate":
        return "missed"
    if verdict == "unknown" or key.kind == "outside":
        return "unknown" if verdict == "unknown" else "wrong"
    return _of_names(wanted, (wanted & required if required else set()) or wanted, record)


def _of_names(wanted: set[str], required: set[str], record: Mapping[str, Any]) -> str:
    """Judge the names given under the verdicts ``named`` and ``family``."""
    held = {other: one for one in wanted for other in simulators_by_id()[one].holds if other not in wanted}
    found = {held.get(effect["id"], effect["id"]) for effect in record["effects"]}
    listed = found | {member["id"] for member in record["family"]}
    listed |= {rival for effect in record["effects"] for rival in effect["rivals"]}
    if record["verdict"] == "named" and required <= found <= wanted:
        return "right"
    if record["verdict"] == "family" and required <= listed and len(required) <= len(found) <= len(wanted):
        backed = all(held.get(e["id"], e["id"]) in wanted or wanted & set(e["rivals"]) for e in record["effects"])
        if backed or len(found) == 1:
            return "right family" if len(listed) <= SHORT_LIST * len(found) else "vague"
    if found and found < wanted:
        return "part"
    alike = sorted(catalogue()[name].family for name in found) == sorted(catalogue()[name].family for name in wanted)
    return "sibling" if alike else "wrong"


def located(record: Mapping[str, Any], truth: Truth) -> dict[str, Any] | None:
    """Whether the region named first holds more of the true misfit than its share of the samples."""
    if not record["location"]:
        return None
    where = record["location"][0]
    inside = _inside(truth.scene, where)
    if not inside.any():
        return {"overlaps": False, "lift": 0.0}
    square = truth.residual_kN**2
    own = truth.scene.weight > 0
    lift = float(square[inside & own].mean() / max(float(square[own].mean()), 1e-300))
    return {"overlaps": lift >= 1.0, "lift": lift, "coordinate": where["coordinate"], "interval": where["interval"]}


def _inside(scene: Evidence, where: Mapping[str, Any]) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Find the samples of a named region."""
    names = {
        "position": "position_mm",
        "speed": "speed_mm_s",
        "slip since reversal": "slip_mm",
        "travel": "travel_m",
        "amplitude": "amplitude_mm",
    }
    name = where["coordinate"]
    values = scene.run.astype(np.float64) if name == "run" else scene.stack(names[name])
    low, high = where["interval"]
    inside = (values >= low) & (values < high)
    if where["direction"] != "both":
        inside &= scene.stack("direction") * (1.0 if where["direction"] == "push" else -1.0) > 0
    return np.asarray(inside)


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
            row = effect["parameters"][name]
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
