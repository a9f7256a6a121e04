"""The calibration test is itself tested: right on simulated ranks, and failing on a fit that is broken on purpose.

The long run is ``python -m shj_validation.calibrate device -n 300`` (``make calibrate``); its page is kept in reports/.
"""

import json
import sys

import numpy as np
import pytest

import shj_validation.calibrate


@pytest.fixture(scope="module")
def calibrate():
    return shj_validation.calibrate


def rows_of(calibrate, ranks):
    return [{"number": i, "ranks": {"K": int(r)}, "below": {"K": (r + 0.5) / 100}} for i, r in enumerate(ranks)]


def test_uniform_ranks_fail_as_seldom_as_is_said(calibrate):
    """400 sets of 200 uniform ranks: the p-value is below 0.05 in 5 % of them, within 4 Monte-Carlo errors."""
    rng = np.random.default_rng(5)
    _, _, smallest = calibrate.envelope(200, sets=2000)
    seen = np.array([calibrate._smallest(rng.integers(0, 100, 200)) for _ in range(400)])
    p_values = np.mean(smallest[None, :] <= seen[:, None], axis=1)
    assert abs(np.mean(p_values < 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 400)


@pytest.mark.parametrize("kind", ["narrow", "wide", "shifted"])
def test_wrong_ranks_are_found(calibrate, kind):
    """Intervals too narrow by a third, too wide by a half, and means off by half a standard deviation."""
    rng = np.random.default_rng(6)
    truth, posterior = rng.standard_normal(300), rng.standard_normal((300, 99))
    scale, shift = {"narrow": (0.67, 0.0), "wide": (1.5, 0.0), "shifted": (1.0, 0.5)}[kind]
    ranks = np.sum(shift + scale * posterior < truth[:, None], axis=1)
    assert calibrate.failing(calibrate.judge_ranks(rows_of(calibrate, ranks))) == ["K"]
    right = np.sum(posterior < truth[:, None], axis=1)
    assert calibrate.failing(calibrate.judge_ranks(rows_of(calibrate, right))) == []


def test_it_goes_on_where_it_was_killed(calibrate, tmp_path, monkeypatch):
    monkeypatch.setattr(calibrate, "ProcessPoolExecutor", lambda *_, **__: _Serial())
    monkeypatch.setattr(calibrate, "as_completed", lambda futures: futures)
    made = []
    monkeypatch.setattr(calibrate, "draw", lambda number, seed, **_: made.append(number) or {"number": number})
    path = tmp_path / "calibration.jsonl"
    calibrate.run(3, 1, path, progress=False)
    text = path.read_text(encoding="utf-8")
    path.write_text(text[:-5], encoding="utf-8")  # the last line was being written
    assert [row["number"] for row in calibrate.run(5, 1, path, progress=False)] == [0, 1, 2, 3, 4]
    assert made == [0, 1, 2, 2, 3, 4]
    assert len([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]) == 6
    with pytest.raises(SystemExit, match="draws of other settings"):
        calibrate.run(3, 2, path, progress=False)


class _Serial:
    """A pool that does the work when it is asked for."""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def submit(self, function, *arguments, **options):
        value = function(*arguments, **options)
        return type("Done", (), {"result": lambda _: value})()


def test_the_other_parts_draw_the_same_again(calibrate, tmp_path, monkeypatch):
    monkeypatch.setattr(calibrate, "ProcessPoolExecutor", lambda *_, **__: _Serial())
    monkeypatch.setattr(calibrate, "as_completed", lambda futures: futures)
    first, again = (calibrate.run(2, 1, tmp_path / name, part="margins", progress=False) for name in ("a", "b"))
    assert [row["below"] for row in first] == [row["below"] for row in again]
    assert set(first[0]["ranks"]) == {"new device", "device of a set never tested", "level", "spread", "between sets"}
    assert first[0]["truth"] != first[1]["truth"]
    text = calibrate.page(first, "this", "picture.png", "margins")
    assert "two tested devices" in text
    assert "| new device |" in text


@pytest.mark.slow
def test_fits_under_noise_are_counted(calibrate, tmp_path):
    rows = calibrate.run(3, 1, tmp_path / "noise.jsonl", part="noise", effects=True, workers=1, progress=False)
    assert [row["effect"] for row in rows] == ["slack", "wear", "asymmetry"]
    assert {"K", "Fy", "beta", "gamma", "ratio", "slack.size", "slack.softness", "slack.start"} == set(rows[0]["z"])
    text = calibrate.noise_page(rows, "this")
    assert "3 devices" in text
    assert all(f"| {row['noise']} | 1 |" in text for row in rows)


def test_the_command_line_answers(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["calibrate", "--help"])
    with pytest.raises(SystemExit, match="0"):
        shj_validation.calibrate.main()


@pytest.mark.slow
@pytest.mark.parametrize(("broken", "n"), [("white", 60), ("jacobian", 150), ("signed", 60)])
def test_a_broken_fit_fails(calibrate, tmp_path, broken, n):
    """Each breakage alone makes the test fail; unbroken, the same draws pass.

    The Jacobian shows only where the prior is felt, in beta: from 120 draws on.
    """
    options = {"short": True, "max_steps": 2000, "wobble_mm": 0.0, "progress": False}
    rows = calibrate.run(n, 4100, tmp_path / "broken.jsonl", broken=broken, **options)
    assert calibrate.failing(calibrate.judge_ranks(rows))


@pytest.mark.slow
def test_an_unbroken_fit_passes(calibrate, tmp_path):
    rows = calibrate.run(150, 4100, tmp_path / "good.jsonl", short=True, max_steps=2000, wobble_mm=0.0, progress=False)
    assert calibrate.failing(calibrate.judge_ranks(rows[:60])) == []
    assert calibrate.failing(calibrate.judge_ranks(rows)) == []
