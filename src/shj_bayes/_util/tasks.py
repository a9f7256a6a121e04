"""Many tasks, on the processors of this machine or on a dask cluster that is there already: results as they come.

A task whose process died is tried once more here; a cluster's scheduler hands it to another worker. Whoever can reach a
dask scheduler can run code on its workers: the address is trusted as the command line is. dask is the optional extra
``dask``.
"""

import asyncio
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import shj_bayes
from shj_bayes._util.files import read_json
from shj_bayes._util.processes import Workers
from shj_bayes.errors import CampaignError, plain_text, shown

SCHEMES = ("tcp", "tls", "ws", "wss")
PATIENCE_S = 10  # for the scheduler to answer
IN_FLIGHT = 10_000  # tasks that the scheduler holds at a time: more than any cluster has processors
_ONE = threading.Lock()  # a worker may have many threads; fits and pictures are made one at a time in a process

Item = TypeVar("Item")
Result = TypeVar("Result")


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
