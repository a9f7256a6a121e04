"""Tiny finished fits that every report test shares."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from shj_bayes.inference.binning import Run
from shj_bayes.inference.fit import fit
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.model.simulate import Truth
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import Recording
from shj_bayes.results.device import DeviceData, read_device

HOSTILE = "<script>alert('x')</script> \"q\" ../../etc/passwd & {{ 7*7 }}"
QUICK = SamplingPlan(max_steps=200, round_steps=200)
LONG = (Block(24.0, 0.067, 3), Block(48.0, 0.034, 3), Block(95.0, 0.017, 4))


Change = Callable[[np.ndarray, np.ndarray], np.ndarray]


def with_force(posterior: Likelihood, change: Change, name: str = "") -> Likelihood:
    """The same device with another measured force, change(displacement, force)."""
    runs = []
    for run in posterior.runs:
        r = run.recording
        force = change(run.motion.displacement_mm, np.array(r.force_kN))
        source = replace(r.source, name=name or r.source.name)
        runs.append(Run(Recording(r.time_s, r.displacement_mm, force, source=source, findings=r.findings), run.motion))
    return make_likelihood(runs, posterior.model)


def fit_to(posterior: Likelihood, folder: Path, name: str = "device") -> None:
    """Fit it with few steps."""
    fit(posterior.runs, posterior.model, name=name, plan=QUICK, folder=folder)


@pytest.fixture(scope="session")
def hostile_name() -> str:
    return HOSTILE


@pytest.fixture(scope="session")
def fitted(tmp_path_factory: pytest.TempPathFactory, small_device: Likelihood) -> Path:
    """Folder of a finished fit whose every name is hostile."""
    folder = tmp_path_factory.mktemp("device")
    fit_to(with_force(small_device, lambda _, f: f, HOSTILE), folder, HOSTILE)
    return folder


@pytest.fixture
def copy_of(fitted: Path, tmp_path: Path) -> Path:
    """A copy of that folder that a test may change."""
    return Path(shutil.copytree(fitted, tmp_path / "copy"))


@pytest.fixture(scope="session")
def well_specified(tmp_path_factory: pytest.TempPathFactory, make_small: Callable[..., Likelihood]) -> DeviceData:
    folder = tmp_path_factory.mktemp("well")
    fit_to(make_small(blocks=LONG, seed=5), folder)
    return read_device(folder)


@pytest.fixture(scope="session")
def misspecified(tmp_path_factory: pytest.TempPathFactory, make_small: Callable[..., Likelihood]) -> DeviceData:
    """Clamping lost away from mid-stroke: the force falls by 15 % towards 95 mm."""
    folder = tmp_path_factory.mktemp("miss")
    clean = make_small(Truth(displacement_noise_mm=0.0, sigma=0.5), blocks=LONG, seed=6)
    fit_to(with_force(clean, lambda x, f: f * (1 - 0.15 * (x / 95) ** 2)), folder)
    return read_device(folder)


@pytest.fixture(scope="session")
def summary(fitted: Path) -> list[dict[str, float]]:
    return list(json.loads((fitted / "summary.json").read_text(encoding="utf-8"))["parameters"])
