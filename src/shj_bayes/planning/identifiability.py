"""What a recording can tell before it is fitted: widths to be expected, what looks alike, and which test would tell.

The most probable parameters and the curvature there take a second, where sampling takes several: a first answer, and
with the priors beside it a statement of what the test determines at all.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import InferenceError, PopulationError
from shj_bayes.inference.binning import Run
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.start import Start, find_start, root_of
from shj_bayes.inference.store import remarks_of
from shj_bayes.mismatch.data import data_of
from shj_bayes.mismatch.regions import aliases_of
from shj_bayes.model.device import DeviceModel, meaning_of
from shj_bayes.population.readings import counted_from, of_readings, read_off
from shj_bayes.recording.motion import one_peak_speed
from shj_bayes.results.diagnosis import Alias
from shj_bayes.results.fit import RemarkRecord

DRAWS = 2000
FEW_READINGS = 4  # on the way from one plateau to the other: fewer leave its shape to the prior
STEP = 1e-3  # of unbounded parameters, for central differences


class Doubt(StrEnum):
    """Why a device cannot be fitted."""

    NEVER_SLIDES = "never-slides"  # no half-cycle has a plateau, so that the sliding force rests on its prior
    NO_TOP = "no-top"  # no parameters of the model give a finite density


@dataclass(frozen=True, kw_only=True)
class ExpectedParameter:
    """A parameter before sampling: its most probable value and the width that a fit will have, about."""

    name: str
    unit: str
    mean: float
    sd: float
    q05: float
    q95: float
    # before the test
    prior_q05: float
    prior_q95: float
    narrowed: float  # width after the test over that before it, in the coordinates of the prior


@dataclass(frozen=True, kw_only=True)
class Identifiability:
    """What a device's recordings can tell."""

    doubts: tuple[Doubt, ...]  # with any of them a fit would say nothing of the device
    parameters: tuple[ExpectedParameter, ...] = ()
    remarks: tuple[RemarkRecord, ...] = ()  # what the data do not say, as a fit will remark it
    # smallest plateau force of the last run, kN, and its standard deviation: the force that displacements rest on
    least_kN: float | None = None
    least_sd_kN: float | None = None
    rmse_kN: float | None = None  # of what the law leaves over
    half_cycles: int = 0
    readings_of_knee: float | None = None  # of one half-cycle, on its way from one plateau to the other
    one_speed_mm_s: float | None = None  # peak speed of nearly all cycles; None where they differ
    confusions: tuple[Alias, ...] = ()  # effects that this displacement history cannot tell apart, most alike first

    @property
    def few_readings(self) -> bool:
        """Whether too few readings lie on the way from one plateau to the other to show its shape."""
        return self.readings_of_knee is not None and self.readings_of_knee < FEW_READINGS


def first_answer(
    runs: Sequence[Run], model: DeviceModel, *, threads: int = 0
) -> tuple[Identifiability, tuple[FloatArray, ...]]:
    """Find the most probable parameters of consecutive runs, and what such a test tells of them.

    Then comes the modelled force of each sample of each run, kN; empty where there is no answer.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs of a device.
    model : DeviceModel
        What is believed of it.
    threads : int
        Processors to use, 0 for all; the numbers do not depend on it.
    """
    n_half = sum(run.motion.n_half for run in runs)
    try:
        posterior, start = find_start(make_likelihood(runs, model), threads=threads)
    except InferenceError:
        return Identifiability(doubts=(Doubt.NO_TOP,), half_cycles=n_half), ()
    theta = posterior.model.laws.natural(start.free[None])[0]
    forces = tuple(_force(posterior, theta, i) for i in range(len(runs)))
    left = np.concatenate([(r.recording.force_kN - f)[r.used] for r, f in zip(runs, forces, strict=True)])
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(11,)))
    free = start.free + rng.standard_normal((DRAWS, start.free.size)) @ root_of(start.covariance).T
    natural = posterior.model.laws.natural(free)
    least = _least(posterior, start, forces[-1])
    stiffness, capacity = (float(theta[posterior.model.names.index(name)]) for name in ("K", "Fy"))
    said = Identifiability(
        doubts=() if least else (Doubt.NEVER_SLIDES,),
        parameters=_expected(posterior, start, natural),
        remarks=remarks_of(posterior.model, natural),
        least_kN=None if least is None else least[0],
        least_sd_kN=None if least is None else least[1],
        rmse_kN=float(np.sqrt(np.mean(left**2))),
        half_cycles=n_half,
        readings_of_knee=float(np.median(np.concatenate([_in_knee(r, 2.0 * capacity / stiffness) for r in runs]))),
        one_speed_mm_s=one_peak_speed(np.concatenate([run.motion.peak_mm_s[1:-1] for run in runs])),
        confusions=tuple(aliases_of(data_of(runs, model))),
    )
    return said, forces


def _expected(posterior: Likelihood, start: Start, natural: FloatArray) -> tuple[ExpectedParameter, ...]:
    """Rows of the parameters from draws in natural units, shape (n, d)."""
    laws = posterior.model.laws
    widths = np.sqrt(np.diag(start.covariance))  # priors are standard normal there
    low, high = np.quantile(natural, [0.05, 0.95], axis=0)
    return tuple(
        ExpectedParameter(
            name=parameter.name,
            unit=parameter.unit,
            mean=float(natural[:, i].mean()),
            sd=float(natural[:, i].std()),
            q05=float(low[i]),
            q95=float(high[i]),
            prior_q05=float(law.quantile(0.05)),
            prior_q95=float(law.quantile(0.95)),
            narrowed=float(min(widths[i], 1.0)),
        )
        for i, (parameter, law) in enumerate(zip(map(meaning_of, posterior.model.names), laws, strict=True))
    )


def _force(posterior: Likelihood, theta: FloatArray, i: int) -> FloatArray:
    """Modelled force of the samples of a run, shape (n_samples,), kN."""
    return np.asarray(posterior.model.force(theta[None], posterior.histories[i], posterior.runs[i].start_force_kN)[0])


def _least(posterior: Likelihood, start: Start, force_kN: FloatArray) -> tuple[float, float] | None:
    """Smallest plateau force of the last run and its standard deviation, kN; None where no half-cycle slides fully."""
    i = len(posterior.runs) - 1
    motion, travel = posterior.runs[i].motion, posterior.histories[i].travel_m
    middle = read_off(force_kN[None], motion, travel)
    from_mm = counted_from([middle])
    if not math.isfinite(from_mm):
        return None
    steps = STEP * np.eye(start.free.size)[: posterior.model.n_law]
    theta = posterior.model.laws.natural(np.concatenate([start.free + steps, start.free - steps]))
    history, begins = posterior.histories[i], posterior.runs[i].start_force_kN
    force = np.concatenate([np.asarray(posterior.model.force(one[None], history, begins)) for one in theta])
    try:
        here = float(of_readings(middle, from_mm)["least"][0])
        up, down = np.split(of_readings(read_off(force, motion, travel), from_mm)["least"], 2)
    except PopulationError:
        return None
    slope = (up - down) / (2.0 * STEP)
    return here, math.sqrt(float(slope @ start.covariance[: slope.size, : slope.size] @ slope))


def _in_knee(run: Run, reach_mm: float) -> FloatArray:
    """Count the readings of each half-cycle within a distance of its beginning."""
    motion = run.motion
    begins = np.repeat(motion.turning_mm[: motion.n_half], np.diff(motion.start))
    near = np.abs(motion.displacement_mm - begins) <= reach_mm
    return np.add.reduceat(near.astype(np.float64), motion.start[:-1])
