"""Devices of the development trials, and their first looks, made when they are first asked for."""

import importlib.util
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from shj_bayes.inference.run import runs_of
from shj_bayes.mismatch.diagnosis import Diagnosis, diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.recording import Recording

ROOT = Path(__file__).parents[3]


@cache
def load_trials() -> ModuleType:
    """The development trials as a module."""
    spec = importlib.util.spec_from_file_location("trials", ROOT / "benchmarks" / "mismatch.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def trials() -> ModuleType:
    """The development trials: `simulate`, `EFFECTS`, `OUTSIDE`."""
    return load_trials()


def first_look(recordings: list[Recording], **options: object) -> Diagnosis:
    """Diagnose two runs without sampling."""
    runs = runs_of(recordings)
    return diagnose(runs, DeviceModel(len(runs), read_priors("afc")), quick=True, **options)  # type: ignore[arg-type]


@pytest.fixture(scope="session")
def look() -> Callable[..., Diagnosis]:
    """A first look at recordings; options as of `diagnose`."""
    return first_look


@pytest.fixture(scope="session")
def with_noise_of_30_s() -> list[Recording]:
    """A device without any effect, and slow noise of 1 kN with a memory of 30 s."""
    module, rng = load_trials(), np.random.default_rng(77)
    out = []
    for r in module.simulate({}, 12, noise="white"):
        slow = module.ar1(float(np.exp(-1.0 / (30.0 * module.RATE_HZ))), r.time_s.size, rng)
        out.append(Recording(r.time_s, r.displacement_mm, r.force_kN + slow))
    return out
