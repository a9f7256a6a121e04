"""What a diagnosis says, piece by piece: the fields of ``diagnosis.json`` and the channels of ``diagnosis.nc``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.locate import locate
from shj_bayes.mismatch.name import effect_size
from shj_bayes.mismatch.refit import Refit
from shj_bayes.mismatch.regions import Regions
from shj_bayes.mismatch.search import Search
from shj_bayes.mismatch.verdict import Judgement
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.parameters import LAW_PARAMETERS, FloatArray, base_and_run

SCHEMA = "shj-bayes/diagnosis/1"


def effects(
    evidence: Evidence, result: Search, judgement: Judgement, draws: Mapping[str, FloatArray]
) -> list[dict[str, Any]]:
    """Effects of the final model; under the verdict ``unknown`` they are a part of what was left out, and said so."""
    out = []
    for effect in result.new:
        own = {p.name: draws[f"{effect.id}.{p.name}"] for p in effect.parameters}
        means = {key: float(values.mean()) for key, values in own.items()}
        out.append(
            {
                "id": effect.id,
                "family": effect.family,
                "title": effect.title,
                "statement": effect.statement.format(**means),
                "equation": effect.equation,
                "cause": effect.cause,
                "shows": effect.shows,
                "partial": judgement.word == "unknown",
                "probability": _probability(result, effect.id),
                "rivals": list(judgement.rivals.get(effect.id, ())),
                "size_kN": effect_size(evidence, result.final, effect),
                "parameters": {p.name: {**_spread(own[p.name]), "unit": p.unit} for p in effect.parameters},
            }
        )
    return out


def _spread(values: FloatArray) -> dict[str, float]:
    low, high = np.quantile(values, [0.05, 0.95])
    return {"mean": float(values.mean()), "sd": float(values.std(ddof=1)), "q05": float(low), "q95": float(high)}


def _probability(result: Search, name: str) -> float:
    ranking = result.rankings[name]
    return float(next(p for c, p in zip(ranking.candidates, ranking.probability, strict=True) if c.effect.id == name))


def family(result: Search, judgement: Judgement) -> list[dict[str, Any]]:
    """Effects that the recording cannot tell apart, most probable first."""
    if judgement.word != "family":
        return []
    scores: dict[str, float] = {}
    for name, rivals in judgement.rivals.items():
        if rivals:
            ranking = result.rankings[name]
            known = {c.effect.id: float(p) for c, p in zip(ranking.candidates, ranking.probability, strict=True)}
            scores |= {member: known[member] for member in (name, *rivals)}
    return [{"id": k, "probability": v} for k, v in sorted(scores.items(), key=lambda item: -item[1])]


def locations(evidence: Evidence, base: Refit, regions: Regions, result: Search, noise: float) -> list[dict[str, Any]]:
    """List where the base law fails."""
    return [
        {
            "coordinate": where.region.coordinate,
            "interval": [where.region.low, where.region.high],
            "unit": where.region.unit,
            "direction": where.region.direction,
            "runs": list(where.runs),
            "size_kN": where.size_kN,
            "share": where.share,
            "p_value": where.p_value,
        }
        for where in locate(evidence, base, regions, result.steps[0].alarm, noise)
    ]


def quality(evidence: Evidence, fit: Refit, noise: float) -> dict[str, float]:
    """Say how well a model fits: residual, noise floor, held-out residual (kN), energy per cycle (per cent)."""
    held = fit.held_out_residual(evidence)
    measured, modelled = _energy_of(evidence, evidence.force_kN), _energy_of(evidence, fit.force_kN)
    wrong = np.abs(modelled - measured) / np.maximum(np.abs(measured), 1e-300)
    return {
        "rmse_kN": fit.rmse_kN,
        "noise_kN": noise,
        "heldout_rmse_kN": float(np.sqrt(held @ held / max(float(evidence.weight.sum()), 1.0))),
        "energy_error_percent": float(100 * np.mean(wrong)),
    }


def _energy_of(evidence: Evidence, force: FloatArray) -> FloatArray:
    """Energy of each block, J (kN mm), by the trapezoid rule over the displacement."""
    x = evidence.stack("position_mm")
    work = np.append((force[1:] + force[:-1]) / 2 * np.diff(x), 0.0)
    work[np.flatnonzero(np.diff(evidence.block))] = 0.0  # the step from one block, or run, to the next
    return evidence.block_sums(work)


def energy(evidence: Evidence, base: Refit, shown: Refit) -> dict[str, list[float]]:
    """Energy of each block, measured and modelled before and after, J."""
    return {
        "cycle": [float(i) for i in range(1, evidence.n_blocks + 1)],
        "measured_J": _energy_of(evidence, evidence.force_kN).tolist(),
        "before_J": _energy_of(evidence, base.force_kN).tolist(),
        "after_J": _energy_of(evidence, shown.force_kN).tolist(),
    }


def heldout(evidence: Evidence, result: Search, shown: Refit) -> dict[str, Any]:
    """Gain of the shown model over the base law on blocks that were held out."""
    before, after = result.base.held_out_squares(evidence), shown.held_out_squares(evidence)
    residual = shown.residual_kN
    phi = float(np.clip(residual[:-1] @ residual[1:] / max(float(residual @ residual), 1e-300), 0.0, 0.99))
    gain = (before - after) * (1 - phi) / (1 + phi) / (2 * shown.rmse_kN**2)
    n = evidence.n_blocks
    return {
        "scheme": "leave one cycle out" if n > 1 else "none",
        "elpd_gain": float(gain.sum()),
        "se": float(np.sqrt(n) * gain.std(ddof=1)),
        "n_blocks": n,
    }


def shift(before: Mapping[str, FloatArray], after: Mapping[str, FloatArray]) -> dict[str, dict[str, dict[str, float]]]:
    """Say what the omission did to the parameters of the base law, from draws without and with the effects found."""
    base = [name for name in before if "." not in name]  # not of effects that were given
    shared = [name for name in base if name in after and base_and_run(name)[0] in LAW_PARAMETERS]
    return {name: {"before": _spread(before[name]), "after": _spread(after[name])} for name in shared}


def next_test(result: Search, judgement: Judgement) -> str | None:
    """Give the cheapest change of the test that would tell the leading rivals apart."""
    if judgement.word != "family":
        return None
    known = catalogue()
    words = [known[name].next_test for name, rivals in judgement.rivals.items() if rivals]
    return " ".join(dict.fromkeys(words)) or None


def candidates(result: Search) -> list[dict[str, Any]]:
    """Every effect tried against the base law, and why it was kept or dropped."""
    ranking = result.steps[0].ranking
    out = []
    for c, gain, p in zip(ranking.candidates, ranking.elpd_gain, ranking.probability, strict=True):
        if c.effect.id in result.found:
            reason = "kept: best on held-out cycles" if c.effect.id == result.found[0] else "kept: entered later"
        elif not result.found:
            reason = result.steps[0].why
        else:
            reason = f"dropped: {result.found[0]} predicts held-out cycles better"
        out.append(
            {
                "id": c.effect.id,
                "title": c.effect.title,
                "family": c.effect.family,
                "score": c.t,
                "t": c.t,
                "elpd_gain": float(gain),
                "probability": float(p),
                "size_kN": c.size_kN,
                "reason": reason,
            }
        )
    return out


def words(record: Mapping[str, Any]) -> list[str]:
    """Plain sentences for a reader in a hurry, the verdict first."""
    heads = {
        "adequate": "The base law is adequate: nothing beyond noise was found.",
        "named": "Something was left out of the base law, and it can be named.",
        "family": "Something was left out of the base law; this recording cannot tell which of a family it is.",
        "unknown": "Something was left out of the base law that the effects of the catalogue do not explain.",
    }
    words = [heads[record["verdict"]]]
    for effect in record["effects"]:
        part = "A part of it: " if effect["partial"] else ""
        words.append(f"{part}{effect['statement']} Likely cause: {effect['cause']}")
    gamma = record["shift"].get("gamma")
    if gamma and record["effects"]:
        before, after = gamma["before"]["mean"], gamma["after"]["mean"]
        words.append(f"The speed coefficient gamma goes from {before:+.4f} to {after:+.4f} s/mm when it is modelled.")
    if record["unknown"]:
        words.append(record["unknown"]["words"])
    if record["next_test"]:
        words.append(f"Next test: {record['next_test']}")
    return words


def channels(evidence: Evidence, base: Refit, shown: Refit) -> xr.Dataset:
    """Measured and modelled force over all that a page draws."""
    names = ("time_s", "position_mm", "speed_mm_s", "slip_mm", "travel_m", "direction")
    data = {name: ("sample", evidence.stack(name)) for name in names}
    data |= {
        "run": ("sample", evidence.run.astype(np.float64)),
        "block": ("sample", evidence.block.astype(np.float64)),
        "weight": ("sample", evidence.weight),
        "force_kN": ("sample", evidence.force_kN),
        "before_kN": ("sample", base.force_kN),
        "after_kN": ("sample", shown.force_kN),
    }
    return xr.Dataset(data, attrs={"schema": SCHEMA})
