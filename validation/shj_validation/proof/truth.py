"""What the key says that a diagnosis can be held against: what can be seen of it, and the true base parameters."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.optimize import least_squares
from scipy.signal import lfilter

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.inference.binning import runs_of
from shj_bayes.model.law import BETA_RANGE, force_of_laws, masing_force
from shj_bayes.recording.recording import Recording
from shj_validation.proof.cases import Key
from shj_validation.proof.make import Made, make
from shj_validation.proof.simulators.simulator import simulators_by_id

PRACTICAL = 0.01  # of Fy: the size that the tool calls negligible for design ; fixed here
EVIDENCE = 25.0  # log-likelihood that the visible part must be worth under the trial's own noise
AVERAGED_HZ = 5.0  # noise and misfit are compared on averages: as many at any sampling rate
ORDER = 8  # of the autoregression that stands for the averaged noise
# of ln K, ln Fy, ln beta, gamma, ln ratio and Masing's share: hold what the test leaves open
WIDTHS = np.array([1.0, 1.0, 1.5, 0.1, 1.0, 1.0])
FIT_SAMPLES = 6000  # of both runs, for the fit


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known about a trial once its key is open.

    Parameters
    ----------
    base : dict of str to float
        Base parameters of the same rig without noise, with the load cell's zero set and without what is concealed: Eq.
        (1) fitted to it. (A rest at one end of the stroke would push an error of the zero into them.)
    visible_share : float
        Part of what is concealed that no base parameters can take up, 99th percentile, as a share of Fy.
    evidence : float
        Log-likelihood that this part is worth under the trial's noise.
    bare_share : float
        The same percentile for the rig without anything concealed: what the nuisances and the Iwan element leave.
    each : dict of str to (float, float)
        By effect, ``visible_share`` and ``evidence`` of the force that it adds to that of the others; the share is at
        most that of this force itself.
    """

    base: dict[str, float]
    visible_share: float
    evidence: float
    bare_share: float
    each: dict[str, tuple[float, float]]

    @property
    def detectable(self) -> bool:
        """Whether any of what is concealed must be named."""
        return bool(self.required)

    @property
    def required(self) -> set[str]:
        """Effects that must be named: beside the other one, each matters and can be told from the noise by itself."""
        return {name for name, (share, worth) in self.each.items() if share >= PRACTICAL and worth >= EVIDENCE}


@dataclass(frozen=True, eq=False)
class Perfect:
    """The base law fitted to what a recorder without noise would show.

    Parameters
    ----------
    base : dict of str to float
        Parameters.
    force_kN, misfit_kN : array, shape (n,)
        Force of the recorder, and what the law leaves of it, kN; runs one after the other.
    used : array of bool, shape (n,)
        Samples whose half-cycle is sure.
    slopes : array, shape (n, 5)
        Derivatives of the law by its parameters.
    """

    base: dict[str, float]
    force_kN: FloatArray
    misfit_kN: FloatArray
    used: BoolArray
    slopes: FloatArray

    def visible(self, part_kN: FloatArray) -> FloatArray:
        """Take off what the base parameters can take up of a part of the force, kN; 0 where no sample is used."""
        by, own = self.slopes[self.used], part_kN[self.used]
        out = np.zeros(part_kN.size)
        out[self.used] = own - by @ np.linalg.lstsq(by, own, rcond=None)[0]
        return out

    def share(self, part_kN: FloatArray, capacity_kN: float) -> float:
        """Size of a part of the force: the 99th percentile over the samples used, as a share of the capacity."""
        return float(np.percentile(np.abs(part_kN[self.used]), 99)) / capacity_kN


def truth_of(key: Key, made: list[Made] | None = None) -> Truth:
    """Work out the truth of a trial from its key.

    Parameters
    ----------
    key : Key
        The opened key.
    made : list of Made, optional
        The trial's recordings, where they have been made already.

    Returns
    -------
    Truth
    """
    made = made or make(key)
    zeroed = replace(key, nuisance=replace(key.nuisance, offset_kN=0.0))
    bare = fit_perfect(zeroed, make(zeroed, effects=()))
    whole = fit_perfect(key, made)
    capacity = key.device.Fy

    def weigh(part_kN: FloatArray, of_kN: FloatArray) -> tuple[float, float]:
        return min(whole.share(part_kN, capacity), whole.share(of_kN, capacity)), worth(part_kN, made)

    share, evidence = weigh(whole.misfit_kN, whole.misfit_kN)
    each = {}
    for one in key.effects:
        rest = make(key, effects=[other for other in key.effects if other is not one])
        lesser = np.concatenate([run.clean_kN for run in rest[:2]])
        added = whole.force_kN - lesser
        each[one.id] = weigh(whole.visible(added), added)
    return Truth(bare.base, share, evidence, bare.share(bare.misfit_kN, capacity), each)


def worth(part_kN: FloatArray, made: list[Made]) -> float:
    """Log-likelihood that a part of the force is worth under the trial's own noise.

    Both are averaged; an autoregression fitted to the noise (Yule and Walker) whitens both.
    """
    width = max(1, round(1.0 / (AVERAGED_HZ * float(np.diff(made[0].recording.time_s[:2])[0]))))
    noises = [_averaged(one.noise_kN, width) for one in made[:2]]
    parts = np.split(part_kN, [made[0].clean_kN.size])
    products = np.zeros(ORDER + 1)
    for series in noises:
        products += [float(series[: series.size - lag] @ series[lag:]) for lag in range(ORDER + 1)]
    whitener = np.append(1.0, -solve_toeplitz(products[:-1], products[1:]))
    news = sum(float(np.sum(lfilter(whitener, [1.0], series)[ORDER:] ** 2)) for series in noises)
    variance = news / sum(series.size - ORDER for series in noises)
    return float(sum(np.sum(lfilter(whitener, [1.0], _averaged(part, width)) ** 2) for part in parts)) / (
        2.0 * variance
    )


def _averaged(series: FloatArray, width: int) -> FloatArray:
    """Means of so many neighbouring samples."""
    whole = series[: series.size // width * width]
    return np.asarray(whole.reshape(-1, width).mean(axis=1))


def effect_truths(key: Key) -> dict[str, dict[str, float]]:
    """List true values of the catalogue's parameters by effect, where the physics has an exact counterpart."""
    known = simulators_by_id()
    out = {}
    for one in key.effects:
        values = dict(known[one.id].truth(one.size, one.shape, key.device))
        if one.id == "sensor_lag" and "size" in values:  # the nuisances add to it
            values["size"] += key.nuisance.lag_s
        # An offset too small to be named shows as a difference between push and pull.
        if one.id in ("load_offset", "asymmetry") and "size" in values:
            values["size"] += key.nuisance.offset_kN / key.device.Fy
        out[known[one.id].effect] = values
    return out


def kept_base(key: Key) -> set[str]:
    """Name the base parameters that keep their meaning beside everything that is concealed."""
    names = {"K", "Fy", "beta", "gamma", "ratio"}
    for one in key.effects:
        names &= set(simulators_by_id()[one.id].base)
    return names


def fit_perfect(key: Key, made: list[Made]) -> Perfect:
    """Fit Eq. (1) and (2) under the key's reversal rule to what a recorder without noise would show.

    In cycles that turn before the device slides it may follow Masing's rule instead, or lie between: a share is fitted.
    """
    runs = runs_of([Recording(one.recording.time_s, one.x_mm, one.clean_kN) for one in made[:2]])
    force = np.concatenate([one.clean_kN for one in made[:2]])
    used = np.concatenate([run.used for run in runs])
    device = key.device
    start = np.array(
        [np.log(device.K), np.log(device.Fy), np.log(device.beta), device.gamma, np.log(device.ratio), 0.0]
    )

    def law(p: FloatArray) -> FloatArray:
        out = []
        for i, run in enumerate(runs):
            values = np.array([np.exp(p[0]), np.exp(p[1] + i * p[4]), np.exp(p[2]), p[3]])
            own = force_of_laws(run.motion, values[None], variant=key.reversal)[0]
            out.append(own + p[5] * (masing_force(run.motion, values) - own))
        return np.concatenate(out)

    some = np.flatnonzero(used)[:: max(1, int(used.sum()) // FIT_SAMPLES)]
    sd = key.nuisance.noise_kN

    def off(p: FloatArray) -> FloatArray:
        return np.concatenate([(law(p)[some] - force[some]) / sd, (p - start) / WIDTHS])

    bounds = (np.full(6, -np.inf), np.full(6, np.inf))
    bounds[0][2], bounds[1][2] = np.add(np.log(BETA_RANGE), (0.01, -0.01))  # slopes are taken on both sides
    best = least_squares(off, start, bounds=bounds, x_scale=np.array([0.1, 0.1, 0.3, 0.01, 0.1, 1.0])).x
    steps = np.diag([1e-4, 1e-4, 1e-3, 1e-5, 1e-4, 0.0])[:5]
    slopes = np.column_stack([(law(best + d) - law(best - d)) / (2 * d.sum()) for d in steps])
    base = {"K": np.exp(best[0]), "Fy": np.exp(best[1]), "beta": np.exp(best[2]), "gamma": best[3]}
    base["ratio"] = np.exp(best[4])
    return Perfect({name: float(value) for name, value in base.items()}, force, force - law(best), used, slopes)
