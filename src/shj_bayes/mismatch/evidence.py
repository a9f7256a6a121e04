"""The recordings as the mismatch engine uses them: thinned evenly, cut into cycle blocks that stand for evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shj_bayes.errors import InferenceError
from shj_bayes.inference.run import Run, histories_of
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion

MAX_SAMPLES = 8000  # of all runs together; correlated noise makes denser samples worth little
FEW_CYCLES = 12  # with fewer cycles than this, half-cycles are the blocks


@dataclass(frozen=True, eq=False)
class Evidence:
    """Runs of one device, thinned, and the blocks that count as independent pieces of evidence.

    Parameters
    ----------
    histories : tuple of History
        One per run.
    force_kN : array, shape (n,)
        Measured force, runs one after the other.
    weight : array, shape (n,)
        1 for evidence, 0 for samples that were repaired or lie too near a reversal.
    block : array of int, shape (n,)
        Cycle (or half-cycle, when there are few) each sample belongs to, counted through all runs.
    start_force_kN : tuple of float
        Force with which the law starts in each run.
    stride : int
        Every how many samples one was kept.
    """

    histories: tuple[History, ...]
    force_kN: FloatArray
    weight: FloatArray
    block: NDArray[np.int64]
    start_force_kN: tuple[float, ...]
    stride: int

    @property
    def n_blocks(self) -> int:
        """Number of blocks."""
        return int(self.block[-1]) + 1

    @property
    def block_edges(self) -> list[int]:
        """First sample of each block, and the number of samples behind them."""
        return [*np.flatnonzero(np.diff(self.block, prepend=-1)).tolist(), self.block.size]

    @property
    def run(self) -> NDArray[np.int64]:
        """Number of the run of each sample."""
        return np.concatenate([np.full(h.time_s.size, h.run) for h in self.histories])

    def stack(self, name: str) -> FloatArray:
        """One array of the histories, runs one after the other."""
        return np.concatenate([getattr(h, name) for h in self.histories])

    def half_cycle_sums(self, values: FloatArray) -> FloatArray:
        """Sum over each half-cycle of each run."""
        starts, before = [], 0
        for history in self.histories:
            starts.append(history.motion.start[:-1] + before)
            before += history.time_s.size
        return np.asarray(np.add.reduceat(values, np.concatenate(starts)))

    def block_sums(self, values: FloatArray) -> FloatArray:
        """Sum over each block, along the first axis."""
        return np.asarray(np.add.reduceat(values, self.block_edges[:-1], axis=0))


def evidence_of(runs: Sequence[Run], max_samples: int = MAX_SAMPLES) -> Evidence:
    """Thin the runs of one device and cut them into blocks.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs.
    max_samples : int
        About how many samples to keep in all.

    Returns
    -------
    Evidence
    """
    total = sum(run.recording.n_samples for run in runs)
    stride = max(1, int(np.ceil(total / max_samples)))
    # Accelerations, rests and travel are those of the whole recording: they cannot be had from every tenth sample.
    whole = histories_of(runs)
    thinned = [_thin(run, stride) for run in runs]
    motions = [motion for _, motion in thinned]
    n_half = sum(motion.n_half for motion in motions)
    width = 2 if n_half // 2 >= FEW_CYCLES else 1
    blocks, count = [], 0
    for motion in motions:
        # The first half-cycle is a quarter of a cycle: it joins the cycle after it.
        own = np.maximum(motion.half_cycle - 1, 0) // width
        blocks.append(count + own)
        count += int(own[-1]) + 1
    if count < 4:
        raise InferenceError(f"{n_half} half-cycles are too few to tell misfit from noise; at least 5 are needed")
    weight = [run.used[keep].astype(np.float64) for run, (keep, _) in zip(runs, thinned, strict=True)]
    return Evidence(
        histories=tuple(h.thinned(keep, motion) for h, (keep, motion) in zip(whole, thinned, strict=True)),
        force_kN=np.concatenate([run.recording.force_kN[keep] for run, (keep, _) in zip(runs, thinned, strict=True)]),
        weight=np.concatenate(weight),
        block=np.concatenate(blocks).astype(np.int64),
        start_force_kN=tuple(run.start_force_kN for run in runs),
        stride=stride,
    )


def _thin(run: Run, stride: int) -> tuple[NDArray[np.int64], Motion]:
    """Every `stride`-th sample and the first of every half-cycle, with the motion of what is kept."""
    motion = run.motion
    keep = np.union1d(np.arange(0, motion.displacement_mm.size, stride), motion.start[:-1])
    assert motion.unsure is not None
    return keep, Motion(
        displacement_mm=motion.displacement_mm[keep],
        speed_mm_s=motion.speed_mm_s[keep],
        start=np.append(np.searchsorted(keep, motion.start[:-1]), keep.size),
        turning_mm=motion.turning_mm,
        direction=motion.direction,
        unsure=motion.unsure[keep],
        method=motion.method,
        noise_mm=motion.noise_mm,
    )
