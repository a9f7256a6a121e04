"""The diagnosis page says what the files say, in words, and shows hostile names as text."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from page_tools import Page, check_safe

from shj_bayes.errors import ReportError
from shj_bayes.report.diagnosis import render_diagnosis
from shj_bayes.report.diagnosis_numbers import parity, profile
from shj_bayes.report.diagnosis_words import VERDICTS, per_cent, shape_table

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
        "shape": [{"centre": float(c), "push_kN": np.sin(c), "pull_kN": None} for c in range(8)],
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


def write(folder: Path, verdict: str, name: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    channels(found=verdict in ("named", "family")).to_netcdf(folder / "diagnosis.nc", engine="h5netcdf")
    (folder / "diagnosis.json").write_text(json.dumps(record(verdict, name)), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory, hostile_name: str) -> dict[str, Page]:
    root = tmp_path_factory.mktemp("diagnosis")
    return {v: Page(render_diagnosis(write(root / v, v, hostile_name))) for v in VERDICTS}


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_renders_in_words(pages: dict[str, Page], verdict: str, hostile_name: str) -> None:
    page = pages[verdict]
    first = page.raw[: page.raw.index("<nav")]
    sign, colour, sentence = VERDICTS[verdict]
    assert f'<span class="badge {colour}">{sign} {verdict}</span>' in first
    assert sentence in first
    assert first.count("<img") == 2
    assert ("First look: intervals are approximate." in page.text) == (verdict == "adequate")
    check_safe(page)
    assert page.outside == []
    assert len(page.raw) < 3_000_000
    assert " ".join(hostile_name.split()) in page.text
    assert "<script" not in page.raw


def test_numbers_are_those_of_the_record(pages: dict[str, Page]) -> None:
    page = pages["named"]
    exact = [attrs["value"] for attrs in page.all("data")]
    for value in (0.1512, 74.41, 80.12, 0.0159, 0.0003, 5.678, 123.4, -1.7):
        assert repr(value) in exact
    for text in ("3.33", "0.538", "below 0.001", "0.012", "up to 11.9 kN, 16 % of the sliding force", "97 %", "123.4"):
        assert text in page.text
    assert "Prying: the plates bend." in page.raw[: page.raw.index("<nav")]
    assert "dep not bounded" in page.text
    assert "dep between" in page.text
    assert "ab" * 32 in page.text


def test_family_and_unknown_say_their_own(pages: dict[str, Page]) -> None:
    family, unknown = pages["family"].text, pages["unknown"].text
    assert "61 %" in family
    assert "39 %" in family
    assert "Repeat one amplitude at a fifth of the speed." in family
    assert "17.3 mm of position" in unknown
    assert "up to" not in unknown.partition("What no effect explains")[0]
    assert "4.32 kN" in unknown


def test_aliases_are_words(pages: dict[str, Page]) -> None:
    text = pages["named"].text
    assert "This displacement history cannot tell “Clamping lost away from mid-stroke” from “" in text
    assert "the base law takes it up" in text


def test_nothing_found_shows_one_law(pages: dict[str, Page]) -> None:
    assert "with what was found" not in pages["adequate"].text
    assert "No effect was added to the law." in pages["adequate"].text


def parts(residual: Any) -> np.ndarray:
    """Parity of a hand-made residual(x, q) on an even grid."""
    x = np.tile(np.linspace(-HALF, HALF, 960), 2)
    q = np.repeat([1, -1], 960)
    p = parity(x, q, np.asarray(residual(x, q), dtype=float))
    return np.array([p.odd_even, p.odd_odd, p.even_even, p.even_odd, p.rest])


@pytest.mark.parametrize(
    ("place", "residual"),
    [
        (0, lambda x, q: -q * (x / HALF) ** 2),  # prying, speed
        (1, lambda x, q: x / HALF),  # stiffness after sliding
        (2, lambda x, q: np.full(x.size, 2.0)),  # load offset
        (2, lambda x, q: np.where(q > 0, 3.0, 3.0 * (x / HALF) ** 2) + np.where(q > 0, (x / HALF) ** 2, 1.0)),
        (3, lambda x, q: q * x / HALF),  # taper
    ],
)
def test_parity_of_pure_residuals(place: int, residual: Any) -> None:
    found = parts(residual)
    assert int(np.argmax(found)) == place
    if place != 2:
        assert np.delete(found[:4], place) == pytest.approx(0, abs=1e-9)
    whole = np.sqrt(np.mean(np.square(parts(residual)))) * np.sqrt(5)
    x, q = np.tile(np.linspace(-HALF, HALF, 960), 2), np.repeat([1, -1], 960)
    assert whole == pytest.approx(np.sqrt(np.mean(np.square(residual(x, q)))), rel=1e-6)


def test_parity_parts_add_up_and_noise_does_not_repeat() -> None:
    rng = np.random.default_rng(0)
    x = rng.uniform(-HALF, HALF, 40_000)
    q = rng.choice([-1, 1], 40_000)
    p = parity(x, q, 1.0 + 2.0 * q * x / HALF + rng.normal(0, 3.0, x.size))
    assert p.even_even == pytest.approx(1.0, abs=0.06)
    assert p.even_odd == pytest.approx(2.0 / np.sqrt(3), abs=0.06)
    assert p.odd_even < 0.1
    assert p.rest == pytest.approx(3.0, abs=0.1)


def test_profile_signs_along_the_motion() -> None:
    x = np.tile(np.linspace(0, 10, 100), 2)
    q = np.repeat([1, -1], 100)
    p = profile(x, 2.0 * q, q, np.ones(200, dtype=bool), 5)
    assert p.push_kN == pytest.approx(2.0)
    assert p.pull_kN == pytest.approx(2.0)
    none = profile(x, 2.0 * q, q, q > 0, 5)
    assert np.isnan(none.pull_kN).all()


def test_words_for_sizes_and_tables() -> None:
    assert per_cent(1.17) == "117"
    assert per_cent(0.0123) == "1.2"
    assert shape_table({"x": [1, 2], "y": [3, 4]}) == (["x", "y"], [[1, 3], [2, 4]])
    assert shape_table([[1, 2], [3, 4]])[1] == [[1, 2], [3, 4]]
    assert shape_table(None) == ([], [])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.update(schema="other"), "schema"),
        (lambda r: r.update(verdict="sure"), "verdict"),
        (lambda r: r.pop("candidates"), "lacks candidates"),
        (lambda r: r.update(location=[{}]), "cannot be shown"),
    ],
)
def test_damaged_record_is_one_clear_error(tmp_path: Path, change: Any, message: str) -> None:
    folder = write(tmp_path, "named", "device")
    changed = record("named", "device")
    change(changed)
    (folder / "diagnosis.json").write_text(json.dumps(changed), encoding="utf-8")
    (folder / "diagnosis.html").write_text("old", encoding="utf-8")
    with pytest.raises(ReportError, match=message):
        render_diagnosis(folder)
    assert (folder / "diagnosis.html").read_text(encoding="utf-8") == "old"
    assert {p.name for p in folder.iterdir()} == {"diagnosis.html", "diagnosis.json", "diagnosis.nc"}


def test_missing_or_damaged_files(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match=r"no diagnosis\.json"):
        render_diagnosis(tmp_path)
    folder = write(tmp_path / "a", "named", "device")
    (folder / "diagnosis.nc").write_bytes(b"not channels")
    with pytest.raises(ReportError, match="cannot be read"):
        render_diagnosis(folder)
