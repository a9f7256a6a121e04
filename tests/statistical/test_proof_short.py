"""A short proof with fixed development trials: quiet where nothing is concealed, and the right name where something is.

``make prove`` is the long one. Its seed is never used here; these trials are development, and a regression shows as a
wrong name.
"""

from dataclasses import replace
from pathlib import Path

import pytest

from shj_bayes.cli import PROOF_SEED
from shj_bayes.mismatch import fitter, moves, search
from shj_validation.proof.blind import diagnose_blind
from shj_validation.proof.cases import stated_key
from shj_validation.proof.run import write_recordings
from shj_validation.proof.score import outcome, score_trial
from shj_validation.proof.summary import RIGHT_OUTCOMES

TRIALS = {
    "load_offset": stated_key("load_offset", 0.06, seed=41),
    "prying": stated_key("prying", 0.12, seed=42),
    "asymmetry": stated_key("asymmetry", 0.07, seed=43),
    "amplitude": stated_key("amplitude", -0.025, seed=44),
}
SLOW = pytest.mark.slow
NOTHING = [replace(stated_key("wear", 0.01, seed=seed), effects=(), kind="nothing") for seed in (45, 46)]


def diagnosed(key, folder: Path):
    return diagnose_blind(write_recordings(key, folder), intervals=False)


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """Diagnoses of the trials, each made when it is first asked for."""
    known = {}

    def record(name):
        if name not in known:
            known[name] = diagnosed(TRIALS[name], tmp_path_factory.mktemp(name))
        return known[name]

    return record


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=SLOW if n in ("load_offset", "amplitude") else ()) for n in TRIALS]
)
def test_what_is_concealed_is_named(name, records):
    """Offset and asymmetry may stand in one family (both are even in direction); prying has no such twin.

    Beside an amplitude that is followed late there may be a small change in time, or what its form misses.
    """
    record = records(name)
    allowed = ("right",) if name == "prying" else RIGHT_OUTCOMES
    assert outcome(TRIALS[name], record) in allowed, record["reason"]


@pytest.mark.parametrize("key", [NOTHING[0], pytest.param(NOTHING[1], marks=SLOW)], ids=["45", "46"])
def test_nothing_is_claimed_where_nothing_is_concealed(key, tmp_path):
    assert outcome(key, diagnosed(key, tmp_path)) == "quiet"


def test_the_short_proof_fails_when_naming_is_broken(tmp_path, monkeypatch):
    """Candidates ranked worst first, the gains in the old places, no offset weighed: the same check must not pass."""
    screen = fitter.screen

    def worst_first(*told):
        right = screen(*told)
        gains = [candidate.gain for candidate in right]
        return [replace(candidate, gain=gain) for candidate, gain in zip(right[::-1], gains, strict=True)]

    monkeypatch.setattr(fitter, "screen", worst_first)
    monkeypatch.setattr(search, "_offset_or_direction", lambda found: found)
    assert outcome(TRIALS["asymmetry"], diagnosed(TRIALS["asymmetry"], tmp_path)) != "right"


def test_the_short_proof_fails_when_the_coordinate_is_wrong(tmp_path, monkeypatch):
    """What was found is said of another dependence, with the formula that fits there."""
    for module in (search, moves):
        monkeypatch.setattr(module, "candidates", _without_direction(module.candidates))
    assert outcome(TRIALS["asymmetry"], diagnosed(TRIALS["asymmetry"], tmp_path)) != "right"


def _without_direction(candidates):
    """Candidates but for a difference of push and pull."""
    return lambda *told: [c for c in candidates(*told) if c.of.coordinate != "direction"]


def test_an_unseen_history_is_predicted_once_the_effect_is_known(records):
    row = score_trial(TRIALS["load_offset"], records("load_offset"))
    assert row["detectable"]
    assert row["heldout"]["earthquake_before"] > 2.0
    assert row["heldout"]["earthquake_after"] < 1.5  # the law itself leaves 1.2 to 1.3 on loops that do not slide
    assert row["heldout"]["cycles_after"] < 1.2
    assert abs(row["coverage"]["load_offset.size"]["off_after"]) < 0.005


def test_development_does_not_use_the_seed_of_the_proof():
    """Searched for in all that could run a trial, because a seed that was looked at proves nothing."""
    root = Path(__file__).parents[2]
    scripts = [path for folder in ("tests", "benchmarks", "docs") for path in (root / folder).rglob("*.py")]
    texts = {path: path.read_text(encoding="utf-8") for path in scripts}
    trials = [
        path for path, text in texts.items() if "shj_validation.proof" in text and path != Path(__file__).resolve()
    ]
    assert len(trials) >= 5
    assert [path for path in trials if str(PROOF_SEED) in texts[path]] == []
