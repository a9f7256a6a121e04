"""The withheld answers of the real recordings, and how a diagnosis is held against each.

What is known stands in the publications (see the README of the recordings' folder); columns of the band actuator and of
the pressure are read only after the diagnosis is done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from shj_bayes.model.parameters import FloatArray

PISTON_MM2 = 490.874  # of the seal rig: pi/4 (25 mm)^2
EMPS = {"mass": 95.1, "coulomb_N": 20.4, "viscous": 203.5, "offset_N": -3.16}  # Janot, Gautier, Brunot 2019
BACKLASH_MM = (2.8, 3.3)
MOVED_IN = 0.002  # of the band actuator: more than its resolution


@dataclass(frozen=True)
class Judged:
    """One comparison.

    Parameters
    ----------
    agrees : bool
        Whether diagnosis and answer agree.
    words : str
        Both, with numbers and units.
    """

    agrees: bool
    words: str


Answer = dict[str, Any]
Judge = Callable[[Answer, Path, Mapping[str, Answer]], list[Judged]]


@dataclass(frozen=True)
class Case:
    """One recording with something withheld.

    Parameters
    ----------
    id : str
        Name.
    file : str
        Path below the folder of recordings.
    withheld : str
        What the diagnosis does not see, in words.
    judge : callable
        ``judge(diagnosis, file, all diagnoses)`` gives the comparisons.
    columns, units : str or None
        As for `shj_bayes.recording.reader.read`.
    without : tuple of str
        Effects taken out of the catalogue.
    """

    id: str
    file: str
    withheld: str
    judge: Judge
    columns: str | None = None
    units: str | None = None
    without: tuple[str, ...] = ()


def effect(answer: Answer, name: str) -> dict[str, float] | None:
    """Give the means of an effect's parameters, or None where it was not found."""
    for one in answer["effects"]:
        if one["id"] == name:
            return {key: float(row["mean"]) for key, row in one["parameters"].items()}
    return None


def _band(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare when the clamping changed, and by how much in each direction, with the band's own columns."""
    table = pd.read_csv(file)
    time = table["Time (s)"].to_numpy()
    moved = np.abs(table["Band position 1 (in)"].to_numpy() - table["Band position 1 (in)"].iloc[0]) > MOVED_IN
    begin, end = float(time[moved].min()), float(time[moved].max())
    change = {
        side: _peaks(table[column].to_numpy(), (time > begin) & (time < end), time)
        for side, column in (("push", "Band force 2 (lb)"), ("pull", "Band force 1 (lb)"))
    }
    size = f"push {change['push']:+.0%}, pull {change['pull']:+.0%}"
    truth = f"the band was moved from {begin:.1f} to {end:.1f} s (band force {size})"
    found = effect(answer, "tension_step")
    if found is None:
        return [Judged(False, f"{truth}; no change of clamping was named")]
    test = float(time[-1])
    low, high = found["begin"] * test, min((found["begin"] + found["length"]) * test, test)
    shared = max(0.0, min(end, high) - max(begin, low)) / (max(end, high) - min(begin, low))
    out = [Judged(shared >= 0.5, f"{truth}; diagnosed from {low:.1f} to {high:.1f} s ({shared:.0%} shared)")]
    for side, q in (("push", 1.0), ("pull", -1.0)):
        own = found["size"] * (1 + found["side"] * q)
        near = abs(own - change[side]) <= max(0.1, 0.5 * abs(change[side]))
        out.append(Judged(near, f"{side}: band force {change[side]:+.0%}, diagnosed clamping {own:+.0%}"))
    return out


def _peaks(force: FloatArray, inside: Any, time: FloatArray) -> float:
    """Relative change of the band force while it pulls, inside a window against outside it."""
    pulling = force > 0.6 * np.percentile(force, 99)
    early = time > 0.1 * time[-1]
    return float(np.median(force[pulling & inside]) / np.median(force[pulling & ~inside & early]) - 1.0)


def _pressure(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare the constant in the force with pressure times area."""
    table = pd.read_csv(file, sep="\t", header=None)
    newton = float(np.median(table[5])) * 0.1 * PISTON_MM2
    found = effect(answer, "load_offset")
    if found is None:
        return [Judged(False, f"the pressure pushes with {newton:.1f} N; no constant force was named")]
    own = 1000 * found["size"] * answer["shift"]["Fy"]["after"]["mean"]
    near = abs(own - newton) <= max(0.1 * newton, 1.0)
    return [Judged(near, f"the pressure pushes with {newton:.1f} N; diagnosed constant {own:.1f} N")]


def _emps(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare mass, Coulomb and viscous friction and offset with the published identification."""
    shift, mass, offset = answer["shift"], effect(answer, "inertia"), effect(answer, "load_offset")
    capacity = 1000 * shift["Fy"]["after"]["mean"]
    viscous = 1000 * capacity * shift["gamma"]["after"]["mean"]
    out = [
        Judged(
            abs(capacity / EMPS["coulomb_N"] - 1) < 0.1, f"Coulomb {EMPS['coulomb_N']} N; diagnosed {capacity:.1f} N"
        ),
        Judged(
            abs(viscous / EMPS["viscous"] - 1) < 0.15, f"viscous {EMPS['viscous']} N s/m; diagnosed {viscous:.0f} N s/m"
        ),
    ]
    if mass is None:
        out.append(Judged(False, f"mass {EMPS['mass']} kg; no mass was named"))
    else:
        out.append(
            Judged(
                abs(mass["size"] / EMPS["mass"] - 1) < 0.1, f"mass {EMPS['mass']} kg; diagnosed {mass['size']:.1f} kg"
            )
        )
    own = 1000 * offset["size"] * shift["Fy"]["after"]["mean"] if offset else 0.0
    out.append(Judged(abs(own - EMPS["offset_N"]) < 1.0, f"offset {EMPS['offset_N']} N; diagnosed {own:.2f} N"))
    return out


def _backlash(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare the free travel with the published backlash."""
    low, high = BACKLASH_MM
    found = effect(answer, "slack")
    own = f"diagnosed {found['size']:.2f} mm" if found else "no free travel was named"
    return [Judged(found is not None and low <= found["size"] <= high, f"backlash {low} to {high} mm; {own}")]


def _hidden(pair: str) -> Judge:
    """Compare a diagnosis without slack in the catalogue: unknown, at the reversals, worse on held-out cycles."""

    def judge(answer: Answer, file: Path, answers: Mapping[str, Answer]) -> list[Judged]:
        unknown = answer["verdict"] == "unknown"
        places = [where["coordinate"] for where in answer["location"]]
        out = [
            Judged(unknown, f"without slack in the catalogue the answer is {answer['verdict']}"),
            Judged("slip since reversal" in places, f"located over {', '.join(dict.fromkeys(places)) or 'nothing'}"),
        ]
        full = answers.get(pair)
        if full and "error" not in full:
            before, after = answer["after"]["heldout_rmse_kN"], full["after"]["heldout_rmse_kN"]
            words = f"held-out error {before:.3g} kN without slack in the catalogue, {after:.3g} kN with it"
            out.append(Judged(after < before, words))
        return out

    return judge


def _seal(name: str) -> Case:
    """Make the case of one seal: its pressure is withheld."""
    return Case(
        f"seal {name}", f"seals-tud/{name}.txt.gz", "pressure", _pressure, "time=1,displacement=5,force=7", "ms,mm,N"
    )


BRFD = "brfd-lehigh/ds1_0.5Hz80lb.csv.gz"
CASES = (
    Case("brfd step", "brfd-lehigh/ds4_step0.03ea1forward.csv.gz", "band position and band force", _band),
    Case("brfd harmonic", "brfd-lehigh/ds4_harmonic0.03ea1forward.csv.gz", "band position and band force", _band),
    Case("brfd slack", BRFD, "the published backlash", _backlash),
    Case("brfd slack hidden", BRFD, "slack, taken out of the catalogue", _hidden("brfd slack"), without=("slack",)),
    *(_seal(name) for name in ("KDN_1bar", "KDN_7bar", "PK_1bar")),
    Case(
        "emps",
        "emps/DATA_EMPS.mat",
        "published mass, friction and offset",
        _emps,
        "time=t,displacement=qm,force=gtau*vir",
        "s,m,N",
    ),
)
