"""Points of one call shared out among threads, for the searches that come before the ensembles run side by side."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from shj_bayes.model.parameters import FloatArray


class Density(Protocol):
    """What a search or a sampler needs: a log density of many points at once."""

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log density of points of shape (m, d), shape (m,)."""
        ...


@dataclass(frozen=True, eq=False)
class SharedDensity:
    """A density whose points are evaluated by several threads; each point's value is the same to the bit."""

    density: Density  # log density in the unbounded space; it must let go of the interpreter lock to be any faster here
    pool: ThreadPoolExecutor  # the threads
    n: int  # into how many parts a call is divided

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log density of points of shape (m, d), shape (m,)."""
        if self.n < 2 or z.shape[0] < 2:
            return self.density.log_posterior_free(z)
        return np.concatenate(list(self.pool.map(self.density.log_posterior_free, np.array_split(z, self.n))))


def n_threads(asked: int) -> int:
    """Threads that are asked for, 0 for one per processor."""
    return asked or os.cpu_count() or 1
