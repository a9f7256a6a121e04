"""Other processes: they run nothing from the current folder, and they end with the process that started them.

Python puts the current folder first on the path of a process started with ``-c`` or by spawn. A file named ``h5py.py``
beside the recordings would then be run. ``-P`` (in the environment: PYTHONSAFEPATH) leaves that folder out.
"""

import logging
import os
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

PYTHON = (sys.executable, "-P")  # the beginning of a command that starts this Python again
_SAFE, _WARNINGS = "PYTHONSAFEPATH", "PYTHONWARNINGS"
_NO_LEAKS = "ignore::UserWarning:multiprocessing.resource_tracker"
_KILLED = 1  # exit status of a process whose parent is gone; nobody reads it

P = ParamSpec("P")
T = TypeVar("T")


class Workers(ProcessPoolExecutor):
    """Pool of so many spawned processes."""

    def __init__(self, n: int) -> None:
        with _safe_path(), _deaf():  # the process that tracks semaphores starts here
            super().__init__(n, mp_context=get_context("spawn"), initializer=_begin)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Hand over a call; processes start here, when there is something for them to do."""
        with _safe_path(), _deaf():
            return super().submit(fn, *args, **kwargs)

    def stop(self) -> None:
        """End the processes, whatever they are doing: what they write is whole or not there at all."""
        for process in list((self._processes or {}).values()):
            process.terminate()
        self.shutdown(wait=True, cancel_futures=True)


def _begin() -> None:
    """Begin a worker: it ends with its parent, and warnings of libraries stay off the terminal as in the command."""
    end_with_parent()
    quiet_libraries()


def quiet_libraries() -> None:
    """Keep what libraries say off the terminal: it names lines of their source, or folders of theirs."""
    logging.captureWarnings(True)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


def end_with_parent() -> None:
    """End this process as soon as the one that started it by `multiprocessing` is gone, whatever it is doing."""
    parent: Any = parent_process()
    if parent is not None:
        _when(parent.join)


@contextmanager
def tether() -> Iterator[int]:
    """Give a child a standard input (``stdin=`` of `subprocess`) that ends when this process does.

    The child calls `end_with_input`.
    """
    reading, writing = os.pipe()
    try:
        yield reading
    finally:
        os.close(reading)
        os.close(writing)


def end_with_input() -> None:
    """End this process as soon as its standard input ends."""
    _when(lambda: os.read(0, 1))  # not sys.stdin: its lock, held by a waiting thread, aborts an orderly exit


def bound_memory(more: int) -> None:
    """Let this process take so many bytes more than it has, where the system can hold it to that."""
    try:
        import resource  # noqa: PLC0415  not on Windows

        taken = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
        limit = taken + more
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))
    except (ImportError, OSError, ValueError):
        return


def program(name: str) -> str | None:
    """Path of an installed program, without ending; never one in the current folder, where Windows looks first."""
    folders = os.pathsep.join(folder for folder in os.get_exec_path() if os.path.isabs(folder))
    found = shutil.which(name, path=folders)
    return found if found and os.path.isabs(found) else None


def _when(gone: Callable[[], object]) -> None:
    """End this process when a call that waits comes back."""

    def watch() -> None:
        gone()
        os._exit(_KILLED)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _deaf() -> Iterator[None]:
    """Start processes that do not hear Ctrl-C: the terminal sends it to all of them, and the parent ends them."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let processes that are started meanwhile leave the current folder out of their path.

    The one that tracks semaphores keeps to itself that it takes away those of a process that was stopped. Only
    meanwhile: what a user's script starts by itself may need the folder.
    """
    before = {name: os.environ.get(name) for name in (_SAFE, _WARNINGS)}
    os.environ[_SAFE] = "1"
    os.environ[_WARNINGS] = ",".join(filter(None, (before[_WARNINGS], _NO_LEAKS)))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
