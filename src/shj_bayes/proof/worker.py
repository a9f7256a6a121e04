"""The process behind the fence: it gets folders of recordings on its standard input and answers with diagnoses.

One line in, one line out, both JSON. It is started with ``python -I -m shj_bayes.proof.worker FOLDER`` in an empty
environment; FOLDER holds copies of the recordings and nothing else.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from shj_bayes.errors import ShjError
from shj_bayes.proof.blind import diagnose_blind
from shj_bayes.proof.fence import raise_fence


def main() -> None:
    """Answer until the input ends."""
    folder = Path(sys.argv[1])
    raise_fence(folder)
    answers = sys.stdout
    sys.stdout = sys.stderr  # whatever a library prints must not be taken for an answer
    for line in sys.stdin:
        task = json.loads(line)
        paths = [folder / name for name in task.pop("files")]
        try:
            answer: dict[str, Any] = {"record": diagnose_blind(paths, **task)}
        except (ShjError, ArithmeticError, ValueError) as error:  # one unusable trial must not end the proof
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer, allow_nan=False) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
