"""What is foreseen is what the Gaussian algebra says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shj_bayes.errors import PlanError
from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.data import N_OF_RUN, ErrorModel
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.planning.information import _separation, as_read, expected_information, quantity_named
from shj_bayes.planning.plan import WorthOfTest, make_plan
from shj_bayes.planning.protocol import Protocol, ProtocolBlock, Rig, Waveform, proposals
from shj_bayes.planning.rivals import (
    DeviceUnderTest,
    PretestPosterior,
    _zero_within,
    before_any_test,
    class_of,
    common_scales,
    further_devices,
    half_width,
    linearise,
    mechanisms_of,
)
from shj_bayes.report.plan_page import render_plan
from shj_validation.proof.cases import stated_key
from shj_validation.proof.make import make

RIG = Rig(95.0, 40.0, 300.0, 6.0, 5.0)
LONG = Protocol("long", (ProtocolBlock(95.0, 10.0, 2), ProtocolBlock(24.0, 10.0, 2), ProtocolBlock(95.0, 40.0, 2)))
SHORT = Protocol("short", (ProtocolBlock(24.0, 10.0, 1),))
WEAR, HEAT = frozenset({"capacity over travel"}), frozenset({"capacity over heat"})


@pytest.fixture(scope="module")
def heated() -> PretestPosterior:
    """One run of Table 1 on a device that heats by 2.5 %: heating or wear."""
    key = stated_key("thermal", 0.025, seed=4, rate_Hz=5.0)
    runs = runs_of([make(key)[0].recording])
    device = DeviceModel(1, read_priors("afc"), variant=key.reversal)
    scales = common_scales(runs, RIG, (*proposals(RIG), LONG, SHORT))
    return linearise(
        DeviceUnderTest("device", runs, device, ((HEAT, 0.6), (WEAR, 0.4)), frozenset({"velocity"})), scales
    )


def test_shares_are_those_that_were_given(heated: PretestPosterior) -> None:
    assert heated.probabilities == pytest.approx({HEAT: 0.6, WEAR: 0.4})
    assert heated.keys[0] == HEAT
    assert all(b.model.n_runs == 2 and "ratio" in b.model.law_names for b in heated.rivals)
    assert mechanisms_of(HEAT) == ("thermal",)
    assert class_of("wear") == WEAR
    assert class_of("velocity") == frozenset()
    with pytest.raises(PlanError, match="is no mechanism"):
        class_of("waer")


def test_more_test_tells_more(heated: PretestPosterior) -> None:
    long, short = (expected_information(heated, p, 5.0, 1) for p in (LONG, SHORT))
    assert long.entropy < short.entropy < 0.7  # log 2 where nothing is known
    assert short.separation < long.separation
    assert 0.5 < short.of_truth < long.of_truth <= 1.0
    assert max(short.right, 0.75) < long.right <= 1.0  # 0.84 to 0.87, by the machine
    assert expected_information(heated, LONG, 5.0, 1) == long  # same seed, same numbers


def test_a_zero_that_is_off_by_what_matters_is_the_rival_that_says_so(heated: PretestPosterior) -> None:
    """A load cell that is off by 2 % of Fy; without the rival of a constant force the zero may be off so far."""
    key = stated_key("load_offset", 0.02, seed=4, rate_Hz=5.0)
    runs = runs_of([make(key)[0].recording])
    device = DeviceModel(1, read_priors("afc"), variant=key.reversal)
    scales = common_scales(runs, RIG, (*proposals(RIG), LONG, SHORT))
    constant = frozenset({"added over constant"})
    sets = ((constant, 0.5), (frozenset[str](), 0.5))
    known = linearise(DeviceUnderTest("device", runs, device, sets, frozenset({"velocity"}), untold=True), scales)
    assert known.probabilities[constant] > 0.9
    limit = 0.01 * known.sliding_kN / 1.96
    assert all(part.timing.zero_noise_kN <= 1.001 * limit for part in known.old)
    assert _zero_within(heated.old[0], heated.keys, 1.0) is heated.old[0]


def test_the_least_certain_pair_and_form_say_how_far_contenders_are_separation(heated: PretestPosterior) -> None:
    """Two forms of heating and one of wear: the evidence of each form is 1, 2 or 3 nats for outcomes of its own."""
    forms = [next(b for b in heated.rivals if b.key == key) for key in (HEAT, HEAT, WEAR)]
    known = replace(heated, rivals=tuple(replace(b, share=s) for b, s in zip(forms, (0.3, 0.3, 0.4), strict=True)))
    logs = np.full((3, 5, 3), -50.0)
    for i, evidence in enumerate((1.0, 2.0, 3.0)):
        logs[i, :, i] = evidence
    assert _separation(known, logs) == pytest.approx(51.0 - np.log(2.0))
    further = WEAR | {"added over time"}
    beside = replace(known, rivals=(*(replace(b, share=b.share / 2) for b in known.rivals),
                                     replace(forms[2], key=further, share=0.5)))  # fmt: skip
    wider = np.full((4, 5, 4), -50.0)
    wider[:3, :, :3] = logs
    wider[2, :, 3] = wider[3, :, 2] = wider[3, :, 3] = 3.0  # wear with or without a drift: no test shows which
    assert _separation(beside, wider) == pytest.approx(51.0 - np.log(2.0))
    only = replace(beside, rivals=beside.rivals[2:])
    assert _separation(only, wider[2:, :, 2:]) == pytest.approx(0.0)


def test_a_protocol_that_its_samples_do_not_show_comes_behind_all_others(heated: PretestPosterior) -> None:
    """A fast triangle at 20 Hz, which tells more than one slow cycle where its corners are not lost."""
    rig = replace(RIG, rate_Hz=20.0)
    slow = Protocol("slow", (ProtocolBlock(95.0, 10.0, 1),))
    quick = Protocol("quick", (ProtocolBlock(24.0, 40.0, 40, Waveform.TRIANGLE),))
    plan = make_plan([heated], rig, (slow, quick), seed=1).record
    rows = {row.name: row for row in (*plan.candidates, *plan.compared)}
    assert quick.name not in rows or rows["quick"].order < rows["slow"].order
    far, near = (expected_information(heated, p, 20.0, 1) for p in (quick, slow))
    assert far.misread_kN > 0.01 * heated.sliding_kN > near.misread_kN
    assert far.of_truth > near.of_truth


def test_what_the_reader_gets_wrong_is_foreseen(heated: PretestPosterior) -> None:
    """Corners of a fast triangle between few samples are rounded off: the force there is no rival's."""
    wrong = {}
    for waveform in Waveform:
        fast = Protocol(waveform.value, (ProtocolBlock(24.0, 40.0, 4, waveform),))
        data, misread = as_read(heated, fast, 10.0, np.random.default_rng(1))
        wrong[waveform] = float(np.abs(misread * data.blocks.used).max())
    assert wrong[Waveform.TRIANGLE] > 3.0 * wrong[Waveform.SINE]


def test_the_variance_of_one_rival_is_that_of_the_normal_equations(heated: PretestPosterior) -> None:
    first = replace(heated.rivals[0], share=1.0)
    alone = replace(heated, rivals=(first,))
    gamma = quantity_named(alone, "gamma")
    seen = expected_information(alone, LONG, 5.0, 1, gamma)
    data, _ = as_read(alone, LONG, 5.0, np.random.default_rng(np.random.SeedSequence(1, spawn_key=(3,))))
    residual, slope = data.likelihood.at(first.model).residual_and_slope(first.z[None])
    metric = ErrorModel(data, alone.setting, slope[0])
    jacobian = data.likelihood.at(first.model).jacobian(first.z, residual[0])
    of_old_run = np.zeros((metric.other.shape[0], N_OF_RUN))
    white = np.column_stack([metric.whitened(jacobian), metric.other, of_old_run])
    expected = np.linalg.inv(first.gaussian.precision + white.T @ white)[3, 3]
    assert seen.sd is not None
    assert seen.sd == pytest.approx(0.02 * np.sqrt(expected), rel=1e-3)  # gamma has a normal prior of 0.02 s/mm
    assert seen.sd < gamma.now(alone)[1]


def test_a_plan_beats_a_short_test_and_keeps_to_the_rig(heated: PretestPosterior) -> None:
    plan = make_plan([heated], RIG, proposals(RIG), (SHORT,)).record
    best, short = plan.candidates[0], next(r for r in plan.compared if r.name == SHORT.name)
    assert plan.worth is WorthOfTest.YES
    assert best.gain_nats > short.gain_nats
    assert not best.limits_broken
    assert plan.compared[0].name == "Table 1"
    assert "time" in plan.compared[0].limits_broken[0]  # Table 1 takes longer than this rig may
    assert best.minutes <= 6.0


def test_nothing_is_planned_for_what_is_decided(heated: PretestPosterior) -> None:
    shares = {HEAT: 0.99, WEAR: 0.01}
    kept = [next(b for b in heated.rivals if b.key == k) for k in shares]
    sure = replace(heated, rivals=tuple(replace(b, share=shares[b.key]) for b in kept))
    two, one = (make_plan(known, RIG, (LONG, SHORT)).record for known in ([sure, sure], [sure]))
    assert two.worth is WorthOfTest.DECIDED
    assert len(two.devices) == 2
    assert two.candidates == one.candidates  # one test for two devices: the mean of both


def test_a_margin_and_a_wrong_question(heated: PretestPosterior) -> None:
    least = quantity_named(heated, "least")
    mean, sd = least.now(heated)
    assert least.unit == "kN"
    assert 0.0 < sd < 0.05 * mean
    with pytest.raises(PlanError, match="is no question; known are which, force, K"):
        quantity_named(heated, "gama")


def test_before_any_test_speed_is_told_by_a_test_at_several_speeds() -> None:
    rig = Rig(95.0, 40.0, 300.0, 6.0, 10.0)
    one, several = (
        Protocol("one", (ProtocolBlock(48.0, 40.0, 4),)),
        Protocol("several", (ProtocolBlock(48.0, 40.0, 2), ProtocolBlock(48.0, 4.0, 1))),
    )
    known = before_any_test(DeviceModel(1, read_priors("afc")), common_scales((), rig, (one, several)))
    assert known.keys[0] == frozenset()
    gamma = quantity_named(known, "gamma")
    assert gamma.now(known)[1] == pytest.approx(0.02)
    first, second = (expected_information(known, p, 10.0, 1, gamma) for p in (one, several))
    assert second.sd is not None
    assert first.sd is not None
    assert second.sd < first.sd < 0.02


def test_before_any_test_no_loops_of_rivals_are_drawn(tmp_path: Path) -> None:
    """Each curve is as likely above 0 as below it: the two loops would be one."""
    known = before_any_test(DeviceModel(1, read_priors("afc")), common_scales((), RIG, (LONG, SHORT)))
    plan = make_plan([known], RIG, (LONG, SHORT))
    page = render_plan(tmp_path, plan.record, plan).read_text(encoding="utf-8")
    assert "The best protocol" in page
    assert "Where they part" not in page


def test_further_devices_follow_the_spread() -> None:
    rng = np.random.default_rng(1)
    forces = 60.0 * np.exp(0.03 * rng.standard_normal(6))
    few = further_devices(forces, [0.005] * 6)
    many = further_devices(60.0 * (forces / 60.0) ** 4, [0.005] * 6)
    assert few.n_further is not None
    assert many.n_further is None or many.n_further > few.n_further
    # Against simulation: the 5 % fractile of samples of 12, with the exact factor.
    x = rng.standard_normal((4000, 12))
    estimate = x.mean(axis=1) - 1.6449 * x.std(axis=1, ddof=1)
    spread = (np.quantile(estimate, 0.95) - np.quantile(estimate, 0.05)) / 2.0
    assert half_width(12) == pytest.approx(spread, rel=0.15)
    with pytest.raises(PlanError, match="two or more"):
        further_devices([60.0], [0.01])
