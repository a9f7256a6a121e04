"""What the codes multiply: nominal force, device to device, within the tests, ageing; split for one set."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.margins import asce7
from shj_bayes.margins.asce7 import Bounds
from shj_bayes.margins.sample import Motion
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import SECOND_RUN, NewDevice, new_device
from shj_bayes.population.quantities import FloatArray


@dataclass(frozen=True)
class Environment:
    """What corrosion did to the sliding force.

    Parameters
    ----------
    bounds : Bounds
        Factor on the force; 1 and 1 where it was not tested.
    words : str
        Where it comes from.
    """

    bounds: Bounds
    words: str


def environment(result: PopulationResult, set_name: str) -> Environment:
    """Corroded over uncorroded sliding force of the same shim and coating, the middle of its posterior."""
    untested = "no corroded partner of this set was tested: 1 says that nothing is known, not that nothing happens"
    fit = result.fit("Fy")
    if set_name == ANY_SET:
        shifts = [fit.mu[:, j] - fit.mu[:, i] for i, j in corroded_pairs(result)]
        if not shifts:
            return Environment(asce7.NONE, untested)
        shift = np.mean(shifts, axis=0)
        return _environment(shift, f"mean of {len(shifts)} corroded sets over their uncorroded partners")
    index = result.index(set_name)
    if result.sets[index].tags.corroded:
        return Environment(asce7.NONE, "this set was tested corroded: its own numbers hold the ageing")
    partner = [j for i, j in corroded_pairs(result) if i == index]
    if not partner:
        return Environment(asce7.NONE, untested)
    return _environment(fit.mu[:, partner[0]] - fit.mu[:, index], f"{result.sets[partner[0]].name} over {set_name}")


def _environment(shift: FloatArray, words: str) -> Environment:
    low, middle, high = (float(x) for x in np.exp(np.quantile(shift, (0.05, 0.5, 0.95))))
    return Environment(Bounds.around(middle), f"{words}: {middle:.2f} (90 % interval {low:.2f} to {high:.2f})")


def corroded_pairs(result: PopulationResult) -> list[tuple[int, int]]:
    """Positions of (uncorroded, corroded) sets that are alike in all else."""
    sets = list(enumerate(result.sets))
    return [
        (i, j)
        for i, a in sets
        for j, b in sets
        if b.tags.corroded and not a.tags.corroded and replace(a.tags, corroded=True) == b.tags
    ]


@dataclass(frozen=True)
class Parts:
    """Parts of the property modification factors of one set.

    Parameters
    ----------
    nominal_kN : float
        Typical sliding force of the first run, at rest.
    specification, testing, travel : Bounds
        Device to device; within the tests (run and speed); run to run alone.
    age : Environment
        Corrosion.
    low_kN, high_kN : float
        5 and 95 % of a new device, first run.
    second_kN : float or None
        5 % of a new device, second run.
    inputs : str
        In words.
    """

    nominal_kN: float
    specification: Bounds
    testing: Bounds
    travel: Bounds
    age: Environment
    low_kN: float
    high_kN: float
    second_kN: float | None
    inputs: str


def parts_of(result: PopulationResult, set_name: str, motion: Motion | None, nominal_kN: float | None) -> Parts:
    """Split what is known of a set into the parts that the codes multiply."""
    device = new_device(result, set_name)
    low, middle, high = device.band("Fy")
    nominal = middle if nominal_kN is None else nominal_kN
    ratio = device.band("ratio")[1] if "ratio" in device.draws else 1.0
    speeds, words = _speed_factors(device, motion)
    run, rate = Bounds.around(ratio), Bounds.around(*speeds)
    testing = Bounds(run.low * rate.low, run.high * rate.high)
    return Parts(
        nominal,
        Bounds.around(low / middle, high / middle),
        testing,
        run,
        environment(result, set_name),
        low,
        high,
        device.band(SECOND_RUN)[0] if SECOND_RUN in device.draws else None,
        f"second run / first {ratio:.3f}" + ("" if "ratio" in device.draws else " (no second run)") + f"; {words}",
    )


def _speed_factors(device: NewDevice, motion: Motion | None) -> tuple[tuple[float, ...], str]:
    if motion is None or "gamma" not in device.draws:
        return (1.0,), "speed not known"
    gamma = np.array([device.band("gamma")[1]])
    v = motion.guard.speed_mm_s
    factors = tuple(float(1.0 + g[0] * v) for g in motion.guard.gammas(gamma).values())
    return factors, f"speed 0 to {v:.3g} mm/s: factor 1 to {' or '.join(f'{f:.3f}' for f in factors)}"
