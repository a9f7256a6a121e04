"""A campaign and a population made by hand."""

import json
import shutil
from pathlib import Path

import numpy as np

from shj_bayes.population.device import Tags
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.quantities import other_priors, population_prior
from shj_bayes.report.device import render_device

LEVEL = {"K": np.log(18.0), "Fy": np.log(80.0), "ratio": np.log(0.8), "gamma": 0.01, "beta": np.log(10.0)}


def population(names: tuple[str, ...], seed: int = 1, shift: float = 0.0) -> PopulationResult:
    """A population made by hand: each set `shift` higher than the one before, two devices each."""
    rng = np.random.default_rng(seed)

    def fits(spread: float) -> dict[str, QuantityPosterior]:
        out = {}
        for name, level in LEVEL.items():
            scale = 0.1 if name == "gamma" else 1.0
            mu = level + scale * (0.05 * rng.standard_normal((400, len(names))) + shift * np.arange(len(names)))
            tau = np.full((400, len(names)), scale * spread)
            hyper = np.tile([level, scale * 0.2, scale * spread, 0.1], (400, 1))
            out[name] = QuantityPosterior(name, mu, tau, hyper, (2,) * len(names))
        return out

    def points(k: int) -> dict[str, tuple[float, ...]]:
        higher = {q: v + (0.1 if q == "gamma" else 1.0) * shift * k for q, v in LEVEL.items()}
        return {q: (v - 0.02, v + 0.02) for q, v in higher.items()}

    groups = tuple(DeviceSet(name, (f"{name} a", f"{name} b"), Tags(), points(k)) for k, name in enumerate(names))
    priors = {name: population_prior(name) for name in LEVEL}
    others = {label: fits(0.3) for label in other_priors(priors["Fy"])}
    return PopulationResult(groups, fits(0.15), others, priors, dict.fromkeys(LEVEL, np.inf), seed)


def make_campaign(root: Path, fitted: Path, hostile_name: str) -> Path:
    """A campaign folder of one good device and three that are failed or strange."""
    folder = root / "devices" / "one-12ab34"
    folder.mkdir(parents=True)
    for name in ("posterior.nc", "fit.json", "summary.json", "summary.csv"):
        shutil.copy(fitted / name, folder / name)
    render_device(folder)
    done = {
        "name": hostile_name,
        "folder": "devices/one-12ab34",
        "status": "done",
        "reason": "",
        "verdict": "tentative",
    }
    failed = {
        "name": "b",
        "folder": "devices/b",
        "status": "failed",
        "reason": "<img src=x onerror=1> is 80000 kN",
        "verdict": "",
    }
    lost = [
        {"name": name, "folder": f"devices/{name}", "status": "done", "reason": "", "verdict": "reliable"}
        for name in "cd"
    ]
    record = {
        "schema": "shj-bayes/campaign/1",
        "name": hostile_name,
        "simulated": True,
        "sets": [{"name": hostile_name, "devices": [done, failed]}, {"name": "other", "devices": lost}],
    }
    (root / "campaign.json").write_text(json.dumps(record), encoding="utf-8")
    return root
