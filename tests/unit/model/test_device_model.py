"""The model of a device: names, runs, effects, and which entry of a vector each run uses."""

import re
from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.model.device import DeviceModel, effects_named, force_with_effects, meaning_of
from shj_bayes.model.effects.effect import Base, catalogue
from shj_bayes.model.history import histories
from shj_bayes.model.law import force_of_laws
from shj_bayes.model.noise import noise_model
from shj_bayes.model.parameters import describe, run_name
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import Block, exact_motion

PRIORS = read_priors("afc")
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))


def model(n_runs: int, noise: str = "slow", effects: tuple[str, ...] = (), **changes: object) -> DeviceModel:
    return DeviceModel(n_runs, PRIORS, effects=effects_named(effects), noise=noise_model(noise), **changes)


def vector(of: DeviceModel, **values: float) -> np.ndarray:
    """One parameter set; what is not stated is at the middle of its prior."""
    theta = of.laws.natural(np.zeros((1, len(of.names))))
    for name, value in values.items():
        theta[0, of.names.index(name.replace("__", "."))] = value
    return theta


@pytest.mark.parametrize(
    ("device", "names"),
    [
        (model(1, "independent"), "K Fy beta gamma sigma"),
        (model(2), "K Fy beta gamma ratio sigma_white sigma_slow tau_slow"),
        (model(2, "ar1"), "K Fy beta gamma ratio sigma phi"),
        (model(2, "student"), "K Fy beta gamma ratio sigma_white sigma_slow tau_slow nu"),
        (model(3, "ar1"), "K Fy beta gamma ratio ratio_3 sigma phi"),
        (model(2, "ar1", free=("gamma", "K")), "K Fy beta gamma ratio K_2 gamma_2 sigma phi"),
        (model(3, "ar1", free=("beta",)), "K Fy beta gamma ratio ratio_3 beta_2 beta_3 sigma phi"),
        (model(1, "ar1", free=("K", "beta", "gamma")), "K Fy beta gamma sigma phi"),
        (model(2, "ar1", speed=False), "K Fy beta ratio sigma phi"),
        (model(2, "ar1", speed=False, free=("gamma",)), "K Fy beta ratio sigma phi"),
        (model(2, "ar1", ("wear", "prying")), "K Fy beta gamma ratio prying.size prying.power wear.size sigma phi"),
    ],
)
def test_names_in_order(device: DeviceModel, names: str) -> None:
    assert " ".join(device.names) == names
    assert [meaning_of(name).name for name in device.names] == list(device.names)
    assert [p.name.rpartition(".")[2] for p in device.laws] == [
        name.rpartition(".")[2].partition("_2")[0].partition("_3")[0] for name in device.names
    ]
    assert all(p.unit and p.meaning for p in map(meaning_of, device.names))
    assert device.law_names + device.noise.parameters == device.names
    assert len(device.law_names) == device.n_law


def test_each_run_takes_its_own_entries() -> None:
    device = model(3, "ar1", free=("K",))
    value = {"K": 10.0, "Fy": 80.0, "beta": 7.0, "gamma": 0.01, "ratio": 0.5, "ratio_3": 0.25}
    value |= {"K_2": 11.0, "K_3": 12.0, "sigma": 1.0, "phi": 0.3}
    theta = np.repeat(vector(device, **value), 2, axis=0)
    assert device.run_laws(theta, 1).tolist() == [[10.0, 80.0, 7.0, 0.01]] * 2
    assert device.run_laws(theta, 2).tolist() == [[11.0, 40.0, 7.0, 0.01]] * 2
    assert device.run_laws(theta, 3).tolist() == [[12.0, 20.0, 7.0, 0.01]] * 2  # ratio_3 is against the FIRST run
    noise = device.noise_values(theta)
    assert {k: v.tolist() for k, v in noise.items()} == {"sigma": [1.0, 1.0], "phi": [0.3, 0.3]}
    assert all(array.flags.c_contiguous for array in (device.run_laws(theta, 2), *noise.values()))


def test_without_speed_gamma_is_nought() -> None:
    device = model(2, speed=False)
    assert device.run_laws(vector(device), 2)[0, 3] == 0.0


@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_the_published_law_is_the_one_without_effects(variant: str) -> None:
    """Also through the sum of effects, of which there are none; and with one of no size."""
    time, motion = exact_motion(BLOCKS, 10.0)
    second = histories([time, time], [motion, motion])[1]
    device = model(2, variant=variant)
    theta = vector(device, K=18.0, Fy=80.0, beta=10.0, gamma=0.01, ratio=0.8)
    law = force_of_laws(motion, np.array([[18.0, 64.0, 10.0, 0.01]]), variant=variant, start_force_kN=5.0)
    np.testing.assert_array_equal(device.force(theta, second, 5.0), law)
    base = Base(18.0, 64.0, 10.0, 0.01, 80.0)
    plain = force_with_effects(second, base, (), variant=variant, start_force_kN=5.0)
    np.testing.assert_allclose(plain, law[0], rtol=1e-11, atol=1e-9)
    uneven = model(2, effects=("asymmetry",), variant=variant)
    own = dict(zip(device.names, theta[0], strict=True))
    none, some = (vector(uneven, **own, asymmetry__size=size) for size in (0.0, 0.1))
    np.testing.assert_allclose(uneven.force(none, second, 5.0), law, rtol=1e-11, atol=1e-9)
    assert np.abs(uneven.force(some, second, 5.0) - law).max() > 1.0


def test_force_of_many_is_that_of_each() -> None:
    time, motion = exact_motion(BLOCKS, 10.0)
    history = histories([time], [motion])[0]
    for effects in ((), ("wear", "slack")):
        device = model(1, effects=effects)
        theta = device.laws.natural(np.random.default_rng(1).normal(0, 0.5, (4, len(device.names))))
        out = device.force(theta, history, 0.0)
        for j in range(4):
            np.testing.assert_array_equal(device.force(theta[j : j + 1], history, 0.0)[0], out[j])


def test_prior_and_free_space_belong_together() -> None:
    device = model(3, "student", ("slack",), free=("K",))
    z = np.random.default_rng(2).normal(0, 1, (5, len(device.names)))
    np.testing.assert_allclose(device.laws.unbounded(device.laws.natural(z)), z, atol=1e-9)
    expected = sum(p.log_density_free(z[:, i]) for i, p in enumerate(device.laws))
    np.testing.assert_allclose(device.laws.log_density(z), expected, rtol=1e-14)
    values = device.law_values(z[0, : device.n_law])
    assert tuple(values) == device.law_names
    np.testing.assert_allclose(list(values.values()), device.laws.natural(z[:1])[0, : device.n_law], rtol=1e-14)


def test_the_state_at_the_beginning_is_not_predicted() -> None:
    device = model(2, effects=("slack", "wear"))
    assert [name for name, told in zip(device.names, device.predicted, strict=True) if not told] == ["slack.start"]


def test_effects_are_named_in_the_order_of_the_catalogue() -> None:
    assert [e.id for e in effects_named(("wear", "prying"))] == ["prying", "wear"]
    assert effects_named(()) == ()
    with pytest.raises(ModelError, match=r"'slak' is not an effect; known are .*did you mean 'slack'"):
        effects_named(("wear", "slak"))
    bare = model(2, effects=("wear",)).with_effects(())
    assert bare.names == model(2).names


def test_run_names_and_descriptions() -> None:
    assert (run_name("ratio", 2), run_name("ratio", 3), run_name("K", 2)) == ("ratio", "ratio_3", "K_2")
    assert describe("K_2").unit == "kN/mm"
    assert describe("K_2").meaning == "initial stiffness, run 2"
    assert describe("ratio_3").meaning == "sliding force of run 3 / first run"
    assert meaning_of("ratio_3") == describe("ratio_3")
    slack = meaning_of("slack.size")
    assert (slack.name, slack.unit) == ("slack.size", "mm")
    assert slack.meaning.startswith(catalogue()["slack"].title.lower())


@pytest.mark.parametrize("name", ["dep", "K_x", "", "_2"])
def test_unknown_parameters_are_named(name: str) -> None:
    with pytest.raises(ModelError, match=re.escape(f"'{name}' is not a parameter; known are K, Fy, beta")):
        describe(name)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("slack.width", "'slack.width' is not a parameter of an effect of the catalogue"),
        ("capacity_over_travel_50_10.size", "'capacity_over_travel_50_10.size' is not a parameter of an effect"),
        ("slak.size", "'slak' is not an effect; known are"),
        ("K.size", "'K' is not an effect; known are"),
    ],
)
def test_unknown_parameters_of_effects_are_named(name: str, message: str) -> None:
    with pytest.raises(ModelError, match=re.escape(message)):
        meaning_of(name)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_runs": 0}, "a device has 0 runs; allowed are 1 to 9"),
        ({"n_runs": 10}, "a device has 10 runs"),
        ({"free": ("Fy",)}, "'Fy' cannot be freed between runs; allowed are K, beta, gamma"),
        ({"variant": "smooth"}, "model 'smooth' is not known; choose one of published, continuous"),
        ({"effects": effects_named(("wear",)) * 2}, "effect 'wear' is named twice; name each effect once"),
    ],
)
def test_impossible_devices(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=re.escape(message)):
        replace(model(2), **changes)


def test_the_old_word_of_the_published_law_is_understood() -> None:
    assert model(1, variant="seed").variant == "published"
