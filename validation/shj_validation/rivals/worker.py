"""The process behind the fence that puts the trials to the rivals; as `shj_validation.proof.worker`."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shj_validation.proof.worker import serve
from shj_validation.rivals.methods import METHODS
from shj_validation.rivals.question import answer, question_of


def answers_of(paths: Sequence[Path], *, model: str, methods: Sequence[str]) -> dict[str, Any]:
    """Ask methods about one device: all but the last file are its recordings, the last is a motion without forces."""
    time_s, displacement_mm = np.loadtxt(paths[-1], delimiter=",", ndmin=2).T
    question = question_of(paths[:-1], model, time_s, displacement_mm)
    out: dict[str, Any] = {"base_s": question.seconds}
    for name in methods:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of fits that stop at a bound; what they predict is judged
            try:
                out[name] = answer(question, METHODS[name])
            except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:  # counts as wrong
                out[name] = {"error": f"{type(error).__name__}: {error}"}
    return out


if __name__ == "__main__":
    serve(answers_of)
