"""What a finished diagnosis predicts for a displacement history that it has not seen."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.device import effect_named, force_with_effects
from shj_bayes.model.effects.effect import Base, Effect
from shj_bayes.model.history import History, histories, on_scales_of
from shj_bayes.model.parameters import run_name
from shj_bayes.recording.motion import Motion


def law_of(record: Mapping[str, Any], when: str) -> dict[str, float]:
    """Give the medians of the law's parameters by name; their means in a diagnosis without medians."""
    rows = {name: row[when] for name, row in record["shift"].items()}
    return {name: float(row["q50"] if "q50" in row else row["mean"]) for name, row in rows.items()}


def acting_in(record: Mapping[str, Any]) -> list[tuple[Effect, Mapping[str, float]]]:
    """Effects of the model that was found, curves among them, with the medians of their parameters."""
    return [(effect_named(name), values) for name, values in record["modelled"].items()]


def carried_on(tested: Sequence[tuple[FloatArray, Motion]], new: tuple[FloatArray, Motion]) -> History:
    """History of a further run of the device, on the scales of those that were tested."""
    scales = histories([time for time, _ in tested], [motion for _, motion in tested])[0]
    last = histories([*(time for time, _ in tested), new[0]], [*(motion for _, motion in tested), new[1]])[-1]
    middle = float((scales.motion.displacement_mm - scales.position_mm)[0])
    return on_scales_of(last, scales, new[1].displacement_mm - middle)


def predict(
    record: Mapping[str, Any], tested: Sequence[tuple[FloatArray, Motion]], new: tuple[FloatArray, Motion], when: str
) -> FloatArray:
    """Force for a further run of the device, with the parameter medians of the diagnosis.

    The device carries on from its last run: same clamping, travel and time counted on. Lengths, speeds and durations
    that effects refer to (half stroke, peak speed, testing time) are those of the tested runs, whatever the new motion.

    Parameters
    ----------
    record : mapping
        Content of ``diagnosis.json``.
    tested : sequence of (array, Motion)
        Times (s) and motion of the runs that were diagnosed.
    new : (array, Motion)
        Times and motion of the further run.
    when : {"before", "after"}
        The law as published, or with the effects that were found.

    Returns
    -------
    array, shape (n_samples,)
        Force, kN.
    """
    history = carried_on(tested, new)
    values = law_of(record, when)
    ratio = values[run_name("ratio", len(tested))] if len(tested) > 1 else 1.0
    base = Base(values["K"], values["Fy"] * ratio, values["beta"], values.get("gamma", 0.0), values["Fy"])
    acting = acting_in(record) if when == "after" else []
    return np.asarray(force_with_effects(history, base, acting, variant=record["model"]["variant"]))
