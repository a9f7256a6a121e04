"""One finished fit of the small device, shared by the tests that read its files."""

from collections.abc import Callable
from pathlib import Path

import pytest

from shj_bayes.inference.fit import Fit, fit
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.sampler import SamplingPlan


@pytest.fixture(scope="session")
def fitted(make_small: Callable[..., Likelihood], tmp_path_factory: pytest.TempPathFactory) -> tuple[Fit, Path]:
    """A converged fit and the folder it was written to."""
    folder = tmp_path_factory.mktemp("fit")
    small = make_small()
    return fit(small.runs, small.model, name="small", key="abc", plan=SamplingPlan(seed=3), folder=folder), folder
