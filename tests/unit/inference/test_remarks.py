"""What the data do not determine, and what the prior contradicts, is told as values."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.inference.store import remarks_of
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors


@pytest.fixture
def model() -> DeviceModel:
    return DeviceModel(1, read_priors())


def chains(model: DeviceModel, **changed: tuple[float, float]) -> np.ndarray:
    """Draws of the posterior with (middle, width) in units of the prior."""
    rng = np.random.default_rng(2)
    places = [changed.get(name, (0.3, 0.05)) for name in model.names]
    z = np.stack([middle + width * rng.standard_normal(2000) for middle, width in places], axis=1)
    return model.laws.natural(z)


def test_a_recording_that_tells_of_everything_has_no_remark(model):
    assert remarks_of(model, chains(model)) == ()


def test_a_posterior_as_wide_as_its_prior_is_undetermined(model):
    (remark,) = remarks_of(model, chains(model, K=(0.0, 0.9)))
    assert (remark.parameter, remark.kind) == ("K", "undetermined")
    assert remark.prior_q05 < remark.q50 < remark.prior_q95


def test_a_posterior_where_the_prior_holds_it_impossible_is_told(model):
    """A damper of 15 kN under priors of 31 to 355 kN."""
    (remark,) = remarks_of(model, chains(model, Fy=(-3.1, 0.01)))
    assert (remark.parameter, remark.kind) == ("Fy", "against-prior")
    assert remark.q50 < remark.prior_q05


def test_noise_is_nobodys_design_value(model):
    assert remarks_of(model, chains(model, sigma_slow=(-4.0, 0.01), tau_slow=(0.0, 1.0))) == ()


def test_what_an_earlier_test_determined_stays_determined(model):
    laws = {"K": replace(model.priors.of("K"), earlier=True)}
    known = replace(model, priors=replace(model.priors, earlier=laws))
    assert remarks_of(known, chains(known, K=(0.0, 1.0))) == ()
    (remark,) = remarks_of(known, chains(known, K=(3.0, 0.1)))
    assert remark.kind == "against-earlier"
