"""What devices have in common, against the same model worked out the long way."""

import itertools
import math

import numpy as np
import pytest

from shj_bayes.mismatch.hypothesis import LOG_PRIOR_ODDS, PRIOR_INCLUSION
from shj_bayes.mismatch.sets import ALONE, DiagnosedDevice, common_to, log_shared, together
from shj_bayes.results.codec import from_json
from shj_bayes.results.diagnosis import EvidenceRecord

N = 401  # points of the brute force, over each share

A, B = "capacity over travel", "capacity over speed"


def device(evidence, *, own=(), sizes=None):
    """A device of classes a and b from the log Bayes factors of a, b and both."""
    classes = (A, B)
    sets = ((), (0,), (1,), (0, 1))
    nats = tuple(n + LOG_PRIOR_ODDS * len(s) for n, s in zip((0.0, *evidence), sets, strict=True))
    names = dict.fromkeys(own, "effect")
    rest = {c: f"curve {c}" for c in classes if c not in own}
    return evidence_of(classes, sets, nats, own=names, written=rest, size_percent=sizes or {A: 2.0, B: 2.0})


def evidence_of(classes, sets, nats, **said):
    said = {"own": {}, "written": {}, "size_percent": {}, "change_percent": {}, "fitted": 0} | said
    return DiagnosedDevice(EvidenceRecord(classes=classes, sets=sets, nats=nats, log_odds=LOG_PRIOR_ODDS, **said))


def by_brute_force(devices):
    """Probabilities of the combinations, and that each device has a: sums over shares and what devices hold."""
    theta = (np.arange(N) + 0.5) / N
    weights, has_a = {}, {}
    for combination in itertools.product((False, True), repeat=2):
        prior = math.prod(PRIOR_INCLUSION if c else 1.0 - PRIOR_INCLUSION for c in combination)
        shares = [theta if c else np.array([ALONE]) for c in combination]
        a, b = np.meshgrid(*shares, indexing="ij")
        each, held = [], []
        for one in devices:
            bayes = np.exp(np.array(one.evidence.nats) - LOG_PRIOR_ODDS * one.holds.sum(axis=1))
            parts = [(1 - a) * (1 - b), a * (1 - b) * bayes[1], (1 - a) * b * bayes[2], a * b * bayes[3]]
            each.append(sum([parts[0], *parts[1:]]))
            held.append((parts[1] + parts[3]) / each[-1])
        likelihood = math.prod(each)
        weights[combination] = prior * likelihood.mean()
        has_a[combination] = [float((likelihood * h).mean() / likelihood.mean()) for h in held]
    total = sum(weights.values())
    devices_a = [sum(weights[c] / total * has_a[c][i] for c in weights) for i in range(len(devices))]
    return {c: w / total for c, w in weights.items()}, devices_a


def test_a_device_alone_has_the_prior_of_the_search():
    of_a_device = PRIOR_INCLUSION * 0.5 + (1.0 - PRIOR_INCLUSION) * ALONE
    assert of_a_device == pytest.approx(PRIOR_INCLUSION)


def test_one_class_is_the_integral_over_the_share():
    factors = np.array([1.2, -0.7, 3.0, 0.4, 2.2])
    theta = (np.arange(200_001) + 0.5) / 200_001
    likelihood = np.prod(1.0 - theta + theta * np.exp(factors)[:, None], axis=0)
    by_hand = math.log(likelihood.mean()) - np.log(1.0 - ALONE + ALONE * np.exp(factors)).sum()
    gain, share = log_shared(factors)
    assert gain == pytest.approx(by_hand, abs=1e-8)
    assert share == pytest.approx((likelihood * theta).mean() / likelihood.mean(), abs=1e-8)


def test_one_device_is_worked_out_by_hand():
    gain, share = log_shared(np.array([math.log(9.0)]))
    assert gain == pytest.approx(math.log((1 + 9) / 2 / (1 - ALONE + 9 * ALONE)))
    assert share == pytest.approx((1 / 6 + 9 / 3) / ((1 + 9) / 2))


@pytest.mark.parametrize(("n", "enters"), [(2, False), (3, True)])
def test_three_devices_that_cannot_tell_two_classes_make_a_set_sure(n, enters):
    """Two that each have the one or the other may still have one each: 7 % at even odds, where 5 % are given up."""
    shared, combinations = common_to([device((40.0, 40.0, 40.0), own=(A,))] * n)
    first, second = shared
    assert (first.enters, {str(first.id), str(second.id)}) == (enters, {A, B})
    nothing_shared = dict(combinations)[frozenset()]
    apart = PRIOR_INCLUSION / (1.0 - PRIOR_INCLUSION) / ((n + 1) * (2.0 * ALONE) ** n) * 2.0
    assert nothing_shared == pytest.approx(1.0 / (1.0 + apart), rel=0.2)


@pytest.mark.parametrize(
    "evidence",
    [
        [(2.0, -1.0, 1.0)] * 6,  # a in all, weak in each
        [(2.0, 1.8, 2.1)] * 6,  # a or b: the same thing in two words
        [(1.5, 1.6, 3.1)] * 6,  # both, and they do not disturb one another
        [(40.0, 0.0, 40.0), *[(-2.0, -1.0, -3.0)] * 5],  # one device alone, beyond doubt
    ],
    ids=["weak", "alike", "both", "one"],
)
def test_two_classes_agree_with_brute_force(evidence):
    devices = [device(one) for one in evidence]
    exact, exact_devices = by_brute_force(devices)
    shared, combinations = common_to(devices)
    found = dict(combinations)
    for combination, p in exact.items():
        key = frozenset(c for c, has in zip((A, B), combination, strict=True) if has)
        assert found.get(key, 0.0) == pytest.approx(p, abs=0.03)
    a = next(one for one in shared if str(one.id) == A)
    assert a.of_devices == pytest.approx(exact_devices, abs=0.03)


def test_weak_in_each_and_certain_in_eight():
    assert not any(one.enters for one in common_to([device((1.2, -1.0, 0.2))])[0])
    shared, _ = common_to([device((1.2, -1.0, 0.2))] * 8)
    a, b = (next(one for one in shared if str(one.id) == name) for name in (A, B))
    assert a.probability > 0.95
    assert a.enters
    assert a.holders == tuple(range(8))
    assert not any(a.alone)
    assert b.probability < 0.05
    assert not b.enters


def test_one_device_in_eight_is_not_its_set():
    shared, _ = common_to([device((300.0, 0.0, 300.0), own=(A,)), *[device((-3.0, -1.0, -4.0))] * 7])
    a = next(one for one in shared if str(one.id) == A)
    assert a.probability < 0.5
    assert a.holders == (0,)
    assert a.alone == (True, *[False] * 7)


def test_two_words_for_one_thing_are_not_counted_twice():
    shared, _ = common_to([device((4.0, 3.9, 4.0))] * 8)
    a, b = (next(one for one in shared if str(one.id) == name) for name in (A, B))
    assert a.probability + b.probability == pytest.approx(1.0, abs=0.1)
    assert a.enters
    assert a.rivals == (B,)
    assert not b.enters


def test_what_is_too_small_to_be_followed_does_not_enter():
    shared, _ = common_to([device((3.0, -1.0, 2.0), sizes={A: 0.3, B: 2.0})] * 8)
    a = next(one for one in shared if str(one.id) == A)
    assert a.probability > 0.95
    assert not a.enters


def test_devices_that_say_nothing_of_a_class_do_not_count():
    silent = evidence_of((B,), ((), (0,)), (0.0, LOG_PRIOR_ODDS - 1.0))
    lone = common_to([device((1.2, -1.0, 0.2))] * 8)
    with_silent = common_to([*[device((1.2, -1.0, 0.2))] * 8, silent])
    p, q = (next(one for one in c[0] if str(one.id) == A).probability for c in (lone, with_silent))
    assert p == pytest.approx(q, abs=0.01)


def test_the_order_of_devices_does_not_matter():
    devices = [device((x, 0.5 * x, 1.2 * x)) for x in (0.3, 2.0, -1.0, 1.1)]
    one, other = common_to(devices), common_to(devices[::-1])
    assert [s.probability for s in one[0]] == pytest.approx([s.probability for s in other[0]])


RECORD = {
    "classes": [A, B], "log_odds": LOG_PRIOR_ODDS, "own": {A: "x"}, "written": {B: "y"}, "size_percent": {A: 1.0},
    "change_percent": {A: -1.0},
    "sets": [[], [0], [0, 1]], "nats": [0.0, 3.0, -1.0], "fitted": 2,
}  # fmt: skip


def test_a_record_is_read_as_it_was_written():
    one = DiagnosedDevice(from_json(EvidenceRecord, RECORD))
    assert one.evidence.classes == (A, B)
    assert one.holds.tolist() == [[False, False], [True, False], [True, True]]
    assert one.log_factors([A, B], np.array([LOG_PRIOR_ODDS, -50.0]))[0] == pytest.approx(3.0 - LOG_PRIOR_ODDS)


@pytest.mark.parametrize(
    "change", [{"sets": [[], [0], [2]]}, {"nats": [0.0, 1.0]}, {"nats": [0.0, math.nan, 1.0]}, {"sets": [[0, 1]] * 3}]
)
def test_a_damaged_record_is_refused(change):
    with pytest.raises(ValueError, match="set"):
        DiagnosedDevice(from_json(EvidenceRecord, RECORD | change))


def held(folder, *, own=(), sampled=False, evidence=(1.2, -1.0, 0.2)):
    """A diagnosed device whose own model holds what its diagnosis found."""
    return DiagnosedDevice(device(evidence, own=own).evidence, folder, ("effect",) * len(own), sampled)


def test_what_enters_is_fitted_with_what_the_device_shows_alone():
    """A class of the set that only the set makes certain is added; nothing is fitted that a fit holds already."""
    own = {"own": (A,), "evidence": (30.0, -1.0, 29.0)}
    rest = [("bare", held(f"weak {i}")) for i in range(6)]
    found = together([*rest, ("bare", held("quick", **own)), ("bare", held("full", **own, sampled=True))])
    (one,), effects = found
    assert effects == {f"weak {i}": (f"curve {A}",) for i in range(6)} | {"quick": ("effect",)}
    assert one.classes[0].effects == (f"curve {A}",) * 6 + ("effect",) * 2


def test_a_device_that_has_it_not_is_left_as_it_is():
    found = together(
        [
            *[("bare", held(f"{i}", evidence=(3.0, -1.0, 2.0))) for i in range(7)],
            ("bare", held("without", evidence=(-9.0, -1.0, -10.0))),
        ]
    )
    assert "without" not in found[1]
    assert len(found[1]) == 7


def test_all_devices_stand_behind_the_sets():
    found = together([(name, held(f"{name} {i}")) for name in ("bare", "zinc") for i in range(2)])
    assert [(one.set, len(one.devices)) for one in found[0]] == [("bare", 2), ("zinc", 2), ("", 4)]
