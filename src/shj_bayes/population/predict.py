"""A new device: its parameters, tied as those of the tested devices are, its quantities and its loop.

Quantities are pooled one by one; the correlation between them joins them. Devices are standardised with the level of
their own set and its spread, and the correlation of what is left is inferred with an inverse-Wishart law whose
correlations are uniform on (-1, 1) before any device is seen (Barnard, McCulloch and Meng 2000). A new device is then
drawn with its quantities tied together, each with exactly the band it had by itself (a normal copula; inference in two
steps, Joe and Xu 1996).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray, frozen
from shj_bayes.errors import PopulationError
from shj_bayes.model.law import BETA_RANGE, force_of_laws, work_between
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.quantities import (
    ASSUMED,
    LATER_RUNS,
    LEVELS,
    QUANTITIES,
    Band,
    Ordered,
    band_of,
    quantity,
    stream,
)
from shj_bayes.recording.motion import Block, exact_motion


def scatter(result: PopulationResult, prior: str = "default") -> tuple[tuple[str, ...], FloatArray, int]:
    """Sum of squares and products of the standardised devices about their set, and its degrees of freedom.

    Names of the quantities; products over the devices that give every quantity, shape (k, k); devices less sets, 0
    where every set has one device.
    """
    names = tuple(result.posteriors)
    products, degrees = np.zeros((len(names), len(names))), 0
    spread = np.array([np.median(result.fit(q, prior).tau, axis=0) for q in names])
    for i, group in enumerate(result.sets):
        values = np.array([group.points.get(q, (np.nan,) * len(group.devices)) for q in names])
        values = values[:, np.all(np.isfinite(values), axis=0)]
        if values.shape[1] < 2:
            continue
        apart = (values - values.mean(axis=1, keepdims=True)) / spread[:, i, None]
        products += apart @ apart.T
        degrees += values.shape[1] - 1
    return names, products, degrees


def inverse_wishart(degrees: float, scale: FloatArray, n_draws: int, rng: np.random.Generator) -> FloatArray:
    """Draw from an inverse Wishart distribution by the decomposition of Bartlett, shape (n_draws, k, k).

    `scipy.stats.invwishart` does so too, but its module takes longer to import than all else of a comparison, and it
    goes through the draws one by one.
    """
    k = scale.shape[0]
    roots = np.zeros((n_draws, k, k))  # lower triangles whose inverses are the factors of draws of unit scale
    roots[:, *np.tril_indices(k, k=-1)] = rng.normal(size=(n_draws, k * (k - 1) // 2))
    places = np.arange(k)
    roots[:, places, places] = np.sqrt(rng.chisquare(degrees - k + 1 + places, size=(n_draws, k)))
    factors = np.linalg.solve(roots.transpose(0, 2, 1), np.linalg.cholesky(scale).T)
    return np.asarray(factors.transpose(0, 2, 1) @ factors)


def correlation_draws(result: PopulationResult, n_draws: int, prior: str = "default") -> FloatArray:
    """Posterior draws of the correlation between the quantities of one device, shape (n_draws, k, k)."""
    names, products, degrees = scatter(result, prior)
    k = len(names)
    if k == 1:
        return np.ones((n_draws, 1, 1))
    seed = stream(result.seed, "correlation", prior)
    drawn = inverse_wishart(k + 1 + degrees, np.eye(k) + products, n_draws, np.random.default_rng(seed))
    scale = np.sqrt(np.einsum("nii->ni", drawn))
    return np.asarray(drawn / (scale[:, :, None] * scale[:, None, :]))


def correlation_table(result: PopulationResult) -> list[dict[str, object]]:
    """Middle and 90 % interval of the correlation of every pair, and on how many degrees of freedom it rests."""
    names, _, degrees = scatter(result)
    draws = correlation_draws(result, 4000)
    rows: list[dict[str, object]] = []
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            low, middle, high = band_of(draws[:, i, j])
            rows.append({"pair": [b, a], "q05": low, "q50": middle, "q95": high, "degrees_of_freedom": degrees})
    return rows


SECOND_RUN = "Fy_second"
RUN_FORCES = {SECOND_RUN: "ratio"} | {f"Fy_run{run}": f"ratio_{run}" for run in LATER_RUNS}
"""Sliding force of each later run: the ratio that makes it from that of the first."""
UNITS = {q.name: q.unit for q in QUANTITIES.values()} | dict.fromkeys(RUN_FORCES, "kN")
ENOUGH_SETS = 5


@dataclass(frozen=True)
class NewDevice:
    """Predictive draws of a device not yet tested."""

    set_name: str  # its set, or "(any set)"
    n_devices: int  # tested devices of that set
    # shape (n_draws,): natural units: K kN/mm, Fy kN, ratio 1, gamma s/mm, beta 1, Fy_second kN
    draws: Mapping[str, FloatArray] = field(repr=False)

    def band(self, name: str) -> Band:
        """5, 50 and 95 % quantiles, natural unit."""
        return self.ordered(name).band

    def ordered(self, name: str) -> Ordered:
        """Draws of a quantity, for quantiles."""
        return self._ordered.setdefault(name, Ordered(self.draws[name]))

    @cached_property
    def _ordered(self) -> dict[str, Ordered]:
        return {}


def new_device(result: PopulationResult, set_name: str = ANY_SET, prior: str = "default") -> NewDevice:
    """Draw new devices of a set, or of one never tested (``ANY_SET``), under a prior, one per posterior draw.

    `PopulationError` where there is no such set or prior.
    """
    index = None if set_name == ANY_SET else result.index(set_name)
    return _new_device(result, index, prior)


@lru_cache(maxsize=64)
def _new_device(result: PopulationResult, index: int | None, prior: str) -> NewDevice:
    name = ANY_SET if index is None else result.set_names[index]
    drawn = []
    for q in result.posteriors:
        rng = np.random.default_rng(stream(result.seed, "new device", name, q, prior))
        mu, tau = result.fit(q, prior).level_and_spread(index, rng)
        drawn.append((mu, tau, rng.standard_normal(mu.size)))
    levels, spreads, apart = (np.array(rows) for rows in zip(*drawn, strict=True))
    together = np.einsum("nij,jn->in", _ties(result, levels.shape[1], prior), apart)
    values = zip(result.posteriors, levels + spreads * together, strict=True)
    draws: dict[str, FloatArray] = {q: quantity(q).natural(pooled) for q, pooled in values}
    draws |= {force: draws["Fy"] * draws[q] for force, q in RUN_FORCES.items() if "Fy" in draws and q in draws}
    n = 0 if index is None else len(result.sets[index].devices)
    return NewDevice(name, n, draws)


@lru_cache(maxsize=4)
def _ties(result: PopulationResult, n_draws: int, prior: str) -> FloatArray:
    """Lower triangular roots of the correlations, shape (n_draws, k, k); all sets share them."""
    return frozen(np.linalg.cholesky(correlation_draws(result, n_draws, prior)))


def sets_suffice(n_sets: int) -> bool:
    """Whether so many tested sets say enough of how sets differ for the band of a set never tested to be shown.

    Tried on the example campaign: two sets of 75 to 85 and 86 to 98 kN give 26 to 279 kN for a third, nearly all of it
    the prior of how sets differ; the fifteen published sets give 42 to 116 kN. Below `ENOUGH_SETS` (four degrees of
    freedom between sets) pages and texts say so in words; the files keep the numbers.
    """
    return n_sets >= ENOUGH_SETS


def never_tested_words(n_sets: int) -> str:
    """Say why nothing is said of a set never tested."""
    return (
        f"Nothing is said of a set that was never tested: {n_sets} tested "
        f"{'set does' if n_sets == 1 else 'sets do'} not tell how much sets differ ({ENOUGH_SETS} or more would)."
    )


def devices_behind(result: PopulationResult, set_name: str, name: str) -> int:
    """Count the tested devices of a set that give a quantity; a later run's force needs the first one and the ratio."""
    needed = ("Fy", RUN_FORCES[name]) if name in RUN_FORCES else (name,)
    return 0 if set_name == ANY_SET else min(result.fit(q).n_devices[result.index(set_name)] for q in needed)


def dep_words(low: float, high: float) -> str:
    """Describe a band of gamma, s/mm, as dep = 1/gamma, mm/s, for those who are used to it."""
    if low < 0 < high:
        return f"below {1 / low:.0f} or above {1 / high:.0f} mm/s; no dependence is inside the band"
    return f"{1 / high:.0f} to {1 / low:.0f} mm/s"


def new_device_table(result: PopulationResult) -> list[dict[str, Any]]:
    """5, 50 and 95 % of a new device, per set and quantity, with the same under the other priors.

    Each row has set, n_devices, quantity, unit, q05, q50, q95; ``width`` (q95/q05, for gamma q95 - q05 in s/mm); q05
    and q95 under each other prior; ``dep_mm_s`` in words beside gamma.
    """
    rows = []
    for name in (*result.set_names, ANY_SET):
        main = new_device(result, name)
        others = {label: new_device(result, name, label) for label in result.other_priors}
        for q in main.draws:
            q05, q50, q95 = main.band(q)
            n = devices_behind(result, name, q)
            row: dict[str, Any] = {"set": name, "n_devices": n, "quantity": q, "unit": UNITS[q]}
            row |= {"q05": q05, "q50": q50, "q95": q95, "width": q95 - q05 if q == "gamma" else q95 / q05}
            for label, other in others.items():
                low, _, high = other.band(q)
                row |= {f"q05_{label}": low, f"q95_{label}": high}
            row["dep_mm_s"] = dep_words(q05, q95) if q == "gamma" else ""
            rows.append(row)
    return rows


def how_wide(result: PopulationResult, set_name: str) -> str:
    """One plain sentence on how wide the band of Fy of a new device is, and how much of that is the prior."""
    main = new_device(result, set_name)
    q05, q50, q95 = main.band("Fy")
    others = {label: new_device(result, set_name, label).band("Fy") for label in result.other_priors}
    n = devices_behind(result, set_name, "Fy")
    few = {
        0: f"No device of {main.set_name} gives Fy",
        1: f"One device of {main.set_name} was tested, which says nothing about its spread",
    }
    head = few.get(n, f"{n} devices of {main.set_name} were tested")
    head = "A set never tested, like the tested ones" if set_name == ANY_SET else head
    tail = "; ".join(
        f"{low:.3g} to {high:.3g} {ASSUMED.get(k, f'under the {k} prior')}" for k, (low, _, high) in others.items()
    )
    warning = " Two devices are not a band: the width is mostly what other sets and assumptions say." if n == 2 else ""
    band = f"Fy of a new one is {q50:.3g} kN, 90 % band {q05:.3g} to {q95:.3g} kN"
    return f"{head}: {band} (a factor of {q95 / q05:.2f} wide; {tail}).{warning}"


N_DRAWS, N_POINTS = 500, 121
"""Devices drawn at most; displacements at which a band is given."""
_SAMPLES_PER_CYCLE = 400
_PUSH, _PULL = 2, 3  # half-cycles of a two-cycle sine that make up its steady loop


@dataclass(frozen=True)
class LoopBand:
    """5, 50 and 95 % of the force over a steady cycle, point by point.

    The band holds 90 % of devices at every displacement taken by itself, not whole loops.
    """

    set_name: str  # set of the new device
    run: int  # 1, 2: first run, or second with the sliding force lowered by the ratio
    amplitude_mm: float
    peak_speed_mm_s: float
    displacement_mm: FloatArray = field(repr=False)  # shape (n,): from -amplitude to +amplitude
    # push, pull: shape (3, n): force, kN, at 5, 50 and 95 %; push while displacement grows, pull while it falls
    push: FloatArray = field(repr=False)
    pull: FloatArray = field(repr=False)
    energy_kN_mm: tuple[float, float, float]  # energy of one cycle at 5, 50 and 95 %, kN mm (equal to joule)
    n_devices: int  # tested devices of the set
    law: str = "tested"  # of what was not tested


def loop_band(device: NewDevice, *, amplitude_mm: float, peak_speed_mm_s: float = 10.0, run: int = 1) -> LoopBand:
    """Band of the force of a new device by the published law over the second cycle of a sine, in run 1 or 2.

    Beta is kept inside what the law allows. Keep the amplitude inside what was tested; a peak speed of 10 mm/s is what
    the paper tested, beyond it the law extrapolates. `PopulationError` if a quantity is missing or the motion is not
    possible.
    """
    if not (np.isfinite([amplitude_mm, peak_speed_mm_s]).all() and amplitude_mm > 0 and peak_speed_mm_s > 0):
        raise PopulationError(
            f"amplitude and peak speed must be above zero; got {amplitude_mm:g} mm and {peak_speed_mm_s:g} mm/s"
        )
    if run not in (1, 2):
        raise PopulationError(f"a loop is of run 1 or 2, not {run}")
    force_name = "Fy" if run == 1 else SECOND_RUN
    missing = [q for q in ("K", force_name, "beta", "gamma") if q not in device.draws]
    if missing:
        raise PopulationError(
            f"the loop of {device.set_name!r} in run {run} needs {', '.join(missing)}, which no device gives; "
            "add devices that do" + (" (two runs each)" if run == 2 else "")
        )
    total = device.draws["K"].size
    chosen = np.linspace(0, total - 1, min(N_DRAWS, total)).astype(np.int64)
    laws = np.column_stack([device.draws[q][chosen] for q in ("K", force_name, "beta", "gamma")])
    laws[:, 2] = np.clip(laws[:, 2], *BETA_RANGE)
    frequency = peak_speed_mm_s / (2.0 * np.pi * amplitude_mm)
    _, motion = exact_motion((Block(amplitude_mm, frequency, 2),), _SAMPLES_PER_CYCLE * frequency)
    force = force_of_laws(motion, laws)
    x, start = motion.displacement_mm, motion.start
    grid = np.linspace(-amplitude_mm, amplitude_mm, N_POINTS)
    up, down = slice(start[_PUSH], start[_PUSH + 1]), slice(start[_PULL], start[_PULL + 1])
    push = np.array([np.interp(grid, x[up], f[up]) for f in force])
    pull = np.array([np.interp(grid, x[down][::-1], f[down][::-1]) for f in force])
    energy = work_between(force, x, start[[_PUSH, _PULL + 1]])[:, 0]
    bands = (np.quantile(push, LEVELS, axis=0), np.quantile(pull, LEVELS, axis=0), band_of(energy))
    head = (device.set_name, run, amplitude_mm, peak_speed_mm_s, grid)
    return LoopBand(*head, *bands, device.n_devices)
