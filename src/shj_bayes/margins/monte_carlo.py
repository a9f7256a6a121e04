"""New devices drawn from the population, as materials of OpenSees for Monte Carlo analysis.

Stiffness and plateau forces of a device are drawn together, as the tested devices tie them; with few devices of its own
a set takes the prior of the spread under which new devices differ most. Steel02 carries the loop at the tested speed.
A friction model of a bearing element (VelDependent) carries the speed law as well: from the force at rest to that at
the tested speed as the device's own gamma has it, then on to an end, because no law is known beyond the test:
mu = muFast - (muFast - muSlow) exp(-r |v|) with r = 1/v, which gives 1.58 of the tested change at high speed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from shj_bayes.errors import PopulationError
from shj_bayes.margins.opensees import HARDENING, NOTES, exponent_of_steel02, plain
from shj_bayes.margins.outermost import newcomers, own_devices, priors_that_count
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.population.posterior import PopulationResult
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
    """A new device of a set.

    Parameters
    ----------
    set_name : str
        Its set.
    number : int
        From 1.
    K_kN_mm : float
        Stiffness.
    force_kN, force_2_kN : float
        Mean plateau force of the first and of the second run at the tested speed; the second is the first where no
        second run was tested.
    beta : float
        Sharpness of the knee of Eq. (1).
    share_at_rest : float
        Force at rest over that at the tested speed.
    """

    set_name: str
    number: int
    K_kN_mm: float
    force_kN: float
    force_2_kN: float
    beta: float
    share_at_rest: float


def draw_devices(
    design: PopulationResult, parameters: PopulationResult, n: int, speed_mm_s: float
) -> tuple[Drawn, ...]:
    """Draw new devices of every tested set.

    Parameters
    ----------
    design : PopulationResult
        Design quantities of the devices, pooled.
    parameters : PopulationResult
        Parameters of the law, pooled: sharpness, and gamma where the fits have it.
    n : int
        Devices of each set.
    speed_mm_s : float
        Peak speed of the tests.

    Raises
    ------
    PopulationError
        If so many devices cannot be drawn.
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
        beta = np.clip(law["beta"][of_law], *BETA_RANGE)
        gamma = law["gamma"][of_law] if "gamma" in law else np.zeros(n)
        at_rest = 1.0 / np.clip(1.0 + gamma * MIDDLE_SPEED * speed_mm_s, *CHANGE)
        columns = (device["K"][of_design], first[of_design], second[of_design], beta, at_rest)
        out += [Drawn(name, i + 1, *(float(c[i]) for c in columns)) for i in range(n)]
    return tuple(out)


def draws_csv(drawn: Sequence[Drawn], speed_mm_s: float) -> str:
    """Drawn devices as CSV: one line a device, columns as in ``HEADS``."""
    rate = 1.0 / (MIDDLE_SPEED * speed_mm_s)
    rows = [
        (
            safe_cell(d.set_name),
            d.number,
            d.K_kN_mm,
            d.force_kN,
            d.force_2_kN,
            exponent_of_steel02(d.beta),
            d.share_at_rest,
            rate,
        )
        for d in drawn
    ]
    return pd.DataFrame(rows, columns=list(HEADS)).to_csv(index=False, lineterminator="\n", float_format="%.6g")


def draws_script(
    drawn: Sequence[Drawn], amplitude_mm: float, speed_mm_s: float, source: str, left_out: Sequence[str] = ()
) -> str:
    """Script for OpenSeesPy: a table of devices, functions that define one, and a check that runs each.

    Parameters
    ----------
    drawn : sequence of Drawn
        The devices.
    amplitude_mm : float
        Of the cycle that the check runs.
    speed_mm_s : float
        Peak speed of the tests.
    source : str
        Where they come from.
    left_out : sequence of str
        What these devices do not carry besides, one sentence each.
    """
    rows = "\n".join(
        f"    ({json.dumps(d.set_name)}, {d.number}): ({d.force_kN:.6g}, {d.force_2_kN:.6g}, {d.K_kN_mm:.6g}, "
        f"{exponent_of_steel02(d.beta):.6g}, {d.share_at_rest:.6g}),"
        for d in drawn
    )
    notes = "\n".join(f"# - {note}" for note in (NOTES[0], *NOTES[2:4], *map(plain, left_out)))
    return f'''# New sliding friction connections for Monte Carlo, written by shj-bayes. Source: {plain(source)}.
{notes}
# - Each line is one device that might be delivered next: how devices differ and how little is known of that together.
# - run=2 gives the force in a second earthquake, where a second run was tested.
import math

# (set, device): (plateau force of run 1, of run 2, kN; stiffness kN/mm; R of Steel02; force at rest over plateau force)
DEVICES = {{
{rows}
}}
HARDENING = {HARDENING!r}
RATE = {1.0 / (MIDDLE_SPEED * speed_mm_s):.6g}  # s/mm, of the friction model


def define(ops, tag, set_name, device, run=1):
    """Define uniaxial material `tag`: the loop at the tested speed."""
    values = DEVICES[set_name, device]
    ops.uniaxialMaterial("Steel02", tag, values[run - 1], values[2], HARDENING, values[3], 0.0, 0.15)


def define_friction(ops, tag, set_name, device, run=1):
    """Define friction model `tag`, with the speed law, for a bearing element under a normal force of 1 kN.

    The element takes the stiffness DEVICES[set_name, device][2] as its initial stiffness.
    """
    values = DEVICES[set_name, device]
    force, at_rest = values[run - 1], values[run - 1] * values[4]
    ops.frictionModel("VelDependent", tag, at_rest, at_rest + (force - at_rest) / (1 - math.exp(-1)), RATE)


def loop(ops, set_name, device, displacement, run=1):
    """Force (kN) of one material driven through the displacements (mm)."""
    ops.wipe()
    define(ops, 1, set_name, device, run)
    ops.testUniaxialMaterial(1)
    force = []
    for value in displacement:
        ops.setStrain(float(value))
        force.append(ops.getStress())
    return force


def main():
    import openseespy.opensees as ops

    amplitude, steps = {amplitude_mm!r}, 800
    displacement = [amplitude * math.sin(2 * math.pi * i / steps) for i in range(2 * steps + 1)]
    print("set, device, largest force kN")
    for set_name, device in DEVICES:
        print(f"{{set_name}}, {{device}}, {{max(loop(ops, set_name, device, displacement)):.4g}}")


if __name__ == "__main__":
    main()
'''
