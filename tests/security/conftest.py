"""A tiny finished fit whose every name is hostile, for the tests of what comes in and what goes out."""

from pathlib import Path

import pytest

from shj_bayes.inference.fit import fit
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.sampler import SamplingPlan

HOSTILE = "=cmd|' /C calc'!A0 <script>alert('x')</script> \x1b]0;t\x07 \u202egnp.exe ../../etc/passwd {{ 7*7 }}"


@pytest.fixture(scope="session")
def hostile() -> str:
    return HOSTILE


@pytest.fixture(scope="session")
def fitted(tmp_path_factory: pytest.TempPathFactory, small_device: Likelihood) -> Path:
    """Folder of a finished fit."""
    folder = tmp_path_factory.mktemp("fitted")
    plan = SamplingPlan(max_steps=50, round_steps=50)
    fit(small_device.runs, small_device.model, name=HOSTILE, plan=plan, folder=folder)
    return folder
