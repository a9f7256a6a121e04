"""Devices of the development trials, and their first looks, made when they are first asked for."""

from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

import shj_validation.trials
from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import DiagnosisResult, diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.recording import Recording


@pytest.fixture(scope="session")
def trials() -> ModuleType:
    """The development trials: `simulate`, `EFFECTS`, `OUTSIDE`."""
    return shj_validation.trials


def first_look(recordings: list[Recording], **options: object) -> DiagnosisResult:
    """Diagnose two runs without sampling."""
    runs = runs_of(recordings)
    return diagnose(runs, DeviceModel(len(runs), read_priors("afc")), DiagnoseOptions(quick=True, **options))  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def look() -> Callable[..., DiagnosisResult]:
    """A first look at recordings; options as of `diagnose`."""
    return first_look


@pytest.fixture(scope="session")
def with_noise_of_30_s() -> list[Recording]:
    """A device without any effect, and slow noise of 1 kN with a memory of 30 s."""
    module, rng = shj_validation.trials, np.random.default_rng(77)
    out = []
    for r in module.simulate({}, 12, noise="white"):
        slow = module.ar1(float(np.exp(-1.0 / (30.0 * module.RATE_HZ))), r.time_s.size, rng)
        out.append(Recording(r.time_s, r.displacement_mm, r.force_kN + slow))
    return out
