"""Local polynomials are those of scipy, whose import ``check`` need not wait for."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import savgol_coeffs, savgol_filter

from shj_bayes.recording import smoothing as polynomial


@pytest.mark.parametrize(("window", "degree"), [(5, 3), (9, 5), (41, 5), (201, 5)])
def test_weights_and_filter(window, degree):
    values = np.random.default_rng(1).standard_normal(500).cumsum()
    for derivative in (0, 1):
        wanted = savgol_coeffs(window, degree, derivative, 0.1, use="dot")
        assert polynomial.weights(window, degree, derivative, 0.1) == pytest.approx(wanted, abs=1e-9)
    found = polynomial.filtered(values, window, degree, 0.1)
    for derivative, got in enumerate(found):
        wanted = savgol_filter(values, window, degree, derivative, 0.1, mode="interp")
        assert got == pytest.approx(wanted, abs=1e-5)  # scipy loses digits in powers of sample numbers


def test_hermite():
    rng = np.random.default_rng(2)
    knots, values, slopes = np.sort(rng.uniform(0, 9, 12)), rng.standard_normal(12), rng.standard_normal(12)
    at = np.linspace(-0.1, 9.1, 300)
    wanted = CubicHermiteSpline(knots, values, slopes)
    value, slope = polynomial.hermite(knots, values, slopes, at)
    assert value == pytest.approx(wanted(at), rel=1e-6, abs=1e-6)
    assert slope == pytest.approx(wanted(at, 1), rel=1e-6, abs=1e-6)


HEAVY = "scipy pandas xarray numba matplotlib arviz emcee h5py"
DRAWN = "pandas xarray matplotlib arviz"  # a page is drawn, and a fit is stored, without them
CASES = {
    "check": ("shj_bayes.recording.runs", HEAVY),
    "finished": ("shj_bayes.app.resume", HEAVY),
    "compare": ("shj_bayes.app.design", "scipy.stats scipy.signal matplotlib arviz emcee"),
    "unchanged campaign": (
        "shj_bayes.app.campaign",
        "scipy.stats scipy.signal pandas xarray matplotlib arviz emcee",
    ),
    "fit": ("shj_bayes.app.device, shj_bayes.report.figures.device", f"{DRAWN} scipy.stats scipy.signal"),
    "diagnose": ("shj_bayes.mismatch.diagnosis, shj_bayes.report.diagnosis_page", f"{DRAWN} scipy.stats"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_command_starts_without_what_it_does_not_need(case):
    """A second of imports is a second that every user waits for at every command."""
    module, heavy = CASES[case]
    code = f"import sys, {module}; print(*(name for name in '{heavy}'.split() if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
