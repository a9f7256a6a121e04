"""Processes that do the work: one that answers at once, and as many as there are processors for what takes long.

They are warm: what the first answer needs is loaded and compiled when the bench opens. A job that is ended leaves whole
files and checkpoints behind, so that the same job again goes on from there.
"""

import asyncio
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from shj_bayes._util.processes import CallFailedError, Companion

PATIENCE_S = 300.0  # for an answer at once; the slowest file within the bounds takes about a minute
REST_S, LONG_REST_S = 60.0, 600.0  # idle, after which processes for long jobs, and the one that answers, are ended
WAITING, RUNNING, DONE, FAILED, ENDED = "waiting", "running", "done", "failed", "ended"


def _prepare() -> None:
    """Load in the process what the work needs; here nothing of it is loaded."""
    from shj_bayes.bench import work  # noqa: PLC0415

    work.prepare()


def _call(name: str, *args: Any) -> Any:
    """Call a function of `shj_bayes.bench.work` by its name."""
    from shj_bayes.bench import work  # noqa: PLC0415

    return getattr(work, name)(*args)


@dataclass(eq=False)
class Job:
    """Something that takes long, and how far it is."""

    id: str
    kind: str  # function of `shj_bayes.bench.work`
    target: str  # what it is about; a second job of a kind for the same target is not begun
    args: tuple[Any, ...]
    state: str = WAITING
    share: float | None = None  # done, where that is known
    words: str = "waiting for a processor"
    slot: "Companion | None" = field(default=None, repr=False)

    @property
    def under_way(self) -> bool:
        """Whether it is still to end."""
        return self.state in (WAITING, RUNNING)

    def told(self) -> dict[str, Any]:
        """Give its state for a page."""
        return {name: getattr(self, name) for name in ("id", "kind", "target", "state", "share", "words")}


class Jobs:
    """All work of a bench."""

    def __init__(self, notify: Callable[[Job], None]) -> None:
        self.notify = notify
        self.jobs: dict[str, Job] = {}
        self._numbers = count(1)
        n_long = os.cpu_count() or 1
        self._threads = ThreadPoolExecutor(n_long + 2)
        self._room = asyncio.Semaphore(n_long)  # for jobs, in the order in which they were begun
        self._one_at_a_time = asyncio.Lock()
        self._quick: Companion | None = None
        self._free: list[Companion] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._busy_until = time.monotonic()

    @property
    def under_way(self) -> list[Job]:
        """Jobs that are still to end."""
        return [job for job in self.jobs.values() if job.under_way]

    def _aside(self, function: Callable[..., Any], *args: Any) -> asyncio.Future[Any]:
        """Run what waits for a process in a thread."""
        return asyncio.get_running_loop().run_in_executor(self._threads, function, *args)

    async def ask(self, name: str, *args: Any) -> Any:
        """Call a function at once and give its result; `CallFailedError` with the reason in words.

        One call after the other: a process that does not answer is replaced.
        """
        async with self._one_at_a_time:
            self._busy_until = time.monotonic()
            if self._quick is None:
                self._quick = await self._aside(Companion, _prepare)
            asked = self._quick
            call = self._aside(lambda: asked.call(_call, name, *args, told=lambda _share, _words: None))
            try:
                return await asyncio.wait_for(asyncio.shield(call), PATIENCE_S)
            except (asyncio.CancelledError, EOFError, TimeoutError) as error:
                self._quick = None  # its answer must not be that to the next question
                asked.stop()
                if isinstance(error, asyncio.CancelledError):  # nobody waits any more
                    raise
                why = "took too long" if isinstance(error, TimeoutError) else "ended its process (memory, or killed)"
                raise CallFailedError(f"{name.replace('_', ' ')} {why}; try it again") from error

    def warm(self) -> None:
        """Begin the process that answers at once."""

        async def begun() -> None:
            with suppress(CallFailedError):  # told to whoever asks it something
                await self.ask("ready")

        self._start(begun())

    def begin(self, kind: str, target: str, *args: Any) -> Job:
        """Begin something that takes long, as soon as a processor is free; one that is under way already is given."""
        again = next((job for job in self.under_way if (job.kind, job.target) == (kind, target)), None)
        if again is not None:
            return again
        job = Job(f"j{next(self._numbers)}", kind, target, args)
        self.jobs[job.id] = job
        self._start(self._run(job))
        self.notify(job)
        return job

    def end(self, job: Job) -> None:
        """End a job; what it wrote stays."""
        if job.under_way:
            job.state, job.words = ENDED, "ended; again, it goes on from the last checkpoint"
            if job.slot is not None:
                self._aside(job.slot.stop)
            self.notify(job)

    def stop(self) -> None:
        """End everything."""
        for job in self.under_way:
            job.state = ENDED
            if job.slot is not None:
                job.slot.stop()
        for companion in (*self._free, *([self._quick] if self._quick else [])):
            companion.stop()
        self._free, self._quick = [], None
        self._threads.shutdown(wait=False, cancel_futures=True)

    def rest(self) -> None:
        """End processes that have had nothing to do for a while: idle, a bench takes little memory."""
        idle_s = 0.0 if self.under_way else time.monotonic() - self._busy_until
        if idle_s > REST_S:
            for companion in self._free:
                companion.stop()
            self._free = []
        if idle_s > LONG_REST_S and self._quick is not None and not self._one_at_a_time.locked():
            self._quick.stop()
            self._quick = None

    def _start(self, what: Any) -> None:
        task = asyncio.get_running_loop().create_task(what)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _run(self, job: Job) -> None:
        async with self._room:
            if job.state != WAITING:
                return
            job.state, job.words = RUNNING, "beginning"
            self.notify(job)
            loop = asyncio.get_running_loop()
            slot = self._free.pop() if self._free else await self._aside(Companion, _prepare)

            def told(share: float | None, words: str) -> None:
                loop.call_soon_threadsafe(self._told, job, share, words)

            try:
                if job.state == RUNNING:
                    job.slot = slot
                    await self._aside(lambda: slot.call(_call, job.kind, *job.args, told=told))
                state, words = DONE, "done"
            except CallFailedError as error:
                state, words = FAILED, str(error)
            except EOFError:
                state, words = FAILED, "its process ended (memory, or killed); try it again"
                await self._aside(slot.stop)
                slot = None
            if job.state == RUNNING:
                job.state, job.words, job.share = state, words, 1.0 if state == DONE else job.share
            elif job.slot is not None:  # ended meanwhile, and its process with it
                slot = None
            job.slot = None
            self._free += [slot] if slot else []
            self._busy_until = time.monotonic()
            self.notify(job)

    def _told(self, job: Job, share: float | None, words: str) -> None:
        if job.state == RUNNING:
            job.share, job.words = share, words
            self.notify(job)
