"""A proof goes on where it stopped, refuses strangers, and its transcript shows every change made afterwards."""

import json
import shutil
from copy import deepcopy
from pathlib import Path

import pytest
from click.testing import CliRunner

from shj_bayes.cli import main
from shj_bayes.errors import ProofError
from shj_validation.proof import pool, run, seal
from shj_validation.proof.blind import diagnose_blind
from shj_validation.proof.cases import PROOF_2, draw_keys
from shj_validation.proof.check import check
from shj_validation.proof.run import prove, write_recordings

SEED, N = 80, 3  # of development; its recordings have 5 samples a second


@pytest.fixture(scope="module", autouse=True)
def scores():
    """Scores by key and diagnosis, each made once: most tests here ask for the same three."""
    kept, score = {}, run._score_one

    def once(job):
        name = json.dumps(job, sort_keys=True)
        if name not in kept:
            kept[name] = score(job)
        return deepcopy(kept[name])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "_score_one", once)
        yield kept


@pytest.fixture(scope="module")
def answer(tmp_path_factory):
    """One real diagnosis, given to every trial: what is tested here is the bookkeeping."""
    paths = write_recordings(draw_keys(SEED, N, PROOF_2)[0], tmp_path_factory.mktemp("one"))
    return json.loads(json.dumps(diagnose_blind(paths, intervals=False)))


@pytest.fixture
def canned(answer, monkeypatch):
    """In the place of the processes behind the fence; counts what it was asked."""
    asked = []

    def serve(tasks, workers, done, module=pool.WORKER):
        for task in tasks:
            asked.append(task["name"])
            done(task, answer)

    monkeypatch.setattr(pool, "in_parallel", serve)
    return asked


@pytest.fixture(scope="module")
def whole(answer, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pool, "in_parallel", lambda tasks, workers, done, module: [done(task, answer) for task in tasks])
        folder = tmp_path_factory.mktemp("whole") / "proof"
        return prove(folder, n=N, seed=SEED, workers=1, earlier=True).page.parent


@pytest.fixture
def finished(whole, tmp_path):
    return Path(shutil.copytree(whole, tmp_path / "proof"))


def test_a_finished_proof_checks(finished, scores):
    scores.clear()  # scored again, as a third party would
    lines = check(finished, workers=1)
    assert lines[0] == "3 keys follow from seed 80 and are those that were sealed before the diagnosis"
    assert "the same to the byte" in lines[1]


def test_the_page_and_the_table_hold_every_trial(finished):
    page = (finished / "proof.html").read_text(encoding="utf-8")
    assert "Does it find what was concealed?" in page
    assert seal.sha256(finished / seal.COMMITMENT) in page
    assert len((finished / "trials.csv").read_text(encoding="utf-8").splitlines()) == N + 1


def test_a_stopped_proof_goes_on_under_the_same_commitment(canned, answer, tmp_path, monkeypatch):
    whole = pool.in_parallel

    def stops(tasks, workers, done, module=pool.WORKER):
        done(next(iter(tasks)), answer)
        raise KeyboardInterrupt

    monkeypatch.setattr(pool, "in_parallel", stops)
    folder = tmp_path / "proof"
    with pytest.raises(KeyboardInterrupt):
        prove(folder, n=N, seed=SEED, workers=1)
    sealed = (folder / seal.COMMITMENT).read_bytes()
    assert not (folder / seal.OPENED).exists()
    with pytest.raises(ProofError, match="give the same -n and --seed to go on"):
        prove(folder, n=N, seed=SEED + 1, workers=1)
    monkeypatch.setattr(pool, "in_parallel", whole)
    prove(folder, n=N, seed=SEED, workers=1)
    assert canned == ["0002", "0003"]
    assert (folder / seal.COMMITMENT).read_bytes() == sealed
    check(folder, workers=1)


def test_a_stopped_proof_can_be_opened_with_its_first_trials(canned, answer, tmp_path, monkeypatch):
    """Trials count from the first on without a gap, so that nobody can choose; all keys are opened."""

    def stops(tasks, workers, done, module=pool.WORKER):
        own = list(tasks)
        done(own[0], answer)
        done(own[2], answer)
        raise KeyboardInterrupt

    monkeypatch.setattr(pool, "in_parallel", stops)
    folder = tmp_path / "proof"
    with pytest.raises(KeyboardInterrupt):
        prove(folder, n=N, seed=SEED, workers=1)
    proof = prove(folder, n=N, seed=SEED, workers=1, open_now=True)
    assert (proof.score["n"], proof.score["sealed"], len(proof.score["trials"])) == (1, N, 1)
    assert "1 diagnoses, of the first trials," in check(folder, workers=1)[2]
    _edit(folder / "diagnoses" / "0001.json", lambda record: record.update(verdict="named"))
    with pytest.raises(ProofError, match="has been changed"):
        check(folder, workers=1)


def test_nothing_is_opened_before_anything_is_diagnosed(canned, tmp_path):
    with pytest.raises(ProofError, match="nothing to open"):
        prove(tmp_path / "proof", n=N, seed=SEED, workers=1, open_now=True)


def test_keys_stay_sealed_until_every_diagnosis_is_done(canned, tmp_path, monkeypatch):
    seen = []

    def looks(tasks, workers, done, module=pool.WORKER):
        folder = tmp_path / "proof"
        seen.extend(path.name for path in folder.iterdir())
        raise KeyboardInterrupt

    monkeypatch.setattr(pool, "in_parallel", looks)
    with pytest.raises(KeyboardInterrupt):
        prove(tmp_path / "proof", n=N, seed=SEED, workers=1)
    assert seal.COMMITMENT in seen
    assert seal.OPENED not in seen


def _edit(path, change):
    content = json.loads(path.read_text(encoding="utf-8"))
    change(content)
    path.write_text(json.dumps(content), encoding="utf-8")


TAMPERED = {
    "a diagnosis": (
        lambda d: _edit(d / "diagnoses/0002.json", lambda c: c.update(verdict="named")),
        "diagnosis has been",
    ),
    "a key": (
        lambda d: _edit(d / "keys.json", lambda c: c["trials"][0]["key"]["device"].update(Fy=1.0)),
        "do not follow",
    ),
    "the seed": (lambda d: _edit(d / "keys.json", lambda c: c.update(seed=81)), "do not follow from seed 81"),
    "a nonce": (lambda d: _edit(d / "keys.json", lambda c: c["trials"][1].update(nonce="0")), "not the one that was"),
    "a score": (
        lambda d: _edit(d / "score.json", lambda c: c["trials"][0].update(outcome="right")),
        "score.json is not",
    ),
    "the aims": (
        lambda d: _edit(d / "score.json", lambda c: c["targets"][0].update(verdict="met!")),
        "score.json is not",
    ),
    "the commitment": (
        lambda d: _edit(d / "commitment.json", lambda c: c.update(made="earlier")),
        "is not the one under",
    ),
}


@pytest.mark.parametrize("what", TAMPERED)
def test_every_change_is_noticed(finished, what):
    act, words = TAMPERED[what]
    act(finished)
    with pytest.raises(ProofError, match=words):
        check(finished, workers=1)


def test_a_changed_recording_is_noticed(finished):
    path = finished / "recordings" / "0001" / "run1.csv"
    path.write_text(path.read_text(encoding="utf-8") + "9999,0,0\n", encoding="utf-8")
    with pytest.raises(ProofError, match=r"trial 0001: run1.csv has been changed since it was sealed"):
        check(finished, workers=1)


def test_a_finished_folder_is_not_overwritten(finished):
    with pytest.raises(ProofError, match="holds a finished proof of 3 trials, seed 80"):
        prove(finished, n=N, seed=SEED + 1, workers=1)


def test_page_and_keys_alone_cannot_be_checked():
    """The proof that is kept with the project has neither recordings nor diagnoses; the command says what to do."""
    kept = next((Path(__file__).resolve().parents[3] / "reports").glob("proof-*"))
    with pytest.raises(ProofError, match=r"lacks recordings and diagnoses.*prove -n \d+ --seed \d+"):
        check(kept)


def test_a_folder_without_proof_is_refused_in_words(tmp_path):
    done = CliRunner().invoke(main, ["prove", "--check", str(tmp_path)])
    assert done.exit_code == 1
    assert "has no keys.json: the proof is not finished" in done.output


def test_the_command_asks_for_a_folder():
    done = CliRunner().invoke(main, ["prove", "-n", "2"])
    assert done.exit_code == 2
    assert "--out" in done.output


def test_a_failed_diagnosis_counts_in_no_rate(canned, tmp_path, monkeypatch):
    monkeypatch.setattr(
        pool,
        "in_parallel",
        lambda tasks, workers, done, module: [done(task, {"error": "ModelError: no"}) for task in tasks],
    )
    proof = prove(tmp_path / "proof", n=N, seed=SEED, workers=1)
    assert "false alarms  coordinate right, of the visible" in proof.text
    assert proof.score["failed"] == [1, 2, 3]
    assert proof.score["false_alarms"]["n"] == 0
    assert {target["verdict"] for target in proof.score["targets"]} >= {"NOT MET"}
