"""How the benchmarks measure: processor time of this thread, so that other work on the machine is not counted."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.likelihood import Density


class Counted:
    """A density that counts its evaluations."""

    def __init__(self, density: Density) -> None:
        """Begin at zero."""
        self.density, self.n = density, 0

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Count, and evaluate."""
        self.n += z.shape[0]
        return self.density.log_posterior_free(z)


def best(work: Callable[[], object], repeats: int) -> float:
    """Shortest of several repeats after one that is not counted, s; other work only ever makes a repeat slower."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return min(times)


def of_children() -> float:
    """Processor time of all child processes that have ended so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
