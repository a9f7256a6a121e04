"""Design quantities that a test may make narrow, by name."""

from collections.abc import Callable

import numpy as np

from shj_bayes.errors import PlanError, did_you_mean
from shj_bayes.margins.quantities import counted_from, of_readings
from shj_bayes.margins.virtual_test import Readings, read_off
from shj_bayes.model.device import DeviceModel, meaning_of
from shj_bayes.model.parameters import FloatArray, run_name
from shj_bayes.planning.foresight import ForeseenQuantity, quantity_of
from shj_bayes.planning.known import Known
from shj_bayes.planning.plan import FORCE, WHICH

MARGIN = "least"  # as in the sheet of margins: smallest plateau force of the last test


def questions_of(known: Known) -> tuple[str, ...]:
    """Everything that may be asked of a device."""
    planned = run_name("ratio", known.device.n_runs)
    base = (n for n in known.device.law_names if "." not in n and n != planned)
    return (WHICH, FORCE, *base, *((MARGIN,) if known.runs else ()))


def quantity_named(known: Known, name: str) -> ForeseenQuantity:
    """Quantity of a name, for one device; `PlanError` where it has none of that name."""
    able = questions_of(known)
    if name not in able or name in (WHICH, FORCE):
        raise PlanError(f"{known.name}: '{name}' is no question; known are {', '.join(able)}{did_you_mean(name, able)}")
    if name == MARGIN:
        return quantity_of(known, "kN", _smallest_plateau(known))
    return quantity_of(known, meaning_of(name).unit, lambda model, z: model.law_values(z)[name])


def _smallest_plateau(known: Known) -> Callable[[DeviceModel, FloatArray], float]:
    """Smallest plateau force of a device in its last test, as a model gives it."""
    history, first = known.old[-1].history, known.beliefs[0]

    def read(model: DeviceModel, z: FloatArray) -> Readings:
        force = model.force(model.natural_of_law(z[None]), history, 0.0)
        return read_off(force, history.motion, history.travel_m)

    least = counted_from([read(first.model, first.z)])
    if not np.isfinite(least):
        raise PlanError(f"{known.name}: no half-cycle of its last test slides fully, so it has no plateau force")
    return lambda model, z: float(of_readings(read(model, z), least)["least"][0])
