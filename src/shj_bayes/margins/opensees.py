"""Bounds as materials for OpenSees, in Python and in Tcl, with a note of what a material cannot carry.

Steel02 without hardening is a Menegotto-Pinto curve from reversal to reversal, as Eq. (1) is one from zero: with the
exponent R below both have the same force at the knee. Against Eq. (1) without its speed term the loop differs by less
than 7.5 % of the sliding force at any point (the jump of Eq. (1) at reversals is 6.7 % of it for beta = 10), by less
than 2 % in the root mean square and by less than 0.5 % in energy, for beta of 10 and more;
tests/oracle/test_margins_opensees.py measures it with OpenSees itself.
"""

import json
import math
import re
from collections.abc import Sequence
from pathlib import Path
from string import Template

from shj_bayes.margins.bounds import Bound

HARDENING = 1e-5
"""Post-sliding stiffness over initial stiffness: next to nothing, but not 0, so that a model keeps a tangent."""
SHARPEST = 60.0
"""Largest exponent handed to Steel02, whose powers overflow beyond; the knee is then within 2 % of the force."""
NOTES = (
    "Units: kN and mm. Force of ONE connection as tested, along its sliding direction.",
    "Not carried: the speed law. A Steel02 material does not know speed; the forces are those at "
    "the speeds of the test. Nothing is known beyond it.",
    "Not carried: the loss of force from run to run and with travel within an analysis. The lower bound is the "
    "smallest force of all runs of the test; it serves for a second earthquake.",
    "Not carried: the jump of Eq. (1) at reversals, slack, stick-slip, and bearing of the bolt at the end of the slot. "
    "Stop the analysis where the slot ends, or add a gap material there.",
    "Run the lower and the upper bound at least: the lower governs displacement, the upper governs forces.",
)


def exponent_of_steel02(beta: float) -> float:
    """R for which Steel02, from -F to F, passes the knee at the height of Eq. (1): F 2^(-1/beta).

    From the reversal at -F the curve has risen 2 F 2^(-1/R) where its asymptotes meet, at e = F.
    """
    knee = 0.5 * (1.0 + 2.0 ** (-1.0 / beta))
    return min(-math.log(2.0) / math.log(knee), SHARPEST)


def plain(name: str) -> str:
    """Name of a set that may stand in a script of any language: letters, digits and a few signs."""
    return re.sub(r"[^A-Za-z0-9 .,_%()+-]", "_", name).strip() or "set"


def python_script(bounds: Sequence[Bound], amplitude_mm: float, source: str, left_out: Sequence[str] = ()) -> str:
    """Script for OpenSeesPy: a table of materials, a function that defines one, a check that runs each.

    `left_out` says what these materials do not carry besides, one sentence each.
    """
    rows = "\n".join(
        f"    ({json.dumps(b.set_name)}, {json.dumps(b.bound)}): "
        f"({b.force_kN:.6g}, {b.K_kN_mm:.6g}, {exponent_of_steel02(b.beta):.6g}),"
        for b in bounds
    )
    return filled("connection_materials", rows, (*NOTES, *map(plain, left_out)), amplitude_mm, source)


def filled(name: str, rows: str, notes: Sequence[str], amplitude_mm: float, source: str, **more: str) -> str:
    """Fill one of the ``scripts``."""
    text = (Path(__file__).parent / "scripts" / f"{name}.py.txt").read_text(encoding="utf-8")
    said = "\n".join(f"# - {note}" for note in notes)
    fixed = {"source": plain(source), "hardening": repr(HARDENING), "amplitude": repr(amplitude_mm)}
    return Template(text).substitute(fixed, rows=rows, notes=said, **more)


def tcl_script(bounds: Sequence[Bound], source: str, left_out: Sequence[str] = ()) -> str:
    """Script for OpenSees (Tcl): the same materials by number of set and bound."""
    names = list(dict.fromkeys(b.set_name for b in bounds))
    lines = [f"# Sliding friction connections as OpenSees materials, written by shj-bayes. Source: {plain(source)}."]
    lines += [f"# - {note}" for note in (*NOTES, *map(plain, left_out))]
    lines += ["# Sets:", *(f"#   {i}: {plain(name)}" for i, name in enumerate(names, start=1))]
    lines.append("# frictionMaterial(<number of set>,<bound>): sliding force kN, stiffness kN/mm, R of Steel02")
    for b in bounds:
        key = f"{names.index(b.set_name) + 1},{b.bound}"
        numbers = f"{b.force_kN:.6g} {b.K_kN_mm:.6g} {exponent_of_steel02(b.beta):.6g}"
        lines.append(f"set frictionMaterial({key}) {{{numbers}}}")
    lines += [
        "proc defineFriction {tag number bound} {",
        "    global frictionMaterial",
        "    lassign $frictionMaterial($number,$bound) force stiffness sharpness",
        f"    uniaxialMaterial Steel02 $tag $force $stiffness {HARDENING!r} $sharpness 0.0 0.15",
        "}",
        "# Example: defineFriction 1 1 lower",
    ]
    return "\n".join(lines) + "\n"
