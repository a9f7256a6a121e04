"""Other processes, and many tasks on them or on a dask cluster that is there already.

They run nothing from the current folder, and they end with the process that started them.
Python puts the current folder first on the path of a process started with ``-c`` or by spawn. A file named ``h5py.py``
beside the recordings would then be run. ``-P`` (in the environment: PYTHONSAFEPATH) leaves that folder out.

HDF5 files of results may come from elsewhere: they are read in a process of their own before they are read here. A
damaged one can end the process that opens it, take all memory or never come back. One process goes through all files
that this one asks for.

A task whose process died is tried once more here; a cluster's scheduler hands it to another worker. Whoever can reach a
dask scheduler can run code on its workers: the address is trusted as the command line is. dask is the optional extra
``dask``.
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
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from itertools import islice
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any, ParamSpec, TypeVar
from uuid import uuid4

import shj_bayes
from shj_bayes._util.files import read_json
from shj_bayes.errors import CampaignError, plain_text, shown, words_of

PYTHON = (sys.executable, "-P")  # the beginning of a command that starts this Python again
_SAFE, _WARNINGS = "PYTHONSAFEPATH", "PYTHONWARNINGS"
_NO_LEAKS = "ignore::UserWarning:multiprocessing.resource_tracker"
_KILLED = 1  # exit status of a process whose parent is gone; nobody reads it
P = ParamSpec("P")
T = TypeVar("T")
SCHEMES = ("tcp", "tls", "ws", "wss")
PATIENCE_S = 10  # for the scheduler to answer
IN_FLIGHT = 10_000  # tasks that the scheduler holds at a time: more than any cluster has processors
_ONE = threading.Lock()  # a worker may have many threads; fits and pictures are made one at a time in a process
Item = TypeVar("Item")
Result = TypeVar("Result")


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


class Companion:
    """A spawned process that answers one call after the other and says meanwhile how far it is."""

    def __init__(self, prepare: Callable[[], object]) -> None:
        spawn = get_context("spawn")
        self._here, there = spawn.Pipe()
        with _safe_path(), _deaf():
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

    def tell(share: float | None, words: str) -> None:
        there.send(("told", (share, words)))

    while True:
        try:
            function, args = there.recv()
        except EOFError:
            return
        try:
            answer = "done", function(*args, tell)
        except Exception as error:  # whatever it is, who asked is told
            answer = "failed", words_of(error)
        there.send(answer)


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


def results_here(
    n_workers: int, function: Callable[[Item], Result], items: Iterable[Item]
) -> Iterator[tuple[Item, Result | None, str]]:
    """Items, each with its result or None and why there is none, as processes of this machine finish them.

    What was under way when a process died is tried once more, one at a time, so that none is blamed for another.
    """
    waiting = deque(enumerate(items))
    suspects: set[int] = set()
    while waiting:
        pool = Workers(min(n_workers, len(waiting)))
        running: dict[Future[Result], tuple[int, Item]] = {}
        broken = False  # a process died, and with it the pool
        try:
            while running or (waiting and not broken):
                while waiting and not broken and len(running) < (1 if suspects else 2 * n_workers):
                    try:
                        running[pool.submit(function, waiting[0][1])] = waiting[0]
                        waiting.popleft()
                    except BrokenProcessPool:
                        broken = True
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    number, item = running.pop(future)
                    died = isinstance(future.exception(), BrokenProcessPool)
                    broken |= died
                    if died and number not in suspects:
                        suspects.add(number)
                        waiting.appendleft((number, item))
                        continue
                    suspects.discard(number)
                    reason = "the process that fitted it died twice (memory, or killed)" if died else ""
                    yield item, None if died else future.result(), reason
        except BaseException:
            pool.stop()
            raise
        pool.shutdown(wait=True, cancel_futures=True)


def results_on(
    address: str,
    folder: Path,
    function: Callable[[Item], Result],
    items: Iterable[Item],
    *,
    tell: Callable[[str], None] = lambda _: None,
) -> Iterator[tuple[Item, Result | None, str]]:
    """Items, each with its result or None and why there is none, as a cluster finishes them.

    `address` is that of the scheduler (``tcp://10.0.0.5:8786``), or the file that it wrote with ``--scheduler-file``
    (``x.json``); all workers must see `folder`; function and items travel to them; `tell` gets a few words on the
    cluster with each result. `CampaignError` if dask is not installed, the cluster does not answer, or its workers
    cannot do this work.
    """
    library = _library()
    with _connect(library, address) as client:
        _check_workers(client, address, folder)
        run, waiting = uuid4().hex[:8], enumerate(items)
        running: dict[Any, Item] = {}  # futures; the cluster drops them when this process ends or is stopped
        done = library.as_completed(loop=client.loop)
        while True:
            for number, item in islice(waiting, IN_FLIGHT - len(running)):
                future = client.submit(_alone, function, item, key=f"shj-bayes-{run}-{number}", pure=False)
                running[future] = item
                done.add(future)
            if not running:
                return
            try:
                n_workers = len(client.nthreads())
                tell(f"{n_workers} workers" if n_workers else "no worker has joined yet")
                future = next(done)
                result, reason = _result_of(library, future)
            except (CancelledError, OSError) as error:
                raise CampaignError(
                    f"--dask {address}: the scheduler stopped answering ({type(error).__name__}); the same command "
                    "again keeps what is finished, and goes on"
                ) from error
            yield running.pop(future), result, reason


def _library() -> Any:
    """Import dask's distributed, which is optional and slow to import; `CampaignError` where it is not installed."""
    try:
        import distributed  # noqa: PLC0415
    except ImportError as error:
        raise CampaignError(
            "--dask needs the package distributed, which is not installed; install it here and on the workers with "
            "pip install 'shj-bayes[dask]'"
        ) from error
    return distributed


def _connect(library: Any, address: str) -> Any:
    """Connect to the scheduler; `CampaignError` where that fails, before there is a client that must be ended."""
    advice = (
        "it needs the address that `dask scheduler` prints, such as tcp://10.0.0.5:8786, or its --scheduler-file; "
        "tls:// needs the certificates in dask's own settings"
    )
    where = _address_in(Path(address), advice) if address.endswith(".json") else address
    scheme = where.partition("://")[0] if "://" in where else SCHEMES[0]
    if scheme not in SCHEMES:
        raise CampaignError(f"--dask {address}: {shown(scheme)} is none of {', '.join(SCHEMES)}; {advice}")
    said: list[BaseException] = []  # what goes wrong; empty where the scheduler answered
    asking = threading.Thread(target=_ask, args=(library, where, said), daemon=True)
    asking.start()
    asking.join(PATIENCE_S + 1)
    if asking.is_alive() or said:
        why = f"{type(said[0]).__name__}: {str(said[0])[:200]}" if said and str(said[0]) else "it is silent"
        raise CampaignError(
            f"--dask {address}: no dask scheduler answers there within {PATIENCE_S} s ({why}); {advice}"
        )
    return library.Client(where, timeout=PATIENCE_S, set_as_default=False, name="shj-bayes")


def _address_in(path: Path, advice: str) -> str:
    """Address of the scheduler that wrote a file."""
    try:
        content = read_json(path, CampaignError)
    except CampaignError as error:
        raise CampaignError(f"--dask {path.name}: no dask scheduler is told by it ({error}); {advice}") from error
    found = content.get("address") if isinstance(content, dict) else None
    if not isinstance(found, str):
        raise CampaignError(f"--dask {path.name}: it names no address of a scheduler; {advice}")
    return found


def _ask(library: Any, address: str, said: list[BaseException]) -> None:
    """Shake hands with a scheduler and hang up. The deadline is ours: the library reads the answer without one."""
    import asyncio  # noqa: PLC0415

    async def handshake() -> None:
        how = library.Security().get_connection_args("client")
        (await asyncio.wait_for(library.comm.connect(address, timeout=PATIENCE_S, **how), PATIENCE_S)).abort()

    try:
        asyncio.run(handshake())
    except Exception as error:  # the library, its transports and ssl raise dozens of kinds
        said.append(error)


def _check_workers(client: Any, address: str, folder: Path) -> None:
    """Ask the workers that are there whether they can do the work; those that join later tell it device by device."""
    for worker, answer in client.run(_probe, str(folder), on_error="return").items():
        if isinstance(answer, ImportError):
            wrong = f"cannot import shj_bayes ({answer}); install shj-bayes {shj_bayes.__version__} on the workers"
        elif isinstance(answer, BaseException):
            wrong = f"fails ({type(answer).__name__}: {answer})"
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


def _alone(function: Callable[[Item], Result], item: Item) -> Result:
    """Call a function, one call at a time in this process."""
    with _ONE:
        return function(item)


def _result_of(library: Any, future: Any) -> tuple[Any, str]:
    """Take the result of a finished task, or say why it has none."""
    error = future.exception() if future.status == "error" else None
    if isinstance(error, library.KilledWorker):
        return None, f"{error.allowed_failures + 1} workers died while they fitted it (memory, or killed)"
    if error is not None:
        return None, plain_text(f"the cluster could not run it: {type(error).__name__}: {error}")
    return future.result(), ""
