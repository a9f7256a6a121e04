"""General methods beside our diagnosis: what they are asked, how they are counted, and that they see no key."""

import json
import subprocess
import sys

import numpy as np
import pytest

from shj_bayes.errors import ProofError
from shj_validation.proof.cases import stated_key
from shj_validation.proof.make import make
from shj_validation.rivals import __main__ as command
from shj_validation.rivals.__main__ import SEALED, main, written
from shj_validation.rivals.methods import METHODS
from shj_validation.rivals.question import SENSE, WORDS, answer, question_of, ranked
from shj_validation.rivals.score import OURS, better, is_right, mcnemar, median, summary, table, threshold

ROW = {"detectable": True, "kind": "one", "each": {}}


def row_of(*names):
    return ROW | {"each": {name: [0.1, 1000.0] for name in names}}


@pytest.mark.parametrize(
    ("ours", "theirs", "counts", "p"),
    [
        ([1] * 9 + [0], [0] * 8 + [0, 1], (9, 1), 22 / 1024),  # 2 (1 + 10) / 2^10
        ([1] * 5, [0] * 5, (5, 0), 2 / 32),
        ([1, 0, 1, 1], [0, 1, 1, 1], (1, 1), 1.0),
        ([1, 0], [1, 0], (0, 0), 1.0),
    ],
)
def test_mcnemar_by_hand(ours, theirs, counts, p):
    assert mcnemar(ours, theirs)[:2] == counts
    assert mcnemar(ours, theirs)[2] == pytest.approx(p)


def test_threshold_lets_three_of_a_hundred_through():
    gains = np.random.default_rng(1).permutation(np.arange(100) / 100.0)
    assert sum(gain > threshold(gains) for gain in gains) == 3
    assert threshold([-0.3, -0.1, -0.2]) == 0.0  # what explains nothing is never something that is missing


def test_median_has_the_interval_of_order_statistics():
    # of ten values the second and the ninth hold the median with 97.9 %, the third and the eighth with 89.1 %
    assert median(range(1, 11)) == (5.5, 2.0, 9.0)
    assert median([3.0]) == (3.0, 3.0, 3.0)
    assert median([1.0, 2.0, np.inf])[0] == 2.0


@pytest.mark.parametrize(
    ("word", "row", "right"),
    [
        ("distance", row_of("prying"), True),
        ("position", row_of("prying"), True),  # one is a function of the other
        ("travel", row_of("prying"), False),
        ("slip", row_of("slack"), True),  # a regression has no word for a gap
        ("slack", row_of("slack"), True),
        ("travel", row_of("slack"), False),
        ("distance", row_of("prying", "slack"), True),  # either of two
        ("slip", row_of("prying", "slack"), True),
    ],
)
def test_the_coordinate_that_leads_is_right(word, row, right):
    assert is_right(word, row) is right


def test_direction_leads_only_alone():
    relevance = np.zeros(len(WORDS))
    relevance[SENSE], relevance[WORDS.index("travel")] = 1.0, 0.5
    assert [one["coordinate"] for one in ranked(relevance)] == ["travel", "direction"]
    relevance[WORDS.index("travel")] = 0.01
    assert ranked(relevance)[0]["coordinate"] == "direction"
    assert ranked(np.zeros(len(WORDS))) == []


def test_counted_alike_and_a_better_rival_is_said():
    rows = [ROW] * 6 + [{"detectable": False, "kind": "nothing", "each": {}}] * 4
    good = {"right": True, "found": True, "cycles": 1.0, "earthquake": 1.0, "seconds": 5.0}
    quiet = good | {"right": False, "found": False}
    ours = [good] * 6 + [quiet] * 3 + [good]
    rival = [good | {"cycles": 0.9, "earthquake": 4.0}] * 4 + [good | {"right": False}] * 2 + [quiet] * 4
    lines = summary(rows, {OURS: ours, "rival": rival})
    assert (lines[1]["right"]["hits"], lines[1]["right"]["n"]) == (4, 6)
    assert (lines[0]["alarms"]["hits"], lines[1]["alarms"]["hits"]) == (1, 0)
    assert lines[1]["against"]["right"] == (2, 0, 0.5)
    assert lines[1]["against"]["earthquake"][:2] == (4, 0)
    assert better(lines) == ["fewer false alarms (rival)", "cycles left out (rival)"]
    assert "| rival | 4 of 6: 67 % (22 to 96) |" in table(lines)


class Means:
    """A method that needs no package: means over bins of one coordinate in each direction."""

    def __init__(self, word):
        self.column, self.points, self.relevance, self.permutes = WORDS.index(word), 1, None, True

    def __call__(self, x, y, cycle, known):
        cells = self.cells(x)
        n = np.maximum(np.bincount(cells, minlength=40), 1)
        self.means = np.bincount(cells, weights=y, minlength=40) / n
        return self

    def cells(self, x):
        return 2 * np.minimum((20 * x[:, self.column]).astype(int), 19) + (x[:, SENSE] > 0)

    def predict(self, x):
        return self.means[self.cells(x)]


def test_question_holds_what_the_law_leaves_out(tmp_path):
    key = stated_key("prying", 0.2, seed=3, rate_Hz=5.0)
    files = written(tmp_path, key)
    assert files[-1].name == "motion.csv"
    shaken = np.loadtxt(files[-1], delimiter=",")
    assert shaken.shape[1] == 2  # of its force nothing is told
    q = question_of(files[:-1], key.reversal, *shaken.T)
    for inputs in (q.inputs, q.new_inputs):  # shares of what was tested, in what was not, too
        assert np.abs(inputs[:, :SENSE] - 0.5).max() < 0.5 + 1e-9
    near, far = answer(q, Means("distance")), answer(q, Means("amplitude"))
    assert near["gain"] > 0.5 > far["gain"]
    assert near["by_permutation"][0]["coordinate"] in ("position", "distance")
    truth = make(key, heldout=True)[2].recording.force_kN
    wrong = [float(np.mean((truth - force) ** 2)) for force in (q.new_force_kN, np.array(near["earthquake_kN"]))]
    assert wrong[1] < 0.7 * wrong[0]  # the noise is in both


def test_without_the_packages_it_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("shj_validation.rivals.__main__.PACKAGES", {"no_such_package": "no-such-package"})
    with pytest.raises(SystemExit):
        main([str(tmp_path)])
    assert "pip install 'shj-bayes[rivals]'" in capsys.readouterr().err


def test_nothing_that_knows_keys_is_loaded_behind_the_fence():
    code = (
        "import shj_validation.rivals.worker, sys;"
        "from shj_validation.proof.fence import FORBIDDEN;"
        "print([name for name in sys.modules if name.startswith(FORBIDDEN)])"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["gaussian process", "sparse regression", "Karhunen-Loeve", "boosting"])
@pytest.mark.filterwarnings("ignore")
def test_methods_find_a_plain_dependence(name):
    for package in ("sklearn", "pysindy", "FoKL"):
        pytest.importorskip(package, reason=f"{package} is not installed (pip install -e .[rivals])")
    rng = np.random.default_rng(5)
    x = np.column_stack([rng.random((600, SENSE)), rng.choice([-1.0, 1.0], 600)])
    y = x[:, SENSE] * (x[:, WORDS.index("travel")] - 0.5) ** 2 * 8.0 + 0.05 * rng.standard_normal(600)
    cycle = np.arange(600) // 30
    first = METHODS[name](x[:450], y[:450], cycle[:450].astype(float), None)
    again = METHODS[name](x[:400], y[:400], cycle[:400].astype(float), first)
    for model in (first, again):
        assert np.mean((y[450:] - model.predict(x[450:])) ** 2) < 0.3 * np.var(y)
    if first.relevance is not None:
        assert ranked(first.relevance)[0]["coordinate"] == "travel"


def test_changed_answers_are_refused(tmp_path, monkeypatch):
    key = stated_key("prying", 0.2, seed=3)
    monkeypatch.setattr(command, "PACKAGES", {})
    monkeypatch.setattr(command, "keys_of", lambda folder: ("shj-bayes/proof/1", 3, [key]))
    monkeypatch.setattr(command, "ask", lambda *given: None)
    (tmp_path / "proof").mkdir()
    (tmp_path / "proof" / "commitment.json").write_text('{"trials": []}')
    for place in ("development", "trials"):
        (tmp_path / "out" / place / "answers").mkdir(parents=True)
        (tmp_path / "out" / place / "answers" / "0001.json").write_text("{}")
    assert "not opened yet" in command.run(tmp_path / "proof", tmp_path / "out", [], development=1)
    held = json.loads((tmp_path / "out" / SEALED).read_text())
    assert sorted(held["answers"]) == ["development/answers/0001.json", "trials/answers/0001.json"]
    (tmp_path / "out" / "trials" / "answers" / "0001.json").write_text('{"boosting": {}}')
    with pytest.raises(ProofError, match="is not what"):
        command.run(tmp_path / "proof", tmp_path / "out", [], development=1)
