"""The process behind the fence: it gets folders of recordings on its standard input and answers with diagnoses.

One line in, one line out, both JSON. It is started with ``python -I -m shj_validation.proof.worker FOLDER`` in an empty
environment; FOLDER holds copies of the recordings and nothing else.
"""

import json
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import shj_bayes
from shj_bayes.errors import ShjError
from shj_validation.proof.blind import diagnose_blind
from shj_validation.proof.fence import raise_fence


def serve(answer_of: Callable[..., dict[str, Any]]) -> None:
    """Answer until the input ends, which is at once when the process that asks is gone.

    ``answer_of(paths, **task)`` gives the answer to a task.
    """
    folder = Path(sys.argv[1])
    raise_fence(folder)
    answers = sys.stdout
    sys.stdout = sys.stderr  # whatever a library prints must not be taken for an answer
    tasks: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    while True:
        task = json.loads(tasks.get())
        paths = [folder / name for name in task.pop("files")]
        try:
            answer: dict[str, Any] = {"record": answer_of(paths, **task)}
        except (ShjError, ArithmeticError, ValueError) as error:  # one unusable trial must not end the proof
            answer = {"error": f"{type(error).__name__}: {error}"}
        answer["installed"] = str(Path(shj_bayes.__file__).parent)
        answers.write(json.dumps(answer, allow_nan=False) + "\n")
        answers.flush()


def _listen(tasks: SimpleQueue[str]) -> None:
    """Hand on the tasks; end the process, even in the midst of one, when no more can come."""
    for line in sys.stdin:
        tasks.put(line)
    os._exit(0)


if __name__ == "__main__":
    serve(diagnose_blind)
