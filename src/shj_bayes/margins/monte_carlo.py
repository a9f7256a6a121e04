"""New devices drawn from the population, as materials of OpenSees for Monte Carlo analysis.

Stiffness and plateau forces of a device are drawn together, as the tested devices tie them; with few devices of its own
a set takes the prior of the spread under which new devices differ most. Steel02 carries the loop at the tested speed.
A friction model of a bearing element (VelDependent) carries the speed law as well: from the force at rest to that at
the tested speed as the device's own gamma has it, then on to an end, because no law is known beyond the test:
mu = muFast - (muFast - muSlow) exp(-r |v|) with r = 1/v, which gives 1.58 of the tested change at high speed.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
import pandas as pd

from shj_bayes.errors import PopulationError
from shj_bayes.margins.bounds import newcomers, own_devices, priors_that_count
from shj_bayes.margins.export import NOTES, exponent_of_steel02, filled, plain
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.predict import new_device
from shj_bayes.population.results import safe_cell

MOST = 10_000
"""Devices that may be drawn of a set."""
MIDDLE_SPEED = math.pi / 6.0 + math.sqrt(3.0) / 4.0
"""Mean speed over the middle half of the stroke of a sine, as a share of its peak: the plateau force is read there."""
CHANGE = (0.5, 2.0)
"""Force at the tested speed over that at rest is held inside this range: a gamma that no data limit may reach zero."""
HEADS = ("set", "device", "K_kN_mm", "force_kN", "force_2_kN", "R_steel02", "share_at_rest", "rate_s_mm")


@dataclass(frozen=True)
class Drawn:
    """A new device of a set."""

    set_name: str
    number: int  # from 1
    K_kN_mm: float  # stiffness
    # force_kN, force_2_kN: mean plateau force of the first and of the second run at the tested speed; the second is the
    # first where no second run was tested
    force_kN: float
    force_2_kN: float
    sharpness: float  # R of Steel02
    share_at_rest: float  # force at rest over that at the tested speed


def draw_devices(
    design: PopulationResult, parameters: PopulationResult, n: int, speed_mm_s: float
) -> tuple[Drawn, ...]:
    """Draw `n` new devices of every tested set; `PopulationError` if so many cannot be drawn.

    `design` are the pooled design quantities, `parameters` the pooled parameters of the law: sharpness, and gamma where
    the fits have it. The speed is the peak speed of the tests.
    """
    available = next(iter(design.posteriors.values())).mu.shape[0]
    if not 1 <= n <= min(MOST, available):
        raise PopulationError(f"{n} devices were asked for; allowed are 1 to {min(MOST, available)} of each set")
    out = []
    for name in design.set_names:
        by_prior = newcomers(design, name)
        own = own_devices(design, name, ("plateau", "K"))
        width = {
            p: float(np.diff(np.log(by_prior[p].band("plateau")[::2]))[0])
            for p in priors_that_count(tuple(by_prior), own)
        }
        prior = max(width, key=lambda label: width[label])
        device = by_prior[prior].draws
        law = new_device(parameters, name, prior).draws
        first, second = device["plateau"], device.get("plateau_2", device["plateau"])
        of_design = np.linspace(0, first.size - 1, n).astype(np.int64)
        of_law = np.linspace(0, law["beta"].size - 1, n).astype(np.int64)
        sharpness = np.array([exponent_of_steel02(beta) for beta in np.clip(law["beta"][of_law], *BETA_RANGE).tolist()])
        gamma = law["gamma"][of_law] if "gamma" in law else np.zeros(n)
        at_rest = 1.0 / np.clip(1.0 + gamma * MIDDLE_SPEED * speed_mm_s, *CHANGE)
        columns = (device["K"][of_design], first[of_design], second[of_design], sharpness, at_rest)
        out += [Drawn(name, i + 1, *(float(c[i]) for c in columns)) for i in range(n)]
    return tuple(out)


def draws_csv(drawn: Sequence[Drawn], speed_mm_s: float) -> str:
    """Drawn devices as CSV: one line a device, columns as in ``HEADS``."""
    rate = 1.0 / (MIDDLE_SPEED * speed_mm_s)
    rows = [(safe_cell(d.set_name), *astuple(d)[1:], rate) for d in drawn]
    return pd.DataFrame(rows, columns=list(HEADS)).to_csv(index=False, lineterminator="\n", float_format="%.6g")


def draws_script(
    drawn: Sequence[Drawn], amplitude_mm: float, speed_mm_s: float, source: str, left_out: Sequence[str] = ()
) -> str:
    """Script for OpenSeesPy: a table of devices, functions that define one, and a check that runs a cycle of each.

    `speed_mm_s` is the peak speed of the tests, `source` says where the devices come from, and `left_out` what they do
    not carry besides, one sentence each.
    """
    rows = "\n".join(
        f"    ({json.dumps(d.set_name)}, {d.number}): ({d.force_kN:.6g}, {d.force_2_kN:.6g}, {d.K_kN_mm:.6g}, "
        f"{d.sharpness:.6g}, {d.share_at_rest:.6g}),"
        for d in drawn
    )
    rate = f"{1.0 / (MIDDLE_SPEED * speed_mm_s):.6g}"
    notes = (NOTES[0], *NOTES[2:4], *map(plain, left_out))
    return filled("connection_draws", rows, notes, amplitude_mm, source, rate=rate)
