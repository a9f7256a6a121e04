"""What a recording can tell before it is fitted: widths to be expected, what looks alike, and which test would tell.

The most probable parameters and the curvature there take a second, where sampling takes several: a first answer, and
with the priors beside it a statement of what the test determines at all.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import InferenceError, PopulationError
from shj_bayes.inference.binning import Run
from shj_bayes.inference.likelihood import make_likelihood
from shj_bayes.inference.start import find_start, root_of
from shj_bayes.inference.store import remarks_of
from shj_bayes.mismatch.data import data_of
from shj_bayes.mismatch.regions import aliases_of
from shj_bayes.model.device import DeviceModel, meaning_of
from shj_bayes.population.readings import counted_from, of_readings, read_off
from shj_bayes.recording.motion import Motion, one_peak_speed
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

    Then comes the modelled force of each sample of each run, kN; empty where there is no answer. `threads` are the
    processors to use, 0 for all; the numbers do not depend on it.
    """
    n_half = sum(run.motion.n_half for run in runs)
    try:
        posterior, start = find_start(make_likelihood(runs, model), threads=threads)
    except InferenceError:
        return Identifiability(doubts=(Doubt.NO_TOP,), half_cycles=n_half), ()
    laws, names, last = posterior.model.laws, posterior.model.names, len(runs) - 1

    def forces_of(thetas: FloatArray, i: int) -> FloatArray:
        """Give the forces of the samples of a run, shape (n_thetas, n_samples), kN."""
        history, begins = posterior.histories[i], posterior.runs[i].start_force_kN
        return np.concatenate([np.asarray(posterior.model.force(one[None], history, begins)) for one in thetas])

    theta = laws.natural(start.free[None])
    forces = tuple(forces_of(theta, i)[0] for i in range(len(runs)))
    left = np.concatenate([(r.recording.force_kN - f)[r.used] for r, f in zip(runs, forces, strict=True)])
    rng = np.random.default_rng(np.random.SeedSequence(1, spawn_key=(11,)))
    natural = laws.natural(start.free + rng.standard_normal((DRAWS, start.free.size)) @ root_of(start.covariance).T)
    widths = np.minimum(np.sqrt(np.diag(start.covariance)), 1.0)  # priors are standard normal there
    low, high = np.quantile(natural, [0.05, 0.95], axis=0)
    parameters = tuple(
        ExpectedParameter(
            name=name,
            unit=meaning_of(name).unit,
            mean=float(natural[:, i].mean()),
            sd=float(natural[:, i].std()),
            q05=float(low[i]),
            q95=float(high[i]),
            prior_q05=float(law.quantile(0.05)),
            prior_q95=float(law.quantile(0.95)),
            narrowed=float(widths[i]),
        )
        for i, (name, law) in enumerate(zip(names, laws, strict=True))
    )
    # Smallest plateau force of the last run: its value, and its slope over the parameters of the law.
    steps = STEP * np.eye(start.free.size)[: posterior.model.n_law]
    around = laws.natural(np.concatenate([start.free[None], start.free + steps, start.free - steps]))
    motion, travel = posterior.runs[last].motion, posterior.histories[last].travel_m
    from_mm, least = counted_from([read_off(forces[last][None], motion, travel)]), None
    if math.isfinite(from_mm):
        with suppress(PopulationError):
            plateaus = of_readings(read_off(forces_of(around, last), motion, travel), from_mm)["least"]
            up, down = np.split(plateaus[1:], 2)
            slope = (up - down) / (2.0 * STEP)
            variance = float(slope @ start.covariance[: slope.size, : slope.size] @ slope)
            least = float(plateaus[0]), math.sqrt(variance)
    reach = 2.0 * float(theta[0, names.index("Fy")] / theta[0, names.index("K")])  # mm, from plateau to plateau
    said = Identifiability(
        doubts=() if least else (Doubt.NEVER_SLIDES,),
        parameters=parameters,
        remarks=remarks_of(posterior.model, natural),
        least_kN=least[0] if least else None,
        least_sd_kN=least[1] if least else None,
        rmse_kN=float(np.sqrt(np.mean(left**2))),
        half_cycles=n_half,
        readings_of_knee=float(np.median(np.concatenate([_in_knee(run.motion, reach) for run in runs]))),
        one_speed_mm_s=one_peak_speed(np.concatenate([run.motion.peak_mm_s[1:-1] for run in runs])),
        confusions=tuple(aliases_of(data_of(runs, model))),
    )
    return said, forces


def _in_knee(motion: Motion, reach_mm: float) -> FloatArray:
    """Count the readings of each half-cycle within a distance of its beginning."""
    begins = np.repeat(motion.turning_mm[: motion.n_half], np.diff(motion.start))
    near = np.abs(motion.displacement_mm - begins) <= reach_mm
    return np.add.reduceat(near.astype(np.float64), motion.start[:-1])
