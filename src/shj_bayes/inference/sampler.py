"""Independent ensembles of emcee: checkpoints, and resumption to the same numbers."""

import hashlib
import io
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import h5py
import numpy as np
from tqdm import tqdm

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import open_ordinary, replacing
from shj_bayes._util.imports import without
from shj_bayes.errors import CheckpointError, InferenceError, StrangeCheckpointError
from shj_bayes.inference.convergence import TAU_LIMIT, Diagnostics, diagnose_chains, judge
from shj_bayes.inference.likelihood import Density, SharedDensity, n_threads
from shj_bayes.inference.proposal import Proposal, fit_proposal
from shj_bayes.inference.start import Start, root_of
from shj_bayes.results.fit import Trust

SCHEMA = "shj-bayes/checkpoint/1"
ARRAYS = ("chain", "log_posterior", "accepted")
_KEYS = 624  # whole numbers of a Mersenne twister
_SEAL = b"SHA-256:"  # behind the HDF5 content, before the 32 bytes of its digest


@dataclass(frozen=True, eq=False)
class EnsembleState:
    """One ensemble as far as it has run; `ValueError` where its parts do not belong together."""

    chain: FloatArray  # shape (n_steps, n_walkers, d): positions in the unbounded space
    log_posterior: FloatArray  # shape (n_steps, n_walkers): log posterior density of each
    accepted: FloatArray  # shape (n_walkers,): accepted moves of each walker
    # state of the legacy Mersenne twister that emcee draws from (numpy's ``RandomState.get_state()``)
    random_state: tuple[Any, ...]
    n_failed: int  # evaluations with zero or overflowing density

    def __post_init__(self) -> None:
        """Refuse what no sampler leaves: numpy crashes on a wrong random state, and emcee passes over it in silence."""
        name, keys, position, has_gauss, _ = self.random_state
        parts = (self.chain, self.log_posterior, self.accepted)
        if not (
            self.chain.ndim == 3
            and self.chain.shape[:2] == self.log_posterior.shape
            and self.accepted.shape == self.chain.shape[1:2]
            and all(part.size and part.dtype.kind == "f" and np.isfinite(part).all() for part in parts)
            and name == "MT19937"
            and np.asarray(keys).dtype == np.uint32
            and np.shape(keys) == (_KEYS,)
            and 0 <= position <= _KEYS
            and has_gauss in (0, 1)
        ):
            raise ValueError("its chain or its random state is none that a fit leaves")


def save(path: Path, fingerprint: dict[str, str], ensembles: list[EnsembleState]) -> None:
    """Write a checkpoint beside the old one, then put it in its place."""
    # The latest format and Fletcher's sum protect headers and numbers: an altered byte is an error, not another chain.
    # Made in memory, then written as bytes: HDF5 itself makes a mess of a full disk.
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver="latest") as file:
        file.attrs["schema"], file.attrs["n_ensembles"] = SCHEMA, len(ensembles)
        for key, value in fingerprint.items():
            file.attrs[f"fingerprint.{key}"] = value
        for number, ensemble in enumerate(ensembles):
            group = file.create_group(f"ensemble_{number}")
            name, keys, position, has_gauss, cached = ensemble.random_state
            arrays = {key: getattr(ensemble, key) for key in ARRAYS} | {"random_keys": np.asarray(keys)}
            for key, values in arrays.items():
                group.create_dataset(key, data=values, fletcher32=True)
            group.attrs.update(random_name=name, random_position=position, random_has_gauss=has_gauss)
            group.attrs.update(random_cached=cached, n_failed=ensemble.n_failed)
    with replacing(path) as part:
        content = memory.getvalue()
        part.write_bytes(content + _SEAL + hashlib.sha256(content).digest())


def load(path: Path, fingerprint: dict[str, str], shape: tuple[int, ...] | None = None) -> list[EnsembleState]:
    """Read a checkpoint of this very problem; `CheckpointError` where it is damaged, or says which fields differ.

    `shape` is (n_ensembles, n_walkers, d), where that is known.
    """
    try:
        # The digest comes first: a damaged file can make the HDF5 library end the process. HDF5 itself allows for bytes
        # behind its end, so other tools can open a checkpoint as it is.
        with open_ordinary(path) as stream:
            raw = stream.read()
        content, seal = raw[: -len(_SEAL) - 32], raw[-len(_SEAL) - 32 :]
        if seal != _SEAL + hashlib.sha256(content).digest():
            raise ValueError("it was cut short or altered: its digest does not fit")
        with h5py.File(io.BytesIO(content), "r") as file:
            if file.attrs.get("schema") != SCHEMA:
                raise CheckpointError(
                    f"{path.name}: schema {file.attrs.get('schema')!r}; this version reads {SCHEMA!r}"
                )
            strange = [key for key, value in fingerprint.items() if file.attrs.get(f"fingerprint.{key}") != value]
            if strange:
                raise StrangeCheckpointError(
                    f"{path.name} belongs to another problem: its {' and '.join(strange)} differ(s) from what is asked "
                    "now; choose another output folder, or delete the checkpoint to start anew"
                )
            states = [_read(file[f"ensemble_{number}"]) for number in range(int(file.attrs["n_ensembles"]))]
            kinds = {state.chain.shape for state in states}
            if len(kinds) != 1 or shape not in (None, (len(states), *kinds.pop()[1:])):
                raise ValueError("its ensembles are not those of this fit")
            return states
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CheckpointError(f"{path.name} cannot be read ({reason}); delete it to start anew") from error


def _read(group: h5py.Group) -> EnsembleState:
    a = group.attrs
    state = (str(a["random_name"]), np.asarray(group["random_keys"]), int(a["random_position"]))
    gauss = (int(a["random_has_gauss"]), float(a["random_cached"]))
    chain, log_posterior, accepted = (np.asarray(group[key]) for key in ARRAYS)
    return EnsembleState(chain, log_posterior, accepted, (*state, *gauss), int(a["n_failed"]))


with without("scipy.stats"):
    import emcee

LIBRARY = "emcee"  # whose sampler moves the walkers; the files of a fit name it
MIN_STEPS = 50  # fewer say nothing about convergence
LEAST_ROUND, SURE = 10, 1.04  # steps; by how much the steps are taken longer than a first estimate of tau asks


@dataclass(frozen=True)
class SamplingPlan:
    """How to sample."""

    seed: int = 1  # same seed and inputs, same numbers
    n_ensembles: int = 4  # independent ensembles, at least 4
    n_walkers: int = 0  # walkers of each; 0 for three per parameter (at least 20)
    # steps between two looks at convergence (and two checkpoints); a fifth of the steps so far where that is more,
    # fewer where the chain is seen to be long enough before
    round_steps: int = 60
    max_steps: int = 10_000  # steps after which to stop even if not converged
    # points to climb from besides those that the search finds, in the unbounded space, each of shape (n_law,)
    tops: tuple[FloatArray, ...] = field(default=(), compare=False)
    threads: int = 0  # ensembles that run at the same time, 0 for one per processor; the numbers do not depend on it
    progress: bool = False  # show a progress bar on standard error, where that is a terminal
    # gets, after each round, the share of the steps that are likely to be needed that is done, and convergence in words
    watch: Callable[[float, str], None] = field(default=lambda _share, _words: None, compare=False)

    def __post_init__(self) -> None:
        """Refuse plans from which no verdict can come."""
        if not 0 <= self.seed < 2**32:
            raise InferenceError(f"seed = {self.seed}: allowed are whole numbers from 0 to {2**32 - 1}")
        if self.n_ensembles < 4:
            raise InferenceError(f"{self.n_ensembles} ensembles: at least 4 independent ones are needed for a verdict")
        if not 1 <= self.round_steps <= self.max_steps:
            raise InferenceError(
                f"max_steps = {self.max_steps}: at least one round of {self.round_steps} steps is needed"
            )
        if self.max_steps < MIN_STEPS:
            raise InferenceError(f"max_steps = {self.max_steps}: at least {MIN_STEPS} are needed for a verdict")

    def walkers(self, d: int) -> int:
        """Walkers of each ensemble for d parameters."""
        n = self.n_walkers or max(20, 3 * d + d % 2)
        if n < 2 * d:
            raise InferenceError(f"{n} walkers: at least {2 * d} are needed for {d} parameters; 0 chooses by itself")
        return n


def moves(proposal: Proposal) -> list[tuple[emcee.moves.Move, float]]:
    """Proposals and their shares.

    Draws from a mixture that resembles the posterior have a tenth of the autocorrelation time of differential evolution
    (``benchmarks/moves.py``). Where it resembles it little, differential evolution takes over; a quarter of its moves
    jump the whole difference, which lets walkers change between peaks.
    emcee 3.1.6's ``DESnookerMove`` is not used: it gives posteriors that are too narrow (``tests/statistical``).
    """
    share = float(np.clip(1.2 * proposal.efficiency, 0.1, 0.9))
    rest = 1.0 - share
    return [
        (emcee.moves.MHMove(proposal.move), share),
        (emcee.moves.DEMove(), 0.75 * rest),
        (emcee.moves.DEMove(gamma0=1.0), 0.25 * rest),
    ]


def run_ensembles(
    density: Density,
    names: tuple[str, ...],
    start: Start,
    plan: SamplingPlan,
    *,
    fingerprint: dict[str, str] | None = None,
    path: Path | None = None,
) -> tuple[list[EnsembleState], Diagnostics]:
    """Sample until converged or out of steps, with a checkpoint after each round.

    Parameters
    ----------
    density : Density
        Log density in the unbounded space.
    names : tuple of str
        Parameters, in the order of the vectors.
    start : Start
        MAP and covariance around which the walkers start, 1.5 times as wide.
    plan : Plan
        How to sample.
    fingerprint : dict of str to str, optional
        Identity of the problem; a checkpoint of another one is refused.
    path : Path, optional
        Checkpoint file; sampling goes on from it if it exists.
    """
    d, n = len(names), n_threads(plan.threads)
    stream = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(98,)))
    with ThreadPoolExecutor(n) as pool:
        proposal = fit_proposal(SharedDensity(density, pool, n), start, stream)
    identity = dict(fingerprint or {}) | {"plan": f"seed {plan.seed}, {plan.n_ensembles} x {plan.walkers(d)} walkers"}
    if path is not None and path.exists():
        states = load(path, identity, (plan.n_ensembles, plan.walkers(d), d))
    else:
        streams = np.random.SeedSequence(plan.seed).spawn(plan.n_ensembles)
        states = [_begin(density, start, plan.walkers(d), stream) for stream in streams]
    bar = tqdm(total=plan.max_steps, unit="step", desc="sampling", disable=None if plan.progress else True, leave=False)
    with bar, ThreadPoolExecutor(min(plan.n_ensembles, n)) as pool:
        bar.update(states[0].chain.shape[0])
        while True:
            figures = _figures(names, states)
            if figures is not None:
                words = f"R-hat {figures.rhat.max():.3f}, ESS {figures.ess_bulk.min():.0f}"
                bar.set_postfix_str(words)
                plan.watch(min(1.0, states[0].chain.shape[0] / (_enough(figures) or plan.max_steps)), words)
                if judge(figures).word == Trust.RELIABLE or states[0].chain.shape[0] >= plan.max_steps:
                    return states, figures
            steps = _next_round(plan, states[0].chain.shape[0], figures)
            states = _advance_all(pool, density, proposal, states, steps)
            if path is not None:
                save(path, identity, states)
            bar.update(steps)


def _advance_all(
    pool: ThreadPoolExecutor, density: Density, proposal: Proposal, states: list[EnsembleState], n_steps: int
) -> list[EnsembleState]:
    """Run all ensembles for some steps; where that is broken off, none goes on to the end of the round."""
    stop = Event()
    try:
        return list(pool.map(partial(_advance, density, proposal, stop, n_steps=n_steps), states))
    except BaseException:  # Ctrl-C: the pool would wait
        stop.set()
        raise


def _next_round(plan: SamplingPlan, done: int, figures: Diagnostics | None) -> int:
    """Choose the steps to the next look: a round, or fewer where the chain will be long enough before its end."""
    steps = max(plan.round_steps, done // 5)  # a look costs in proportion to the chain: the longer, the fewer looks
    missing = (_enough(figures) or 0) - done
    steps = min(steps, missing) if missing > 0 else steps
    return min(max(steps, min(LEAST_ROUND, plan.round_steps)), plan.max_steps - done)


def _enough(figures: Diagnostics | None) -> int | None:
    """Estimate the steps after which the chain is long enough; None while there is nothing to tell it by."""
    if figures is None or not np.isfinite(figures.tau).all():
        return None
    return int(np.ceil(SURE * (figures.n_burn + TAU_LIMIT * figures.tau.max())))


def _figures(names: tuple[str, ...], states: list[EnsembleState]) -> Diagnostics | None:
    """Convergence so far; None while there is too little to judge."""
    n = states[0].chain.shape[0]
    if n < MIN_STEPS:
        return None
    acceptance = np.stack([state.accepted / (n - 1) for state in states])
    return diagnose_chains(names, [state.chain for state in states], acceptance, sum(s.n_failed for s in states))


def _begin(density: Density, start: Start, n_walkers: int, stream: np.random.SeedSequence) -> EnsembleState:
    """Scatter the walkers of one ensemble; points without density are drawn again, nearer to the MAP."""
    rng = np.random.default_rng(stream)
    root = root_of(start.covariance)
    points = np.empty((n_walkers, start.free.size))
    density_at = np.full(n_walkers, -np.inf)
    width = 1.5
    for _ in range(20):
        bad = ~np.isfinite(density_at)
        points[bad] = start.free + width * rng.standard_normal((int(bad.sum()), start.free.size)) @ root.T
        density_at[bad] = density.log_posterior_free(points[bad])
        if np.isfinite(density_at).all():
            break
        width *= 0.7
    else:
        raise InferenceError("no finite starting points around the most probable parameters; look at `shj-bayes check`")
    legacy = np.random.RandomState(np.random.MT19937(stream.spawn(1)[0])).get_state()
    return EnsembleState(points[None], density_at[None], np.zeros(n_walkers), tuple(legacy), 0)


def _advance(density: Density, proposal: Proposal, stop: Event, state: EnsembleState, n_steps: int) -> EnsembleState:
    """Run one ensemble for some steps."""
    failed = 0

    def evaluate(z: FloatArray) -> FloatArray:
        nonlocal failed
        if stop.is_set():  # nothing is accepted any more; emcee would print what is raised here
            return np.full(len(z), -np.inf)
        value = density.log_posterior_free(z)
        failed += int(np.count_nonzero(~np.isfinite(value)))
        return value

    _, n_walkers, d = state.chain.shape
    sampler = emcee.EnsembleSampler(n_walkers, d, evaluate, moves=moves(proposal), vectorize=True)
    begin = emcee.State(state.chain[-1], log_prob=state.log_posterior[-1], random_state=state.random_state)
    end = sampler.run_mcmc(begin, n_steps, skip_initial_state_check=True)
    if stop.is_set():
        raise InferenceError("sampling was stopped")
    return EnsembleState(
        np.concatenate([state.chain, sampler.get_chain()]),
        np.concatenate([state.log_posterior, sampler.get_log_prob()]),
        state.accepted + sampler.backend.accepted,
        tuple(end.random_state),
        state.n_failed + failed,
    )
