"""Workers behind the fence, started once and given one trial after another."""

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import shj_bayes
from shj_bayes._util.files import write_text
from shj_bayes.errors import ProofError
from shj_validation.proof.fence import scratch

ENDED = "the process behind the fence has ended; what it printed stands above; run the same command again to go on"
INSTALLED = str(Path(shj_bayes.__file__).parent)
WORKER = "shj_validation.proof.worker"
KEPT = ("SYSTEMROOT", "TEMP", "TMP", "TMPDIR")  # all that a process needs of the environment, Windows included


class Blind:
    """One process behind the fence.

    Attributes
    ----------
    folder : Path
        Copies of the recordings; the process sees nothing else.
    """

    def __init__(self, module: str = WORKER) -> None:
        self.folder = Path(scratch())
        environment = {name: os.environ[name] for name in KEPT if name in os.environ}
        environment |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-m", module, str(self.folder)],
            cwd=self.folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            encoding="utf-8",
            start_new_session=True,  # Ctrl-C reaches this program first, which then ends its workers in order
        )

    def diagnose(self, recordings: Sequence[Path], **how: Any) -> dict[str, Any]:
        """Copy recordings behind the fence under plain names, and wait for the diagnosis.

        Parameters
        ----------
        recordings : sequence of Path
            Consecutive runs.
        **how
            As for `shj_validation.proof.blind.diagnose_blind`.

        Returns
        -------
        dict
            Content of ``diagnosis.json``, or ``{"error": words}``.
        """
        names = [f"run{run}{''.join(path.suffixes[-2:])}" for run, path in enumerate(recordings, start=1)]
        for path, name in zip(recordings, names, strict=True):
            shutil.copyfile(path, self.folder / name)
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"files": names, **how}) + "\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except (BrokenPipeError, OSError) as error:
            raise ProofError(ENDED) from error
        if not line:
            raise ProofError(ENDED)
        answer: dict[str, Any] = json.loads(line)
        installed = answer.pop("installed", INSTALLED)
        if installed != INSTALLED:  # it does not read PYTHONPATH
            raise ProofError(
                f"the process behind the fence runs the installation in {installed}, this one runs that in "
                f"{INSTALLED}; use the Python of an environment in which the latter is installed"
            )
        return dict(answer.get("record", answer))

    def close(self) -> None:
        """End the process and remove the copies."""
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        shutil.rmtree(self.folder, ignore_errors=True)


def unanswered(folder: Path, names: Iterable[str]) -> list[str]:
    """Names of which a folder holds no diagnosis yet."""
    return [name for name in names if not (folder / f"{name}.json").exists()]


def diagnose_rest(
    folder: Path,
    names: Iterable[str],
    task_of: Callable[[str], dict[str, Any]],
    workers: int,
    done: Callable[[str], object],
    module: str = WORKER,
) -> None:
    """Diagnose what has no diagnosis in a folder yet; each is written whole or not at all, so that a run can go on.

    Parameters
    ----------
    folder : Path
        Where the diagnoses go, one file for each name.
    names : iterable of str
        Of all that is to be diagnosed.
    task_of : callable
        Makes the task of a name, as for `in_parallel`; its ``name`` is added here.
    workers : int
        Processes.
    done : callable
        Gets the name of each that was diagnosed, in this thread.
    module : str
        What runs behind the fence.
    """
    folder.mkdir(exist_ok=True)

    def keep(task: Mapping[str, Any], answer: dict[str, Any]) -> None:
        write_text(folder / f"{task['name']}.json", json.dumps(answer, indent=1, allow_nan=False))
        done(task["name"])

    in_parallel([{"name": name, **task_of(name)} for name in unanswered(folder, names)], workers, keep, module)


def in_parallel(
    tasks: Iterable[Mapping[str, Any]],
    workers: int,
    done: Callable[[Mapping[str, Any], dict[str, Any]], None],
    module: str = WORKER,
) -> None:
    """Give tasks to workers as they become free.

    Parameters
    ----------
    tasks : iterable of mapping
        Each with ``recordings`` and whatever `Blind.diagnose` takes; ``name`` stays here.
    workers : int
        Processes.
    done : callable
        Gets a task and its answer, in this thread.
    module : str
        What runs behind the fence.
    """
    waiting: queue.SimpleQueue[Mapping[str, Any]] = queue.SimpleQueue()
    answers: queue.SimpleQueue[tuple[Mapping[str, Any] | None, Any]] = queue.SimpleQueue()
    count = 0
    for task in tasks:
        waiting.put(task)
        count += 1
    blinds = [Blind(module) for _ in range(min(workers, count))]

    def serve(blind: Blind) -> None:
        while True:
            try:
                task = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                answers.put((task, blind.diagnose(**{k: v for k, v in task.items() if k != "name"})))
            except Exception as error:  # handed to the thread that waits
                answers.put((None, error))
                return

    threads = [threading.Thread(target=serve, args=(blind,), daemon=True) for blind in blinds]
    try:
        for thread in threads:
            thread.start()
        for _ in range(count):
            finished, answer = answers.get()
            if finished is None:
                raise answer
            done(finished, answer)
    finally:
        for blind in blinds:
            blind.close()
