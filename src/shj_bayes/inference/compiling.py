"""Say so when the first evaluation waits for the compiler; afterwards the machine code is read from numba's cache."""

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

WAIT_S = 2.0  # reading the cache takes a tenth of it
TEXT = "compiling the law for this machine: once after installation, up to a minute\n"


@contextmanager
def told_when_slow(tell: bool, wait_s: float = WAIT_S) -> Iterator[None]:
    """Print one line to a terminal if what is inside takes `wait_s` seconds, longer than the cache would."""
    if not (tell and sys.stderr.isatty()):
        yield
        return
    timer = threading.Timer(wait_s, lambda: (sys.stderr.write(TEXT), sys.stderr.flush()))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
