"""What the codes multiply: nominal force, the force that new devices deliver, ageing; for one set."""

from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.margins.bounds import NONE, Bounds, Delivered, Newcomers, delivered, own_devices
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.quantities import HIGHEST, LEVELS, LOWEST, THIRD_CYCLE, FloatArray


@dataclass(frozen=True)
class Environment:
    """What corrosion did to the sliding force."""

    measured: Bounds  # factor on the force, middle of the posterior; 1 and 1 where it was not tested
    extreme: Bounds  # 5 and 95 % of the posterior
    words: str  # where it comes from


def environment(result: PopulationResult, set_name: str) -> Environment:
    """Corroded over uncorroded sliding force of the same shim and coating, from its posterior."""
    untested = "no corroded partner of this set was tested: 1 says that nothing is known, not that nothing happens"
    fit = result.fit(THIRD_CYCLE)
    if set_name == ANY_SET:
        shifts = [fit.mu[:, j] - fit.mu[:, i] for i, j in corroded_pairs(result)]
        if not shifts:
            return Environment(NONE, NONE, untested)
        shift = np.mean(shifts, axis=0)
        return _environment(shift, f"mean of {len(shifts)} corroded sets over their uncorroded partners")
    index = result.index(set_name)
    if result.sets[index].tags.corroded:
        return Environment(NONE, NONE, "this set was tested corroded: its own numbers hold the ageing")
    partner = [j for i, j in corroded_pairs(result) if i == index]
    if not partner:
        return Environment(NONE, NONE, untested)
    return _environment(fit.mu[:, partner[0]] - fit.mu[:, index], f"{result.sets[partner[0]].name} over {set_name}")


def _environment(shift: FloatArray, origin: str) -> Environment:
    low, middle, high = (float(x) for x in np.exp(np.quantile(shift, LEVELS)))
    said = f"{origin}: {middle:.2f} (90 % interval {low:.2f} to {high:.2f})"
    return Environment(Bounds.around(middle), Bounds.around(low, high), said)


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
class DesignBasis:
    """What the factors of one set are made of."""

    # nominal sliding force: that of the third cycle of the first run of a typical device, or as stated by the user
    nominal_kN: float
    nominal_words: str  # which of the two
    force: Delivered  # what new devices deliver
    age: Environment  # corrosion


def parts_of(result: PopulationResult, set_name: str, devices: Newcomers, nominal_kN: float | None) -> DesignBasis:
    """Split what is known of a set into the parts that the codes multiply."""
    force = delivered(devices, own_devices(result, set_name, (LOWEST, HIGHEST, THIRD_CYCLE)))
    nominal = (force.third, "typical device") if nominal_kN is None else (nominal_kN, "stated by the user")
    return DesignBasis(*nominal, force, environment(result, set_name))
