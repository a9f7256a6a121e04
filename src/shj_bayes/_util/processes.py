"""Other processes, and many tasks on them or on a dask cluster that is there already.

They run nothing from the current folder, and they end with the process that started them.
Python puts the current folder first on the path of a process started with ``-c`` or by spawn. A file named ``h5py.py``
beside the recordings would then be run. ``-P`` (in the environment: PYTHONSAFEPATH) leaves that folder out.

HDF5 files of results may come from elsewhere: they are read in a process of their own before they are read here. A
damaged one can end the process that opens it, take all memory or never come back. One process goes through all files
that this one asks for.

Whoever can reach a dask scheduler can run code on its workers: the address is trusted as the command line is. dask is
the optional extra ``dask``.
"""

import _thread
import atexit
import faulthandler
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import shj_bayes
from shj_bayes._util.files import read_json
from shj_bayes.errors import CampaignError, plain_text, shown, words_of

PYTHON = (sys.executable, "-P")  # the beginning of a command that starts this Python again
_SAFE, _WARNINGS = "PYTHONSAFEPATH", "PYTHONWARNINGS"
_NO_LEAKS = "ignore::UserWarning:multiprocessing.resource_tracker"
P = ParamSpec("P")
T = TypeVar("T")
PATIENCE_S = 10  # for the scheduler to answer
IN_FLIGHT = 2_000  # tasks that the scheduler holds at a time
_ONE = threading.Lock()  # a worker may have many threads; fits and pictures are made one at a time in a process
Item = TypeVar("Item")
Result = TypeVar("Result")


class Workers(ProcessPoolExecutor):
    """Pool of so many spawned processes; an error within its ``with`` ends them."""

    def __init__(self, n: int) -> None:
        with _starting():  # the process that tracks semaphores starts here
            super().__init__(n, mp_context=get_context("spawn"), initializer=_begin)

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Hand over a call; processes start here, when there is something for them to do."""
        with _starting():
            return super().submit(fn, *args, **kwargs)

    def __exit__(self, kind: object, *_: object) -> None:
        """End the processes, at once where there was an error: what they write is whole or not there at all."""
        for process in list((self._processes or {}).values()) if kind else ():
            process.terminate()
        self.shutdown(wait=True, cancel_futures=True)


class Companion:
    """A spawned process that answers one call after the other and says meanwhile how far it is."""

    def __init__(self, prepare: Callable[[], object]) -> None:
        spawn = get_context("spawn")
        self._here, there = spawn.Pipe()
        with _starting():
            self._process = spawn.Process(target=_answer, args=(there, prepare))
            self._process.start()
        there.close()

    def call(self, function: Callable[..., Any], *args: Any, told: Callable[[float | None, str], None]) -> Any:
        """Call a function there with a further argument ``tell``, whose calls come to `told`; wait for its result.

        `CallFailedError` with the reason in words where it raised; `EOFError` where the process ended.
        """
        try:
            self._here.send((function, args))
            while True:
                kind, value = self._here.recv()
                if kind == "told":
                    told(*value)
                elif kind == "failed":
                    raise CallFailedError(value)
                else:
                    return value
        except OSError as error:
            raise EOFError from error

    def stop(self) -> None:
        """End the process, whatever it is doing: what it writes is whole or not there at all."""
        self._process.terminate()
        self._process.join()
        self._here.close()


class CallFailedError(Exception):
    """A call in another process that raised; the text says why, in words."""


def _answer(there: Any, prepare: Callable[[], object]) -> None:
    """Answer the calls of a `Companion`."""
    _begin()
    prepare()

    while True:
        try:
            function, args = there.recv()
        except EOFError:
            return
        try:
            answer = "done", function(*args, lambda share, words: there.send(("told", (share, words))))
        except Exception as error:  # whatever it is, who asked is told
            answer = "failed", words_of(error)
        there.send(answer)


def _begin() -> None:
    """Begin a worker: it ends with its parent, and warnings of libraries stay off the terminal as in the command."""
    parent: Any = parent_process()
    if parent is not None:
        _when(parent.join)
    quiet_libraries()


def quiet_libraries() -> None:
    """Keep what libraries say off the terminal: it names lines of their source, or folders of theirs."""
    logging.captureWarnings(True)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)


@contextmanager
def tether() -> Iterator[int]:
    """Give a child a standard input (``stdin=`` of `subprocess`) that ends when this process does."""
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
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _starting() -> Iterator[None]:
    """Have processes that are started meanwhile leave the current folder out of their path and not hear Ctrl-C.

    The terminal sends that to all of them, and the parent ends them. The one that tracks semaphores keeps to itself
    that it takes away those of a process that was stopped. Only meanwhile: what a user's script starts by itself may
    need the folder.
    """
    in_main = threading.current_thread() is threading.main_thread()
    before = {name: os.environ.get(name) for name in (_SAFE, _WARNINGS)}
    heard = signal.signal(signal.SIGINT, signal.SIG_IGN) if in_main else None
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
        if in_main:
            signal.signal(signal.SIGINT, heard)


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


_CHILD = "from shj_bayes._util.processes import child; child()"
_SECONDS = 20  # for a small file on a busy machine, and more by its size
_BYTES_S = 4 * 1024**2  # read in a second by the slowest disk
_NUMBERS = 512 * 1024**2  # in a file; ours hold some megabytes
_BYTES = 768 * 1024**2  # of memory for one variable, its chunks and the library
_PARTS = 2000  # groups and variables in a file; ours hold about a hundred
_ELSEWHERE = "is a link to somewhere else, or lies there"
_MORE = "lies deeper, or behind more parts, than in a file of ours"
_ONE_AT_A_TIME = threading.Lock()


def vet(path: Path, group: str = "") -> None:
    """Refuse (`ValueError`) an HDF5 file that is no result of ours, or cannot be read within bounds.

    Read is one `group` at the top of it, or all that it holds.
    """
    with _ONE_AT_A_TIME:
        child, answer = _child(), b""
        try:
            child.stdin.write(json.dumps([os.path.abspath(path), group]).encode() + b"\n")
            child.stdin.flush()
            answer = child.stdout.readline()
        except BrokenPipeError:
            pass
        finally:
            if not answer.endswith(b"\n"):  # it died, or Ctrl-C came and the answer would be that to the next question
                child.kill()
                _end()
    if not answer.endswith(b"\n"):
        raise ValueError("the library of its format cannot read it and gave up")
    if reason := json.loads(answer):
        raise ValueError(reason)


@cache
def _child() -> Any:
    """Start the process; it ends when its input does."""
    pipe = subprocess.PIPE
    return subprocess.Popen([*PYTHON, "-c", _CHILD], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)


@atexit.register
def _end() -> None:
    if _child.cache_info().currsize:
        with _child():  # closes its input, and waits
            pass
        _child.cache_clear()


def child() -> None:
    """Answer each line of standard input, a path and a group, with a line: null, or why the file is refused."""
    import h5py  # noqa: F401, PLC0415  what is loaded does not count against the bound

    bound_memory(_BYTES)
    for line in sys.stdin.buffer:
        path, group = json.loads(line)
        try:
            seconds = _SECONDS + os.path.getsize(path) // _BYTES_S
            faulthandler.dump_traceback_later(seconds, exit=True)  # also where the library holds every thread up
            _read(path, group)
            reason = None
        except Exception as error:  # the library raises dozens of kinds for damaged files; all mean the same
            reason = str(error) or type(error).__name__
        faulthandler.cancel_dump_traceback_later()
        sys.stdout.write(json.dumps(reason) + "\n")
        sys.stdout.flush()


def _read(path: str, group: str) -> None:
    """Read what `group` of a file holds; `ValueError` where the file has parts that ours have not.

    Ours have hard links alone, and groups that hold variables: a file with other links, or external or virtual
    variables, is a window into others.
    """
    import h5py  # noqa: PLC0415

    names: list[str] = []

    # What a callback raises is lost in the library; what it returns ends the walk.
    def look(name: bytes, link: Any) -> str | None:
        names.append(name.decode("utf-8", "replace"))
        if link.type != h5py.h5l.TYPE_HARD:
            return _ELSEWHERE
        return _MORE if name.count(b"/") > 1 or len(names) > _PARTS else None

    with h5py.File(path, "r") as file:
        if wrong := file.id.links.visit(look, info=True):
            raise ValueError(f"{shown(names[-1])} {wrong}")
        parts = {name: file[name] for name in names if group in ("", name.split("/")[0])}
        variables = {name: part for name, part in parts.items() if isinstance(part, h5py.Dataset)}
        if (size := sum(one.size * one.dtype.itemsize for one in variables.values())) > _NUMBERS:
            raise ValueError(f"it claims {size // 2**20} MiB of numbers; allowed are {_NUMBERS // 2**20}")
        for name, one in variables.items():
            if one.external or one.is_virtual:
                raise ValueError(f"{shown(name)} {_ELSEWHERE}")
            one[()]
        for part in parts.values():
            dict(part.attrs)


def results(
    n_workers: int,
    function: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    cluster: str = "",
    folder: Path = Path(),
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[tuple[Item, Result | None, str]]:
    """Items, each with its result or None and why there is none, as processes of this machine or a cluster finish them.

    What was under way when a process of this machine died is tried once more, one at a time, so that none is blamed for
    another; a cluster's scheduler hands it to another worker. `cluster` is the address of a scheduler
    (``tcp://10.0.0.5:8786``), or the file that it wrote with ``--scheduler-file`` (``x.json``); all its workers must
    see `folder`; function and items travel to them. `CampaignError` if dask is not installed, the cluster does not
    answer, or its workers cannot do this work.
    """
    waiting, suspects = deque(enumerate(items)), set[int]()
    at_once = IN_FLIGHT if cluster else 2 * n_workers
    while waiting:
        broken = False  # a process of this machine died, and with it the pool
        with _cluster(cluster, folder, tell) if cluster else Workers(min(n_workers, len(waiting))) as pool:
            running: dict[Future[Result], tuple[int, Item]] = {}
            while running or (waiting and not broken):
                while waiting and not broken and len(running) < (1 if suspects else at_once):
                    try:
                        running[pool.submit(_alone, function, waiting[0][1])] = waiting[0]
                        waiting.popleft()
                    except BrokenProcessPool:
                        broken = True
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    number, item = running.pop(future)
                    if future.cancelled():
                        raise CampaignError(
                            f"--dask {cluster}: the scheduler stopped answering; the same command again keeps what is "
                            "finished, and goes on"
                        )
                    error = future.exception()
                    died = isinstance(error, BrokenProcessPool)
                    broken |= died
                    if died and number not in suspects:
                        suspects.add(number)
                        waiting.appendleft((number, item))
                        continue
                    suspects.discard(number)
                    reason = f"it could not be run: {type(error).__name__}: {error}" if error else ""
                    reason = "the process that fitted it died twice (memory, or killed)" if died else reason
                    yield item, None if error else future.result(), plain_text(reason)


def _alone(function: Callable[[Item], Result], item: Item) -> Result:
    """Call a function, one call at a time in this process."""
    with _ONE:
        return function(item)


@contextmanager
def _cluster(address: str, folder: Path, tell: Callable[[str], None]) -> Iterator[Executor]:
    """Connect to a scheduler; tasks that are not done are dropped in the end."""
    import asyncio  # noqa: PLC0415

    try:
        import distributed  # noqa: PLC0415  (optional, and slow to import)
    except ImportError as error:
        raise CampaignError(
            "--dask needs the package distributed, which is not installed; install it here and on the workers with "
            "pip install 'shj-bayes[dask]'"
        ) from error
    library: Any = distributed
    try:
        where: Any = address
        if address.endswith(".json"):
            content = read_json(Path(address), CampaignError)
            where = content.get("address") if isinstance(content, dict) else None
        if not isinstance(where, str):
            raise CampaignError("it names no address")

        async def shake_hands() -> None:  # and hang up: the library reads the answer without a deadline
            how = library.Security().get_connection_args("client")
            (await asyncio.wait_for(library.comm.connect(where, timeout=PATIENCE_S, **how), PATIENCE_S)).abort()

        asyncio.run(shake_hands())
    except Exception as error:  # the library, its transports and ssl raise dozens of kinds
        raise CampaignError(
            f"--dask {address}: no dask scheduler answers there within {PATIENCE_S} s ({type(error).__name__}: "
            f"{str(error)[:200]}); it needs the address that `dask scheduler` prints, such as tcp://10.0.0.5:8786, or "
            "its --scheduler-file; tls:// needs the certificates in dask's own settings"
        ) from error
    with library.Client(where, timeout=PATIENCE_S, set_as_default=False, name="shj-bayes") as client:
        if not client.nthreads():
            tell("no worker has joined yet")
            client.wait_for_workers(1)
            tell("")
        _check_workers(client, address, folder)
        yield client.get_executor(pure=False)


def _check_workers(client: Any, address: str, folder: Path) -> None:
    """Ask the workers that are there whether they can do the work; those that join later tell it device by device."""
    for worker, answer in client.run(_probe, str(folder), on_error="return").items():
        if isinstance(answer, BaseException):
            wrong = f"fails ({type(answer).__name__}: {answer}); install shj-bayes {shj_bayes.__version__} on it"
        elif answer[0] != shj_bayes.__version__:
            wrong = f"has shj-bayes {answer[0]}, this is {shj_bayes.__version__}; install the same version on all"
        elif not answer[1]:
            wrong = f"does not see the folder {folder}; it must be on a file system that all workers share"
        else:
            continue
        raise CampaignError(f"--dask {address}: the worker {worker} {wrong}")


def _probe(folder: str) -> tuple[str, bool]:
    """Give the version of this package on the worker that runs this, and whether it sees a folder."""
    return shj_bayes.__version__, Path(folder).is_dir()
