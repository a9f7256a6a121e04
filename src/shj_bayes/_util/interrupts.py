"""Ctrl-C that arrives where Python drops exceptions."""

import _thread
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

AGAIN_S = 0.02  # time for the place that drops exceptions to be left


@contextmanager
def no_interrupt_lost() -> Iterator[None]:
    """Raise a `KeyboardInterrupt` again where Python printed it and went on.

    In finalizers and callbacks of weak references, of which imports and drawing make thousands, Python prints an
    exception as ignored: the command would go on to its end, with a traceback.
    """
    before = sys.unraisablehook

    def hook(dropped: "sys.UnraisableHookArgs") -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            threading.Timer(AGAIN_S, _thread.interrupt_main).start()
        else:
            before(dropped)

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = before
