"""A small simulated device that fits in well under a second, for every test that needs data."""

import signal
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from shj_bayes.app import campaign
from shj_bayes.inference.binning import Run
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.margins import files
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.noise import DEFAULT, noise_model
from shj_bayes.model.parameters import base_and_run
from shj_bayes.model.priors import Priors, read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.results.tables import Cells, write_workbook

ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
RATE_HZ = 6.0
TRUTH = Truth(
    K=18.0, Fy=80.0, beta=10.0, gamma=0.01, ratio=0.8, sigma=0.8, phi=0.0, sigma_slow=0.6, tau_slow=1.0,
    displacement_noise_mm=0.0,
)  # fmt: skip


# Of long: they go first, or a worker would be left alone with one of them at the end. The second reads only: on a
# fresh checkout the first one compiles meanwhile what both workers need, which else both would do at the same time.
LONG = (
    "test_snippets", "test_shared_recordings", "test_bench_browser", "test_diagnosis", "test_work", "test_simulators",
    "test_browser", "test_margins_commands", "test_effects_in_fits", "test_campaign", "test_proof_short",
    "test_run_and_check", "test_resume", "test_measured_channels", "test_fuzz_corpus", "test_command_line",
    "test_kill_command",
)  # fmt: skip


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the long files first; all others stay in their order."""
    items.sort(key=lambda item: LONG.index(item.path.stem) if item.path.stem in LONG else len(LONG))


@pytest.fixture(scope="session", autouse=True)
def _one_blas_thread() -> Iterator[None]:
    """Keep BLAS to one thread, also in processes that tests start: tests run two at a time on two processors."""
    with pytest.MonkeyPatch.context() as patch, threadpool_limits(limits=1, user_api="blas"):
        for name in ONE_THREAD:
            patch.setenv(name, "1")
        yield


@pytest.fixture(scope="session", autouse=True)
def _interrupts_are_heard() -> None:
    """Take Ctrl-C where it is ignored, as in what a shell starts in the background: processes of tests inherit that."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def small_posterior(
    truth: Truth = TRUTH,
    *,
    seed: int = 1,
    n_runs: int = 2,
    noise: str = DEFAULT,
    effects: tuple[str, ...] = (),
    free: tuple[str, ...] = (),
    variant: str = "published",
    priors: Priors | None = None,
    blocks: tuple[Block, ...] = BLOCKS,
    rate_Hz: float = RATE_HZ,
) -> Likelihood:
    """Two short blocks, simulated and bound to the exact motion."""
    recordings = simulate_device(truth, seed=seed, rate_Hz=rate_Hz, n_runs=n_runs, blocks=blocks, variant=variant)
    # The exact motion keeps the reader's smoothing out of tests of the law, the noise and the sampler.
    _, motion = exact_motion(blocks, rate_Hz)
    runs = [Run(recording, motion) for recording in recordings]
    own = {"effects": effects_named(effects), "noise": noise_model(noise), "free": free, "variant": variant}
    return make_likelihood(runs, DeviceModel(n_runs, priors or read_priors("afc"), **own))


def vector_of(posterior: Likelihood, truth: Truth = TRUTH) -> np.ndarray:
    """Truth as one parameter set in natural units, shape (1, d); what it does not hold is as its prior expects."""
    # Where there is no slow part its size is a small one: a scale of 0 has no logarithm.
    noise = {"sigma_white": truth.sigma, "sigma_slow": max(truth.sigma_slow, 1e-3), "tau_slow": truth.tau_slow}
    values = []
    for name, prior in zip(posterior.model.names, posterior.model.laws, strict=True):
        base, run = (name, 1) if "." in name else base_and_run(name)
        value = noise.get(base, getattr(truth, base, None))
        if base == "ratio":
            value = truth.ratio ** (run - 1)
        values.append(float(prior.from_free(np.zeros(()))) if value is None else value)
    return np.array([values])


@pytest.fixture(scope="session")
def make_small() -> Callable[..., Likelihood]:
    """Factory of posteriors of about 270 samples a run; keyword arguments as in `small_posterior`."""
    return small_posterior


@pytest.fixture(scope="session")
def small_device() -> Likelihood:
    """Two runs of one device, white and slow noise."""
    return small_posterior()


@pytest.fixture(scope="session")
def truth() -> Truth:
    """Parameters from which the small device is simulated."""
    return TRUTH


@pytest.fixture(scope="session")
def as_vector() -> Callable[..., np.ndarray]:
    """Truth as a parameter set of a posterior, shape (1, d)."""
    return vector_of


@pytest.fixture(scope="module")
def no_workers() -> Iterator[None]:
    """Fit the devices of campaigns in this process, where pictures can be left empty."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(campaign, "results", lambda _, do, devices, **_how: ((d, do(d), "") for d in devices))
        yield


@pytest.fixture(scope="module")
def brief_workbooks() -> Iterator[None]:
    """Give a sheet of margins a workbook of its first rows: thousands of them are half of what a command takes."""

    def brief(pages: Mapping[str, Cells], path: Path) -> None:
        write_workbook({name: Cells(page.heads, page.rows[:9]) for name, page in pages.items()}, path)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(files, "write_workbook", brief)
        yield
