"""A diagnosis made by hand, for every verdict."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from shj_bayes.results.codec import from_json
from shj_bayes.results.diagnosis import DiagnosisRecord

FY, HALF = 80.0, 95.0


def channels(*, found: bool, n_runs: int = 2) -> xr.Dataset:
    """Sine cycles of two amplitudes with 15 % prying that the base law does not have."""
    parts: list[dict[str, np.ndarray]] = []
    rng = np.random.default_rng(3)
    travel = 0.0
    for run in range(1, n_runs + 1):
        angle = np.linspace(0, 2 * np.pi * 6, 1500, endpoint=False)
        cycle = (angle // (2 * np.pi)).astype(int)
        amplitude = np.where(cycle < 3, 0.5 * HALF, HALF)
        x = amplitude * np.sin(angle)
        q = np.where(np.cos(angle) >= 0, 1.0, -1.0)
        step = np.abs(np.diff(x, prepend=x[0]))
        turn = np.flatnonzero(np.diff(q, prepend=q[0]))
        moved = np.cumsum(step)
        since = moved - np.maximum.accumulate(np.where(np.isin(np.arange(x.size), turn), moved, 0.0))
        base = 0.93 * FY * 0.8 ** (run - 1) * q * np.tanh(since / 4)
        true = FY * 0.8 ** (run - 1) * q * np.tanh(since / 4) * (1 - 0.15 * (x / HALF) ** 2)
        parts.append(
            {
                "time_s": angle * 10,
                "position_mm": x,
                "speed_mm_s": np.abs(amplitude * np.cos(angle)) / 9.5,
                "slip_mm": since,
                "travel_m": (travel + moved) / 1000,
                "direction": q,
                "run": np.full(x.size, float(run)),
                "block": (cycle + 6 * (run - 1)).astype(float),
                "weight": (since > 0.5).astype(float),
                "force_kN": true + rng.normal(0, 0.5, x.size),
                "before_kN": base,
                "after_kN": true if found else base,
            }
        )
        travel += float(moved[-1])
    return xr.Dataset({k: ("sample", np.concatenate([p[k] for p in parts])) for k in parts[0]})


def made(verdict: str, **change: Any) -> DiagnosisRecord:
    """The record of a diagnosis with other fields."""
    return from_json(DiagnosisRecord, record(verdict, "device") | change)


def record(verdict: str, name: str) -> dict[str, Any]:
    """Content of diagnosis.json for one verdict."""
    found = verdict in ("named", "family")
    effect = {
        "id": "prying",
        "family": "even_in_position",
        "statement": f"Clamping falls by 15 % at full stroke. {name}",
        "equation": "Fy -> Fy (1 - p (|x|/L)^m)",
        "probability": 0.97,
        "parameters": {"size": {"mean": 0.1512, "sd": 0.0046, "q05": 0.1436, "q95": 0.1588, "unit": "1"}},
        "title": "Clamping lost away from mid-stroke",
        "cause": "Prying: the plates bend.",
        "shows": "Plateaus that droop.",
        "size_kN": 11.87,
    }
    unknown = {
        "coordinate": "position",
        "shape": [{"centre": float(c), "push_kN": float(np.sin(c)), "pull_kN": None} for c in range(8)],
        "formula": None,
        "period": {"coordinate": "position", "length": 17.3, "unit": "mm", "share": 0.6},
        "size_kN": 4.321,
        "words": f"The misfit reaches 4.3 kN. {name}",
    }
    quality = {"rmse_kN": 3.217, "noise_kN": 0.512, "heldout_rmse_kN": 3.334, "energy_error_percent": 2.61}
    after = {"rmse_kN": 0.521, "noise_kN": 0.512, "heldout_rmse_kN": 0.538, "energy_error_percent": 0.13}
    cycle = np.arange(1.0, 13.0)
    return {
        "schema": "shj-bayes/diagnosis/1",
        "device": name,
        "verdict": verdict,
        "p_value": 0.37 if verdict == "adequate" else 0.0004,
        "effects": [effect] if found else [],
        "family": [{"id": "prying", "probability": 0.61}, {"id": "velocity", "probability": 0.39}]
        if verdict == "family"
        else [],
        "location": [
            {
                "coordinate": "position",
                "interval": [-9.5, 9.5],
                "unit": "mm",
                "direction": "both",
                "runs": [1, 2],
                "size_kN": 5.678,
                "share": 0.31,
                "p_value": 0.0123,
            }
        ],
        "unknown": unknown if verdict == "unknown" else None,
        "before": quality,
        "after": after if found else quality,
        "heldout": {"scheme": "leave one cycle out", "elpd_gain": 123.4, "se": 21.5, "n_blocks": 12},
        "shift": {
            "Fy": {"before": {"mean": 74.41, "sd": 0.31}, "after": {"mean": 80.12, "sd": 0.25}},
            "gamma": {"before": {"mean": 0.0159, "sd": 0.0006}, "after": {"mean": 0.0003, "sd": 0.0007}},
        },
        "aliases": [
            {"pair": ["prying", "velocity"], "correlation": 0.953},
            {"pair": ["inertia", "base law"], "correlation": 0.99},
        ],
        "next_test": "Repeat one amplitude at a fifth of the speed." if verdict == "family" else None,
        "candidates": [
            {"id": "prying", "score": 9.1, "elpd_gain": 123.4, "probability": 0.97, "reason": "kept: best", "t": 9.1},
            {"id": name, "score": -0.2, "elpd_gain": -1.7, "probability": 0.0, "reason": f"dropped {name}"},
        ],
        "inputs": [{"name": name, "sha256": "ab" * 32}, {"name": "run2.csv", "sha256": None}],
        "fy_kN": 74.41,
        "seconds": 31.4,
        "seed": 11,
        "quick": verdict == "adequate",
        "energy": {
            "cycle": cycle.tolist(),
            "measured_J": (1e4 * cycle).tolist(),
            "before_J": (1.05e4 * cycle).tolist(),
            "after_J": (1e4 * cycle).tolist(),
        },
    }


def write(folder: Path, verdict: str, name: str, scale: float = 1.0) -> Path:
    """Write a diagnosis whose forces are so many times those of a connection."""
    folder.mkdir(parents=True, exist_ok=True)
    data = channels(found=verdict in ("named", "family"))
    for force in ("force_kN", "before_kN", "after_kN"):
        data[force] = scale * data[force]
    data.to_netcdf(folder / "diagnosis.nc", engine="h5netcdf")
    (folder / "diagnosis.json").write_text(json.dumps(_scaled(record(verdict, name), scale)), encoding="utf-8")
    return folder


def _scaled(part: Any, scale: float) -> Any:
    """Forces of a record (and the row of Fy) so many times as large."""
    if isinstance(part, list):
        return [_scaled(one, scale) for one in part]
    if not isinstance(part, dict):
        return part
    return {
        key: {stage: {k: scale * v for k, v in row.items()} for stage, row in value.items()}
        if key == "Fy"
        else scale * value
        if key.endswith("_kN") and isinstance(value, float)
        else _scaled(value, scale)
        for key, value in part.items()
    }
