"""A planned test run in full: a drawn device, the whole model, noise, the readers, and every rival fitted anew."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.special import logsumexp

from shj_bayes._util.arrays import one_blas_thread
from shj_bayes.inference.reduction import zero_noise_kN
from shj_bayes.inference.run import Run
from shj_bayes.inference.start import law_starts
from shj_bayes.mismatch.scene import Metric, Scene
from shj_bayes.mismatch.state import settle
from shj_bayes.model.history import histories
from shj_bayes.model.noise.filter import simulate
from shj_bayes.planning.foresight import ForeseenQuantity, entropy_of, spread_of
from shj_bayes.planning.known import PLANNED, Key, Known, RivalModel
from shj_bayes.planning.protocol import Protocol
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording


@dataclass(frozen=True)
class Rehearsal:
    """What simulated tests ended in."""

    n: int  # tests simulated
    of_truth: float  # mean probability of the true set after them
    right: int  # tests after which the true set was the most probable
    entropy: float  # mean entropy of the probabilities, nats
    sd: float | None  # of the quantity that was asked for (root of the mean variance)


def rehearse(
    known: Known, protocol: Protocol, rate_Hz: float, n: int, seed: int, quantity: ForeseenQuantity | None = None
) -> Rehearsal:
    """Simulate a planned test `n` times and weigh the rivals on it and the old tests together.

    The tests are spread evenly over the sets, within a set over the ways to write it in their shares.
    """
    shares, keys = known.shares, known.keys
    rows = []
    for k, stream in enumerate(np.random.SeedSequence(seed, spawn_key=(5,)).spawn(n)):
        key, turn, turns = keys[k % len(keys)], k // len(keys), -(-(n - k % len(keys)) // len(keys))
        within = np.cumsum(np.where([b.key == key for b in known.beliefs], shares, 0.0))
        i = int(np.searchsorted(within, (turn + 0.5) / turns * within[-1]))
        recording = recorded(known, known.beliefs[i], protocol, rate_Hz, np.random.default_rng(stream))
        after, variance = weighed(known, recording, quantity)
        right = max(after, key=lambda key: after[key]) == key
        rows.append((within[-1] / turns, after[key], right, entropy_of(np.array(list(after.values()))), variance))
    weight, of_truth, right_of, entropy, variances = np.array(rows, dtype=np.float64).T
    mean = partial(np.average, weights=weight)
    sd = None if quantity is None else float(np.sqrt(mean(variances)))
    return Rehearsal(n, float(mean(of_truth)), int(right_of.sum()), float(mean(entropy)), sd)


def recorded(known: Known, true: RivalModel, protocol: Protocol, rate_Hz: float, rng: np.random.Generator) -> Recording:
    """Simulate the recording of a planned test on a device drawn from a rival, with noise and an error of the zero."""
    root = np.linalg.cholesky(true.precision)
    z = (true.mean + np.linalg.solve(root.T, rng.standard_normal(true.mean.size)))[: true.z.size]
    time, motion = protocol.sampled(rate_Hz)
    theta = true.model.natural(np.append(z, known.setting.z)[None])
    force = true.model.force(theta, known.placed(histories([time], [motion])[0]), 0.0)[0]
    noise = {name: float(v[0]) for name, v in true.model.noise_values(theta).items()}
    force = force + simulate(true.model.noise, noise, time, np.arange(time.size) == 0, rng)
    force += min(zero_noise_kN(force), known.largest_zero_kN) * rng.standard_normal()
    return Recording(time, known.wobbling(motion.displacement_mm, rng), force, source=PLANNED)


@one_blas_thread
def weighed(
    known: Known, recording: Recording, quantity: ForeseenQuantity | None = None
) -> tuple[dict[Key, float], float]:
    """Weigh the rivals on one further recording, each fitted to old and new together under the noise of the old.

    Gives the probability of each set, and the variance of the quantity over all rivals, 0 where none is asked for.
    """
    motion = motion_of(recording)
    alone = known.scene(recording.time_s, motion, recording.force_kN, 1.0)
    if not known.runs:  # the first test of a device says where its law is
        z = law_starts(alone.posterior)[0]
        at = [replace(b, z=np.concatenate([z, b.z[z.size :]])) for b in known.beliefs]
        known = replace(known, z=z, beliefs=tuple(at))
        alone = known.scene(recording.time_s, motion, recording.force_kN, 1.0)
    parts = (*known.old, *alone.posterior.averages)
    runs = (*known.runs, Run(recording, motion))
    scene = Scene(replace(alone.posterior, runs=runs, averages=parts), known.z, known.peak_mm_s)
    first = known.beliefs[0]
    slope = scene.residual_and_slope(first.model, first.z[None])[1][0]
    metric = Metric(scene, known.setting, slope)
    logs, values, variances = [], [], []
    for i, b in enumerate(known.beliefs):
        state = settle(scene, metric, b.model, b.z)
        logs.append(state.evidence - b.evidence)
        if quantity is not None:
            g = quantity.slopes[i][: b.z.size]
            values.append(quantity.value(b.model, state.z))
            variances.append(float(g @ state.covariance @ g))
    weights = np.log(known.shares) + logs
    p = np.exp(weights - logsumexp(weights))
    return known.by_set(p), 0.0 if quantity is None else float(spread_of(p, np.array(values), np.array(variances)))
