"""What every rival is asked: the residual of our base law over the coordinates that our tool considers.

The base law, its fit, its noise and its nuisances (zero, start, Masing's rule) are those of the diagnosis, and so is
the split of cycles: a rival explains what is left, and is held against cycles that neither it nor the law saw.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.data import MODEL_ERROR, BinnedData, ErrorModel, ErrorParameters, data_of
from shj_bayes.mismatch.fitter import noise_of_size
from shj_bayes.mismatch.heldout import PARTS, cycles_of, places_left_out
from shj_bayes.mismatch.laplace import Laplace, find_noise, laplace, laplace_under
from shj_bayes.model.coordinates import coordinates
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import History
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording
from shj_validation.proof.predict import carried_on, predict

# All that the diagnosis has curves over, but for the same coordinate on another scale and products of two.
INPUTS = tuple(
    one
    for one in coordinates().values()
    if one.times is None and one.id not in ("late_travel", "early_time", "speed_felt")
)
WORDS = (*(one.group or one.id for one in INPUTS), "direction")
SAME = {"distance": "position"}  # one is a function of the other
PERMUTED = 300  # points of a split, at most
SENSE = len(INPUTS)  # column of the force of the law as a share of Fy: -1 to 1, and which way the device slides

GROUPS = [
    [i for i, other in enumerate(WORDS) if SAME.get(other, other) == word]
    for word in dict.fromkeys(SAME.get(w, w) for w in WORDS)
]
# What multiplies the sliding force needs the direction as much as its own coordinate: the direction is named alone.
DIRECTION = 0.1


@dataclass(frozen=True, eq=False)
class Part:
    """One of the splits: some cycles are left out, and the law is fitted without them."""

    residual: FloatArray  # shape (n,): measured less the force of that law, kN
    left: BoolArray  # shape (n,): what is left out


@dataclass(frozen=True, eq=False)
class Question:
    """The residual of the base law, and what it may depend on."""

    inputs: FloatArray  # shape (n, len(WORDS)): shares of the range, 0 to 1; the last -1 to 1
    residual: FloatArray  # shape (n,): measured less the force of the law, kN
    cycle: FloatArray  # shape (n,): number of the cycle, counted through all runs
    parts: tuple[Part, ...]
    # of the history that nobody saw: the inputs, and the force of the law, kN
    new_inputs: FloatArray
    new_force_kN: FloatArray
    seconds: float  # of the processor that all this took

    @property
    def before_kN(self) -> float:
        """Error of the law on cycles left out, kN."""
        return rms(np.concatenate([part.residual[part.left] for part in self.parts]))


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def question_of(paths: Sequence[Path], model: str, time_s: FloatArray, displacement_mm: FloatArray) -> Question:
    """Fit the base law to recordings and give what it leaves.

    Parameters
    ----------
    paths : sequence of Path
        Consecutive runs.
    model : {"published", "continuous"}
        Reversal rule.
    time_s, displacement_mm : array, shape (m,)
        A history that follows them; of its force nothing is known.
    """
    begin = time.process_time()
    recordings = [read(path) for path in paths]
    device = DeviceModel(len(recordings), read_priors("afc"), variant=model)
    data = data_of(runs_of(recordings), device)
    size = float(np.std(data.likelihood.at(device).residual(data.z[None])[0]))
    first = ErrorParameters(noise_of_size(device, size), MODEL_ERROR * data.scale_kN)
    rough = laplace_under(data, first, device, data.z)[1]
    setting = find_noise(data, rough, np.zeros((rough.residual.size, 0)), None)
    law = laplace_under(data, setting, device, rough.z)[1]
    fine = data.finer_at(device, law.z)
    used = fine.blocks.used > 0
    residual, parts = _split(fine, setting, law, used)
    histories = [part.history for part in fine.blocks]
    inputs = fine.blocks.mean([_columns(history, data.base) for history in histories])
    left = fine.likelihood.residual(law.z[None])[0]
    share = (fine.blocks.force_kN - left) * fine.blocks.used / data.scale_kN
    record = {
        "shift": {name: {"before": {"mean": value}} for name, value in device.law_values(law.z).items()},
        "model": {"variant": model},
    }
    tested = [(one.time_s, motion_of(one)) for one in recordings]
    new = (time_s, motion_of(Recording(time_s, displacement_mm, np.zeros_like(time_s))))
    force = predict(record, tested, new, "before")
    return Question(
        inputs=np.column_stack([inputs, share])[used],
        residual=residual[used],
        cycle=cycles_of(fine)[used].astype(np.float64),
        parts=parts,
        new_inputs=np.column_stack([_columns(carried_on(tested, new), data.base), force / data.scale_kN]),
        new_force_kN=force,
        seconds=time.process_time() - begin,
    )


def _columns(history: History, base: Base) -> FloatArray:
    """Coordinates at the points of a history, as shares of their ranges."""
    return np.stack([np.broadcast_to(one.share(history, base), history.time_s.shape) for one in INPUTS], axis=1)


def _split(
    data: BinnedData, setting: ErrorParameters, law: Laplace, used: BoolArray
) -> tuple[FloatArray, tuple[Part, ...]]:
    """Give the residual of the law, and of the law without every eighth cycle, as in `heldout.held_out`."""
    metric, state = laplace_under(data, setting, law.model, law.z)
    place, n_left = places_left_out(data)
    n_parts = min(PARTS, n_left)
    parts = []
    for part in range(n_parts):
        left = (place >= 0) & (place % n_parts == part)
        rest = ErrorModel(data, setting, metric.slope, ~left[used])
        refit = laplace(rest, state.model, state.z)
        parts.append(Part((refit.residual - rest.integrated_out(refit.residual)[1])[used], left[used]))
    return state.residual - metric.integrated_out(state.residual)[1], tuple(parts)


def answer(question: Question, method: Any) -> dict[str, Any]:
    """Put a question to a method."""
    begin = time.process_time()
    q = question
    found = method(q.inputs, q.residual, q.cycle, None)
    wrong, importance = [], np.zeros(len(WORDS))
    rng = np.random.default_rng(1)
    for part in q.parts:
        kept = ~part.left
        own = method(q.inputs[kept], part.residual[kept], q.cycle[kept], found)
        there, after = q.inputs[part.left], part.residual[part.left] - own.predict(q.inputs[part.left])
        wrong.append(after)
        if found.permutes:
            few = rng.permutation(len(there))[:PERMUTED]
            importance += _permuted(own.predict, there[few], part.residual[part.left][few], after[few], rng)
    after = rms(np.concatenate(wrong))
    force = q.new_force_kN + found.predict(q.new_inputs)
    return {
        "by_permutation": ranked(importance) if found.permutes else None,
        "by_itself": None if found.relevance is None else ranked(found.relevance),
        "gain": 1.0 - (after / q.before_kN) ** 2,
        "before_kN": q.before_kN,
        "after_kN": after,
        "seconds": q.seconds + time.process_time() - begin,
        "points": found.points,
        "earthquake_kN": [round(float(f), 4) for f in force],
    }


def _permuted(
    predict: Callable[[FloatArray], FloatArray],
    inputs: FloatArray,
    target: FloatArray,
    after: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """Give how much more is wrong in cycles left out once inputs are permuted, shape (len(WORDS),), kN2.

    Inputs that are functions of one another (the heat states, the position and its distance from the middle) are
    permuted together, as scikit-learn advises.
    """
    out = np.zeros(len(WORDS))
    for group in GROUPS:
        moved = inputs.copy()
        moved[:, group] = inputs[rng.permutation(len(inputs))][:, group]
        out[group] = np.sum((target - predict(moved)) ** 2) - np.sum(after**2)
    return out


def ranked(relevance: FloatArray) -> list[dict[str, Any]]:
    """Coordinates that matter, by how much they do, each word once."""
    best: dict[str, float] = {}
    for word, value in zip(WORDS, relevance, strict=True):
        best[word] = max(float(value) * (DIRECTION if word == "direction" else 1.0), best.get(word, 0.0))
    return [{"coordinate": w, "relevance": v} for w, v in sorted(best.items(), key=lambda pair: -pair[1]) if v > 0.0]
