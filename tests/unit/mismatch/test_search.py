"""The search for effects: which of equals comes first, and what a later effect must not undo."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from shj_bayes.inference.run import Run
from shj_bayes.mismatch import search, unknown
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.name import Candidate, _simplest, compare
from shj_bayes.mismatch.refit import View, extend_starts, refit
from shj_bayes.mismatch.regions import regions_of
from shj_bayes.mismatch.verdict import judge
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.protocol import Block

EFFECTS, PRIORS = catalogue(), read_priors("afc")
BLOCKS = (Block(24.0, 0.067, 3), Block(48.0, 0.033, 3))


def free_law(model: DeviceModel, more: dict[str, float] | None = None) -> np.ndarray:
    """Law parameters of an ordinary device in the unbounded space."""
    law = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "gamma": 0.0} | (more or {})
    pairs = zip(model.law_names, model.laws_of_parameters, strict=False)
    return np.array([float(prior.to_free(np.asarray(law[name]))) for name, prior in pairs])


def candidate(name: str, gain: np.ndarray) -> Candidate:
    """An effect that gains so much in each block."""
    return Candidate(EFFECTS[name], None, gain, gain / 10, 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(("share", "first"), [(0.9, "load_offset"), (0.5, "tension_step")])
def test_the_simplest_comes_first_only_when_it_is_as_good(share: float, first: str) -> None:
    """Few cycles scatter so widely that no difference is beyond chance; half of the gain is still not as good."""
    assert len(EFFECTS["load_offset"].parameters) < len(EFFECTS["tension_step"].parameters)
    few = np.array([0.0, 0.0, 30.0, 1.0, 0.0, 0.0])
    tried = [candidate("tension_step", few), candidate("load_offset", share * few[::-1])]
    chosen = _simplest(tried, 0, {0: lambda: True, 1: lambda: True})
    assert tried[chosen].effect.id == first


@pytest.fixture(scope="module")
def fitted() -> tuple[search.Setting, search.Refit]:
    """A device that takes 4 kN more in push than in pull, and the law with wear and asymmetry fitted to it."""
    even = simulate_device(Truth(gamma=0.0), seed=3, rate_Hz=5.0, n_runs=1, blocks=BLOCKS)[0]
    uneven = replace(even, force_kN=even.force_kN + 4.0)
    evidence = evidence_of([Run(uneven, motion_of(uneven))], 1000)
    model = DeviceModel(1, PRIORS)
    fit = refit(evidence, model, [free_law(model)])
    for k, name in enumerate(("wear", "asymmetry"), start=1):
        model = DeviceModel(1, PRIORS, tuple(EFFECTS[e] for e in ("wear", "asymmetry")[:k]))
        fit = refit(evidence, model, extend_starts(fit, model, EFFECTS[name]))
    tried = tuple(EFFECTS[e] for e in ("wear", "asymmetry", "load_offset"))
    setting = search.Setting(evidence, evidence, evidence, regions_of(evidence), tried, 1, lambda _: None)
    return setting, fit


def test_an_effect_that_is_there_is_not_given_up_for_a_worse_fit_of_itself(
    fitted: tuple[search.Setting, search.Refit], monkeypatch: pytest.MonkeyPatch
) -> None:
    setting, fit = fitted
    asymmetry = fit.model.effects[1]
    without, honest = search._in_place_of(setting, fit, asymmetry)
    assert [e.id for e in without.model.effects] == ["wear"]
    assert {c.effect.id for c in honest} == {"asymmetry", "load_offset"}

    def from_a_bad_start(_setting: search.Setting, _current: search.Refit) -> list[Candidate]:
        before = without.held_out_squares(setting.evidence)
        return [compare(setting.evidence, before, without, effect) for effect in (asymmetry, EFFECTS["load_offset"])]

    monkeypatch.setattr("shj_bayes.mismatch.name.effect_size", lambda *_: 1.0)
    monkeypatch.setattr(search, "_try_rest", from_a_bad_start)
    own, other = search._in_place_of(setting, fit, asymmetry)[1]
    assert own.fit is fit
    honest_gain = max(float(c.gain.sum()) for c in honest if c.effect is asymmetry)
    assert own.gain.sum() == pytest.approx(honest_gain, rel=0.05)
    assert honest_gain > 1000.0
    assert other.gain.sum() == 0.0


def test_the_state_in_which_a_test_began_is_not_predicted_for_its_first_cycle() -> None:
    """A clearance of 3 mm, 2.7 of it ahead at first: the other cycles say nothing of that, the prior says 1.5 mm."""
    plain = simulate_device(Truth(gamma=0.0), seed=5, rate_Hz=5.0, n_runs=1, blocks=BLOCKS)[0]
    evidence = evidence_of([Run(plain, motion_of(plain))], 1000)
    model = DeviceModel(1, PRIORS, (EFFECTS["slack"],))
    z = free_law(model, {"slack.size": 3.0, "slack.softness": 0.3, "slack.start": 0.9})
    noise = np.random.default_rng(1).standard_normal(evidence.force_kN.size)
    loose = replace(evidence, force_kN=View(evidence, model).force(z) + noise)
    fit = refit(loose, model, [z])
    assert [name for name, known in zip(model.names, model.predicted, strict=True) if not known] == ["slack.start"]
    first = slice(*loose.block_edges[:2])
    assert np.std(fit.held_out_residual(loose)[first]) < 1.3
    blind = replace(model, effects=(replace(EFFECTS["slack"], initial=()),))
    assert np.std(replace(fit, model=blind).held_out_residual(loose)[first]) > 2.0


def test_a_step_of_leaving_out_that_leads_nowhere_is_halved() -> None:
    """A change of clamping in one and a half half-cycles: without either, the other says little of when it began."""
    plain = simulate_device(Truth(gamma=0.0), seed=5, rate_Hz=5.0, n_runs=1, blocks=BLOCKS)[0]
    evidence = evidence_of([Run(plain, motion_of(plain))], 1000)
    model = DeviceModel(1, PRIORS, (EFFECTS["tension_step"],))
    law = {"tension_step.size": -0.2, "tension_step.begin": 0.5, "tension_step.length": 0.1, "tension_step.side": 0.0}
    z = free_law(model, law)
    noise = np.random.default_rng(1).standard_normal(evidence.force_kN.size)
    fit = refit(replace(evidence, force_kN=View(evidence, model).force(z) + noise), model, [z])
    stepped = replace(evidence, force_kN=fit.force_kN + fit.residual_kN)
    far, near = (fit.held_out_squares(stepped, check=check) for check in (False, True))
    own = stepped.block_sums(fit.residual_kN**2)
    assert np.max(far / own) > 2.0 * np.max(near / own)
    assert np.median(near / far) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(("gain", "enough"), [([70.0, 1.0, 1.0, -0.5], False), ([6.0, 5.0, 4.0, -0.5], True)])
def test_a_gain_in_one_block_alone_names_nothing(gain: list[float], enough: bool) -> None:
    tried = replace(candidate("stick_slip", np.array(gain)), relative=np.array([0.0, 0.0, 0.0, 1.0]))
    assert tried.t < search.GAIN_SE
    assert search._beyond_chance(tried, sum(gain)) == enough


@pytest.mark.parametrize(("left_kN", "word"), [(3.2, "unknown"), (1.0, "named")])
def test_what_no_load_cell_would_do_is_not_explained(left_kN: float, word: str) -> None:
    """Over few half-cycles nothing is beyond chance; 7 % of Fy on which neighbours agree is still not noise."""
    repeat = SimpleNamespace(p_value=0.5, size_kN=0.1, rms_kN=0.1)
    step = SimpleNamespace(why="p = 0.0628: nothing more than noise explains", repeat=repeat)
    base = SimpleNamespace(capacity_kN=45.0)
    known = SimpleNamespace(rmse_kN=left_kN)
    result = SimpleNamespace(base=base, known=known, steps=(step, step), rankings={}, found=("two_stage",))
    judged = judge(result, 2.0, 0.6)  # type: ignore[arg-type]
    assert judged.word == word
    assert ("3.2 kN root mean square" in judged.reason) == (word == "unknown")


def test_what_is_left_has_a_size_where_no_region_is_sure(
    fitted: tuple[search.Setting, search.Refit], monkeypatch: pytest.MonkeyPatch
) -> None:
    setting, fit = fitted
    formula = SimpleNamespace(coordinate="", text=None, words="", share=None)
    monkeypatch.setattr(unknown, "largest_region", lambda *_: (0.0, None))
    monkeypatch.setattr(unknown, "find_formula", lambda *_, **__: formula)
    quiet = SimpleNamespace(alarm=None, repeat=SimpleNamespace(p_value=0.5), line=SimpleNamespace(p_value=0.5))
    result = SimpleNamespace(base=fit, final=fit, found=("wear",), steps=(quiet,))
    said = unknown.describe_unknown(setting.evidence, result, setting.regions)  # type: ignore[arg-type]
    assert said["size_kN"] == fit.rmse_kN > 0.5
    assert f"is {fit.rmse_kN:.2g} kN, root mean square" in said["words"]


def test_thinning_keeps_the_way_to_each_turning_point_beside_the_evidence() -> None:
    recording = simulate_device(Truth(gamma=0.0), seed=3, rate_Hz=50.0, n_runs=1, blocks=BLOCKS)[0]
    run = Run(recording, motion_of(recording))
    whole, thin = (evidence_of([run], n).histories[0] for n in (10**6, 500))
    assert whole.time_s.size == recording.n_samples
    assert thin.time_s.size <= 500 + thin.motion.n_half
    dense, sparse = whole.turned[0], thin.turned[0]
    for k in range(thin.motion.n_half - 1):
        last = slice(dense.motion.start[k + 1] - 8, dense.motion.start[k + 1])
        own = slice(sparse.motion.start[k + 1] - 8, sparse.motion.start[k + 1])
        np.testing.assert_allclose(sparse.rows[:, own], dense.rows[:, last], rtol=1e-12, atol=1e-12)
