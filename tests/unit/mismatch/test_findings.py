"""What of a hypothesis matters: sizes are those of a fit without what does not."""

from __future__ import annotations

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import expit

from shj_bayes.mismatch import content, findings
from shj_bayes.mismatch import hypothesis as sizes
from shj_bayes.mismatch.data import ErrorModel
from shj_bayes.mismatch.fitter import Fitter
from shj_bayes.mismatch.hypothesis import LOG_PRIOR_ODDS
from shj_bayes.mismatch.moves import DIRECTION, Search
from shj_bayes.mismatch.periodic import Chatter

ACTS = {"delay": "motion", "constant": "added", "added over constant": "added", "bearing": "added"}


def _hypothesis(*names):
    members = tuple(SimpleNamespace(of=SimpleNamespace(id=name, action=ACTS.get(name, "capacity"))) for name in names)
    return SimpleNamespace(members=members, key=frozenset(names), log_weight=0.0, state=None)


def _quiet(**found):
    """Search in which the noise is that of a load cell."""
    quiet = SimpleNamespace(fluctuation=0.0, is_rough=False, data=SimpleNamespace(scale_kN=1.0))
    return Search(Fitter([], quiet), **found)


@pytest.fixture
def search(monkeypatch):
    """Hypotheses with the sizes of their classes; a pair that stands in for each other is small together."""
    known = {
        ("delay", "speed"): (0.004, 0.006),
        ("speed",): (0.019,),
        ("delay",): (0.014,),
        ("wear",): (0.003,),
        ("delay", "wear"): (0.02, 0.002),
        ("taper",): (0.008,),
    }
    found = {frozenset(names): _hypothesis(*names) for names in known}

    def draws(data, h, place, z):
        """Every tenth draw is half as large again."""
        return known[tuple(m.of.id for m in h.members)][place] * np.array([1.0] * 9 + [1.5])

    monkeypatch.setattr(sizes, "_sizes", draws)
    monkeypatch.setattr(sizes, "drawn_from", lambda *_: None)
    own = {"data": None, "matters": 0.01, "matters_of": lambda h, place: 0.01, "best_within": lambda key: 0.0}
    return SimpleNamespace(found=found | {frozenset(): _hypothesis()}, **own)


def test_of_two_classes_that_stand_in_for_each_other_one_stays(search):
    assert findings.that_matter(search, search.found[frozenset({"delay", "speed"})]) == {"speed"}


def test_a_small_class_is_left_out(search):
    assert findings.that_matter(search, search.found[frozenset({"delay", "wear"})]) == {"delay"}
    assert findings.that_matter(search, search.found[frozenset({"wear"})]) == frozenset()


def test_sizes_are_those_there_are_where_the_smaller_set_was_not_fitted(search):
    del search.found[frozenset({"delay"})]
    assert findings.that_matter(search, search.found[frozenset({"delay", "wear"})]) == {"delay"}


def test_a_constant_is_as_large_as_it_is_also_where_the_law_could_make_up_for_it(monkeypatch):
    """The law makes no constant, but where it begins loaded its slopes may look like one."""
    data = SimpleNamespace(blocks=SimpleNamespace(used=np.ones(40), n_samples=np.ones(40)), scale_kN=10.0)
    monkeypatch.setattr(sizes, "force_of", lambda data, h, place, z: np.full((len(z), 40), -3.0))
    monkeypatch.setattr(sizes, "_law_slopes", lambda *_: np.ones((40, 1)))
    for name, size in (("added over constant", 0.3), ("taper", 0.0)):
        h = _hypothesis(name)
        h.state = SimpleNamespace(z=np.zeros(1))
        assert sizes.size_of(data, h, 0) == pytest.approx(size, abs=1e-12)


def test_a_class_matters_when_the_upper_limit_of_its_size_does(search):
    assert findings.that_matter(search, search.found[frozenset({"taper"})]) == {"taper"}


def test_the_upper_limit_of_a_size_is_of_forces_that_the_recording_allows(monkeypatch):
    """A formula whose force is known to 10 % and its size and length are not has draws of any force."""
    data = SimpleNamespace(blocks=SimpleNamespace(used=np.ones(40), n_samples=np.ones(40)), scale_kN=10.0)
    h = _hypothesis("speed")
    ridge = np.array([[1.0, -1.0], [-1.0, 1.0]])  # of the logarithms: the product is known
    h.state = SimpleNamespace(z=np.zeros(2), covariance=9.0 * ridge + 0.005 * np.eye(2))
    shape = np.sign(np.sin(np.arange(40.0)))
    monkeypatch.setattr(sizes, "_law_slopes", lambda *_: np.ones((40, 1)))

    def forces(data, h, place, z):
        bent = 1.0 + 0.5 * z[:, 0] ** 2
        return 0.05 * (np.exp(z.sum(axis=1)) * bent)[:, None] * shape

    monkeypatch.setattr(sizes, "force_of", forces)
    size = sizes.size_of(data, h, 0)
    assert size == pytest.approx(0.005, rel=0.1)
    assert sizes.largest_size_of(data, h, 0) == pytest.approx(1.17 * size, rel=0.07)
    h.state.covariance = ridge + 9.0 * np.eye(2)
    assert sizes.largest_size_of(data, h, 0) > 3.0 * size


@pytest.mark.parametrize(
    ("left", "verdict"), [(0.03, findings.DiagnosisVerdict.NAMED), (0.12, findings.DiagnosisVerdict.UNKNOWN)]
)
def test_what_is_left_within_strokes_that_chatter_is_no_more_than_the_teeth(left, verdict):
    """Smooth functions within a stroke take up the mean of the teeth, too."""
    out = _quiet(chatter=Chatter(0.1, 0.5, np.ones(2), 0.0, 1.0))
    assert findings._verdict(out, (), 1.0, 0.0, left)[0] == verdict


def test_a_class_is_there_or_what_the_formulas_of_larger_ones_miss(search, monkeypatch):
    """One after another, beside all that are larger; the largest is there."""
    monkeypatch.setattr(findings, "size_of", lambda data, h, place: (0.1, 0.012, 0.08)[place])
    known = {frozenset({"delay", "taper"}): 3.0, frozenset({"delay", "wear"}): -4.0, frozenset({"wear", "taper"}): 0.0}
    search.found = {key: _hypothesis(*sorted(key)) for key in known}
    least = {frozenset({"delay", "taper"}): -9.0, frozenset({"delay", "wear"}): -50.0}
    search.best_within = lambda key: least.get(key, -900.0)
    asked = []

    def missed(out, h, rest, larger):
        asked.append((h.key - rest.key, larger))
        return known[rest.key]

    monkeypatch.setattr(findings, "_missed_instead", missed)
    h = _hypothesis("delay", "wear", "taper")
    shares = findings.truly_there(search, h, h.key)
    assert asked == [({"taper"}, {"delay": 0.1}), ({"wear"}, {"delay": 0.1, "taper": 0.08})]
    assert sum(shares.values()) == pytest.approx(1.0)
    assert sum(p for key, p in shares.items() if "wear" in key) == pytest.approx(expit(-3.0))
    assert sum(p for key, p in shares.items() if "taper" in key) == pytest.approx(expit(4.0))
    assert all("delay" in key for key in shares)
    assert findings.truly_there(search, h, frozenset({"wear"})) == {frozenset({"wear"}): 1.0}
    assert findings.truly_there(search, h, frozenset()) == {frozenset(): 1.0}


@pytest.mark.parametrize(("size", "away", "is_name"), [
    (0.0136, 0.0098, False),  # within what matters, but it leaves more of the curve than it explains
    (0.0136, 0.0060, True),
    (0.08, 0.0150, True),  # within a fifth
    (0.08, 0.0170, False),
])  # fmt: skip
def test_a_formula_that_leaves_more_of_a_curve_than_it_explains_is_not_its_name(size, away, is_name, monkeypatch):
    form = SimpleNamespace(of=SimpleNamespace(id="taper", action="capacity"), start=np.zeros(1))
    as_curve, as_form = _hypothesis("taper"), SimpleNamespace(members=(form,), log_weight=-50.0)
    fitter = SimpleNamespace(
        metric=SimpleNamespace(data=None), forms=lambda h, place: [form], fitted=lambda *_: as_form
    )
    out = SimpleNamespace(data=None, fitter=fitter, best_within=lambda key: -100.0)
    monkeypatch.setattr(sizes, "size_of", lambda data, h, place: size)
    monkeypatch.setattr(findings, "largest_size_of", lambda data, h, place: size)
    monkeypatch.setattr("shj_bayes.mismatch.moves.force_distance", lambda data, a, b: away)
    assert (findings._followed(out, as_curve, 0) is as_form) == is_name


@pytest.mark.parametrize(
    ("nats", "verdict"),
    [(-3.2, "adequate"), (-1.0, "family"), (2.4, "family"), (4.0, "named")],  # 4, 27, 92 and 98 % that it is there
)
def test_that_nothing_is_missing_must_hold_with_95_per_cent_as_every_verdict_must(nats, verdict, monkeypatch):
    drift = _hypothesis("drift")
    drift.log_weight, drift.state = nats, None
    nothing = _hypothesis()
    nothing.state = None
    out = _quiet(found={h.key: h for h in (nothing, drift)})
    monkeypatch.setattr(findings, "that_matter", lambda out, h: h.key)
    monkeypatch.setattr(findings, "truly_there", lambda out, h, key: {key: 1.0})
    monkeypatch.setattr(findings, "_split", lambda out, h, dropped: h)
    monkeypatch.setattr(findings, "discrepancy_size", lambda out, state: 0.0)
    monkeypatch.setattr(findings, "_p_value", lambda out: 0.0)
    found = SimpleNamespace(size=0.02, named=True, names=(("drift", 1.0),))
    monkeypatch.setattr(findings, "_findings", lambda out, h, top, p: ((found,) * len(top), h))
    answer = findings.answer_of(out)
    assert (answer.verdict, bool(answer.findings)) == (verdict, verdict != "adequate")


def test_a_class_in_every_hypothesis_is_there_with_a_probability_of_1_at_most(monkeypatch):
    """Sums of weights of 10^4 nats pass 1 by rounding, and a probability beyond 1 is refused when it is written."""
    sets = [("drift",), ("drift", "taper"), ("drift", "wear"), ("drift", "slip")]
    hypotheses = [_hypothesis(*names) for names in sets]
    for h, nats in zip(hypotheses, (0.0, -0.4, -1.1, -2.3), strict=True):
        h.log_weight, h.state = 54321.123456789 + nats, None
    monkeypatch.setattr(findings, "that_matter", lambda out, h: h.key)
    monkeypatch.setattr(findings, "truly_there", lambda out, h, key: {key: 1.0})
    monkeypatch.setattr(findings, "_split", lambda out, h, dropped: h)
    monkeypatch.setattr(findings, "discrepancy_size", lambda out, state: 0.0)
    monkeypatch.setattr(findings, "_p_value", lambda out: 0.0)
    monkeypatch.setattr(findings, "_findings", lambda out, h, top, p: ((), h))
    answer = findings.answer_of(_quiet(found={h.key: h for h in hypotheses}))
    assert answer.inclusion["drift"] == pytest.approx(1.0, abs=1e-15)
    assert answer.inclusion["drift"] <= 1.0


@pytest.mark.parametrize(("times", "p"), [(1.0, 1.0), (20.0, 0.05)])
def test_the_p_value_allows_for_all_classes_that_are_looked_for(times, p):
    """Where each Bayes factor is 1 there is nothing to be said, however many there are."""
    names = [f"capacity over {word}" for word in ("taper", "wear", "slip")]
    found = {}
    for n in range(4):
        for own in combinations(names, n):
            found[frozenset(own)] = h = _hypothesis(*own)
            h.log_weight = n * LOG_PRIOR_ODDS + (np.log(times) if n else 0.0)
    looked = [SimpleNamespace(of=SimpleNamespace(id=name)) for name in names]
    out = SimpleNamespace(found=found, fitter=Fitter(looked, None))
    assert findings._p_value(out) == pytest.approx(p)


@pytest.mark.parametrize(("size_kN", "capped"), [(0.30, True), (0.29, False)])
def test_noise_at_the_most_that_a_load_cell_may_have_is_capped(size_kN, capped):
    """Then no two dependences are looked for in the place of a curve: what is left fluctuates."""
    setting = SimpleNamespace(size_kN=lambda data: size_kN)
    metric = SimpleNamespace(setting=setting, data=SimpleNamespace(noise_most_kN=0.3))
    assert ErrorModel.is_capped.fget(metric) == capped


def test_a_curve_without_a_name_is_no_riddle_while_nothing_may_be_missing():
    out = _quiet()
    found = (SimpleNamespace(size=0.02, named=False, names=()),)
    assert findings._verdict(out, found, 0.99, 0.01, 0.0)[0] == "unknown"
    assert findings._verdict(out, found, 0.60, 0.40, 0.0)[0] == "family"


def test_mechanisms_of_one_probability_stand_in_the_order_of_their_words():
    """The order in which a set of words is gone through differs from process to process."""
    words = list("abcdefghij")
    answer = SimpleNamespace(
        verdict=findings.DiagnosisVerdict.FAMILY,
        sets=((frozenset(words), 0.6), (frozenset(), 0.4)),
        findings=(),
        alternatives={},
    )
    classes = {word: SimpleNamespace(action="motion", coordinate=word) for word in words}
    fitter = SimpleNamespace(classes=classes, hidden=frozenset())
    first = SimpleNamespace(history=SimpleNamespace(measured=()))
    out = SimpleNamespace(fitter=fitter, data=SimpleNamespace(blocks=[first]))
    assert [one.id for one in content.family(out, answer)] == words


def test_a_curve_is_not_taken_apart_into_what_was_dropped(monkeypatch):
    """Or what was found would be weighed for ever: dropped, found in the curve, dropped."""
    curve = SimpleNamespace(variant=SimpleNamespace(curve=SimpleNamespace(sides=True)), of=SimpleNamespace(id="x"))
    h = SimpleNamespace(members=(curve,), key=frozenset({"x"}))
    out = SimpleNamespace(data=None, fitter=SimpleNamespace(classes={DIRECTION: None}, fitted=lambda *_: None))
    tried = []
    monkeypatch.setattr(findings, "tolerance", lambda *_: tried.append("apart") or 0.0)
    monkeypatch.setattr(findings, "without", lambda *_: ())
    monkeypatch.setattr(findings, "beside_direction", lambda *_: SimpleNamespace(found={}))
    assert findings._split(out, h, [DIRECTION]) is h
    assert tried == []
    assert findings._split(out, h) is h
    assert tried == ["apart"]
