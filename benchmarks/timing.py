"""How the benchmarks measure: processor time of this thread, so that other work on the machine is not counted."""

from __future__ import annotations

import time
from collections.abc import Callable


def best(work: Callable[[], object], repeats: int) -> float:
    """Shortest of several repeats after one that is not counted, s; other work only ever makes a repeat slower."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.thread_time()
        work()
        times.append(time.thread_time() - begin)
    return min(times)
