"""Stopped and resumed, serial or parallel: the same bits. A stranger's or a damaged checkpoint: refused."""

import dataclasses
import hashlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np
import pytest

from shj_bayes.errors import CheckpointError, InferenceError
from shj_bayes.inference import sampler as checkpoint
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.sampler import EnsembleState, SamplingPlan, run_ensembles
from shj_bayes.inference.start import Start, find_start
from shj_bayes.model.priors import read_priors

Make = Callable[..., Likelihood]
Whole = Callable[[int], list[EnsembleState]]
WORKER = Path(__file__).with_name("worker.py")
ROUND, STEPS = 12, 60  # five rounds: too few to converge, so that every run makes all of them; as in worker.py


@pytest.fixture(scope="module")
def found(make_small: Make) -> tuple[Likelihood, Start]:
    """Posterior of the small device and its MAP, as a fit finds them."""
    return find_start(make_small())


@pytest.fixture(scope="module")
def small(found: tuple[Likelihood, Start]) -> Likelihood:
    """Posterior of the small device."""
    return found[0]


@pytest.fixture(scope="module")
def start(found: tuple[Likelihood, Start]) -> Start:
    """MAP of the small device."""
    return found[1]


def sample(
    posterior: Likelihood, start: Start, *, seed: int = 1, threads: int = 0, density: object = None, **more: object
) -> list[EnsembleState]:
    """Five rounds."""
    plan = SamplingPlan(seed=seed, round_steps=ROUND, max_steps=STEPS, threads=threads)
    density = posterior if density is None else density
    states, _ = run_ensembles(density, posterior.model.names, start, plan, fingerprint=posterior.fingerprint, **more)  # type: ignore[arg-type]
    return states


@pytest.fixture(scope="module")
def whole(small: Likelihood, start: Start) -> Whole:
    """Five rounds of a seed in one thread that nothing stopped, made when they are first asked for."""
    return lru_cache(lambda seed: sample(small, start, seed=seed, threads=1))


def assert_same_bits(a: list[EnsembleState], b: list[EnsembleState]) -> None:
    """Everything that is stored and everything that the rest of the chain depends on."""
    assert len(a) == len(b)
    for one, two in zip(a, b, strict=True):
        for name in ("chain", "log_posterior", "accepted"):
            assert getattr(one, name).tobytes() == getattr(two, name).tobytes(), name
        assert one.n_failed == two.n_failed
        assert one.random_state[0] == two.random_state[0]
        assert np.array_equal(one.random_state[1], two.random_state[1])
        assert one.random_state[2:] == two.random_state[2:]


class Interrupting:
    """A density, until call number `at`: then as if Ctrl-C were pressed there."""

    def __init__(self, posterior: Likelihood, at: int) -> None:
        self.posterior, self.at, self.calls, self.lock = posterior, at, 0, threading.Lock()

    def log_posterior_free(self, z: np.ndarray) -> np.ndarray:
        """Count, evaluate or interrupt."""
        with self.lock:
            self.calls += 1
            if self.calls >= self.at:
                raise KeyboardInterrupt
        return self.posterior.log_posterior_free(z)


@pytest.mark.parametrize("seed", [1, 7])
def test_runs_are_repeatable_and_seeds_differ(small: Likelihood, start: Start, whole: Whole, seed: int) -> None:
    states = whole(seed)
    np.random.seed(12345)  # noqa: NPY002 - a run must not depend on the global stream
    assert_same_bits(states, sample(small, start, seed=seed))
    assert not np.array_equal(states[0].chain, sample(small, start, seed=seed + 100)[0].chain)
    for other in states[1:]:
        assert not np.array_equal(states[0].chain[0], other.chain[0])


def test_threads_do_not_change_the_numbers(small: Likelihood, start: Start, whole: Whole) -> None:
    for threads in (2, 4):
        assert_same_bits(whole(1), sample(small, start, threads=threads))


# 192 calls fit the proposal and start the ensembles; each round is about 4 x 12 x 1.1 calls: the start, the first, a
# middle, the last round
@pytest.mark.parametrize("at", [2, 225, 335, 435])
@pytest.mark.parametrize("seed", [1, 7])
def test_interrupted_and_resumed(
    small: Likelihood, start: Start, whole: Whole, tmp_path: Path, seed: int, at: int
) -> None:
    path = tmp_path / "checkpoint.h5"
    with pytest.raises(KeyboardInterrupt):
        sample(small, start, seed=seed, density=Interrupting(small, at), path=path, threads=2)
    assert path.exists() == (at > 265)
    resumed = sample(small, start, seed=seed, path=path, threads=2)
    assert_same_bits(resumed, whole(seed))


def test_interrupted_again_and_again(small: Likelihood, start: Start, whole: Whole, tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.h5"
    for _ in range(4):
        with pytest.raises(KeyboardInterrupt):
            sample(small, start, density=Interrupting(small, 260), path=path)
    assert_same_bits(sample(small, start, path=path), whole(1))


def kill_and_compare(posterior: Likelihood, start: Start, folder: Path, seed: int, wait_s: float) -> None:
    """SIGKILL a fit in another process `wait_s` after its first checkpoint, resume here, compare."""
    path = folder / "checkpoint.h5"
    process = subprocess.Popen([sys.executable, str(WORKER), str(path), str(seed), "0.003"])
    try:
        until = time.monotonic() + 120
        while not path.exists() and process.poll() is None and time.monotonic() < until:
            time.sleep(0.01)
        assert path.exists(), "the worker wrote no checkpoint"
        time.sleep(wait_s)
        assert process.poll() is None, "the worker finished before it could be killed"
        os.kill(process.pid, signal.SIGKILL)
    finally:
        process.kill()
        process.wait()
    assert_same_bits(sample(posterior, start, seed=seed, path=path), sample(posterior, start, seed=seed))


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
def test_killed_and_resumed(small: Likelihood, start: Start, tmp_path: Path) -> None:
    wait_s = float(np.random.default_rng().uniform(0.0, 0.15))  # a new moment each time; the bits must not depend on it
    kill_and_compare(small, start, tmp_path, seed=5, wait_s=wait_s)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="this system has no SIGKILL")
@pytest.mark.parametrize("number", range(8))
def test_killed_at_many_moments(small: Likelihood, start: Start, tmp_path: Path, number: int) -> None:
    kill_and_compare(small, start, tmp_path, seed=number, wait_s=0.02 * number)


# ---- strangers and damage ----


@pytest.fixture(scope="module")
def saved(
    small: Likelihood, start: Start, tmp_path_factory: pytest.TempPathFactory
) -> tuple[bytes, list[EnsembleState]]:
    """A checkpoint as bytes, and what it holds."""
    path = tmp_path_factory.mktemp("saved") / "checkpoint.h5"
    states = sample(small, start, path=path)
    return path.read_bytes(), states


def test_checkpoint_holds_what_was_run(
    small: Likelihood, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    identity = small.fingerprint
    assert_same_bits(checkpoint.load(path, identity), saved[1])
    checkpoint.save(path, identity, saved[1][:2])
    assert_same_bits(checkpoint.load(path, identity), saved[1][:2])
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint.h5"]


STRANGERS: dict[str, Callable[[Make], Likelihood]] = {
    "recordings": lambda make: make(seed=2),
    "parameters": lambda make: make(free=("gamma",)),
    "noise": lambda make: make(noise="student"),
    "model": lambda make: make(variant="continuous"),
    "priors": lambda make: make(priors=read_priors("general")),
}


@pytest.mark.parametrize("field", STRANGERS)
def test_checkpoint_of_another_posterior_is_refused(
    make_small: Make, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path, field: str
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    stranger = STRANGERS[field](make_small)
    if field == "model":  # the same recordings under the other law, not those simulated with it
        stranger = make_small()
        stranger = make_likelihood(stranger.runs, dataclasses.replace(stranger.model, variant="continuous"))
    origin = Start(np.zeros(len(stranger.model.names)), np.eye(len(stranger.model.names)), 0.0)
    with pytest.raises(CheckpointError, match=r"checkpoint\.h5 belongs to another problem: its .* differ") as caught:
        sample(stranger, origin, path=path)
    named = re.search(r"its (.*) differ", str(caught.value))
    assert named is not None
    assert field in named[1]
    assert "delete the checkpoint to start anew" in str(caught.value)
    assert path.read_bytes() == saved[0]  # refused, not overwritten


@pytest.mark.parametrize("change", [{"seed": 2}, {"n_ensembles": 5}, {"n_walkers": 30}])
def test_checkpoint_of_another_plan_is_refused(
    small: Likelihood,
    start: Start,
    saved: tuple[bytes, list[EnsembleState]],
    tmp_path: Path,
    change: dict[str, int],
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    plan = SamplingPlan(**({"seed": 1, "round_steps": ROUND, "max_steps": STEPS} | change))
    with pytest.raises(CheckpointError, match="its plan"):
        run_ensembles(small, small.model.names, start, plan, fingerprint=small.fingerprint, path=path)


def test_a_longer_plan_goes_on_from_the_checkpoint(
    small: Likelihood, start: Start, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    plan = SamplingPlan(seed=1, round_steps=7, max_steps=74)  # other rounds, same bits
    states, _ = run_ensembles(small, small.model.names, start, plan, fingerprint=small.fingerprint, path=path)
    assert states[0].chain.shape[0] == 74
    for old, new in zip(saved[1], states, strict=True):
        assert np.array_equal(old.chain, new.chain[:STEPS])


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "text": lambda _: b"hello " * 100,
    "half": lambda b: b[: len(b) // 2],
    "end missing": lambda b: b[:-3000],
    "zeros in the middle": lambda b: b[: len(b) // 2] + bytes(4096) + b[len(b) // 2 + 4096 :],
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damaged_checkpoint_is_refused(
    small: Likelihood, start: Start, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(DAMAGE[kind](saved[0]))
    with pytest.raises(CheckpointError, match=r"checkpoint\.h5 cannot be read.*digest does not fit"):
        sample(small, start, path=path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in the file system")
def test_a_pipe_in_the_place_of_a_checkpoint_is_refused_at_once(
    small: Likelihood, start: Start, tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "checkpoint.h5")
    with pytest.raises(CheckpointError, match="not an ordinary file"):
        sample(small, start, path=tmp_path / "checkpoint.h5")


def test_no_flipped_bit_goes_unnoticed(
    small: Likelihood, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path
) -> None:
    """One bit changed anywhere is refused."""
    path = tmp_path / "checkpoint.h5"
    rng = np.random.default_rng(3)
    for place in rng.integers(0, len(saved[0]), 150):
        content = bytearray(saved[0])
        content[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match="its digest does not fit"):
            checkpoint.load(path, small.fingerprint)


@contextmanager
def changed(path: Path) -> Iterator[h5py.File]:
    """A checkpoint opened for changes, and sealed again, as by somebody who knows how."""
    with h5py.File(path, "a") as file:
        yield file
    content = path.read_bytes()
    path.write_bytes(content + b"SHA-256:" + hashlib.sha256(content).digest())


@pytest.mark.parametrize("missing", ["ensemble_2", "ensemble_1/chain", "ensemble_0/random_keys"])
def test_incomplete_checkpoint_is_refused(
    small: Likelihood, start: Start, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path, missing: str
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    with changed(path) as file:
        del file[missing]
    with pytest.raises(CheckpointError, match="cannot be read"):
        sample(small, start, path=path)


STRANGE: dict[str, Callable[[h5py.File], object]] = {
    "nan": lambda f: f["ensemble_0/chain"].write_direct(np.full(f["ensemble_0/chain"].shape, np.nan)),
    "shorter": lambda f: put(f, "ensemble_1/chain", f["ensemble_0/chain"][:5]),
    "flat": lambda f: put(f, "ensemble_0/chain", np.zeros(5)),
    "other walkers": lambda f: put(f, "ensemble_0/accepted", np.zeros(3)),
    "whole numbers": lambda f: put(f, "ensemble_0/accepted", np.zeros(f["ensemble_0/accepted"].shape, dtype=int)),
    "fewer ensembles": lambda f: f.attrs.__setitem__("n_ensembles", 3),
    "keys": lambda f: put(f, "ensemble_0/random_keys", np.arange(3, dtype=np.uint32)),
    "position": lambda f: f["ensemble_0"].attrs.__setitem__("random_position", 10**9),  # numpy crashed on it
    "generator": lambda f: f["ensemble_0"].attrs.__setitem__("random_name", "PCG64"),
}


def put(file: h5py.File, name: str, values: np.ndarray) -> None:
    """Put other values into a file."""
    del file[name]
    file[name] = values


@pytest.mark.parametrize("kind", STRANGE)
def test_checkpoint_that_no_fit_leaves_is_refused(
    small: Likelihood, start: Start, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    with changed(path) as file:
        STRANGE[kind](file)
    with pytest.raises(CheckpointError, match=r"that a fit leaves|those of this fit"):
        sample(small, start, path=path)


def test_checkpoint_of_another_version_is_refused(
    small: Likelihood, start: Start, saved: tuple[bytes, list[EnsembleState]], tmp_path: Path
) -> None:
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(saved[0])
    with changed(path) as file:
        file.attrs["schema"] = "shj-bayes/checkpoint/0"
    with pytest.raises(CheckpointError, match="schema 'shj-bayes/checkpoint/0'; this version reads"):
        sample(small, start, path=path)


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ({"seed": -1}, "seed = -1: allowed are whole numbers from 0 to 4294967295"),
        ({"n_ensembles": 3}, "3 ensembles: at least 4"),
        ({"round_steps": 0}, "at least one round of 0 steps"),
        ({"max_steps": 55}, "max_steps = 55: at least one round of 60 steps is needed"),
        ({"round_steps": 20, "max_steps": 40}, "max_steps = 40: at least 50 are needed for a verdict"),
        ({"n_walkers": 9}, "9 walkers: at least 16 are needed for 8 parameters"),
    ],
)
def test_plans_without_a_verdict(small: Likelihood, start: Start, plan: dict[str, int], message: str) -> None:
    with pytest.raises(InferenceError, match=re.escape(message)):
        run_ensembles(small, small.model.names, start, SamplingPlan(**plan))


def test_no_finite_start(small: Likelihood, start: Start) -> None:
    class Nowhere:
        def log_posterior_free(self, z: np.ndarray) -> np.ndarray:
            return np.full(z.shape[0], -np.inf)

    with pytest.raises(InferenceError, match="no finite starting points"):
        sample(small, start, density=Nowhere())
