"""Files for structural analysis: link elements, OpenSees materials, loops, and new devices for Monte Carlo analysis.

Stiffness and plateau forces of a drawn device are drawn together, as the tested devices tie them; with few devices of
its own a set takes the prior of the spread under which new devices differ most. Steel02 carries the loop at the tested
speed. A friction model of a bearing element (VelDependent) carries the speed law as well: from the force at rest to
that at the tested speed as the device's own gamma has it, then on to an end, because no law is known beyond the test:
mu = muFast - (muFast - muSlow) exp(-r |v|) with r = 1/v, which gives 1.58 of the tested change at high speed.
"""

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template
from types import MappingProxyType

import numpy as np
from scipy import optimize
from scipy.special import hyp2f1

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import write_text
from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import (
    DEFAULT,
    least_favourable,
    own_devices,
    predictive_devices,
    priors_that_count,
    sliding_force_bounds,
    tested_devices,
)
from shj_bayes.margins.spread import HIGH, LOW, MIDDLE
from shj_bayes.margins.virtual_test import VirtualTestResult
from shj_bayes.model.law import BETA_RANGE, work_between
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.predict import N_POINTS, LoopBand, new_device, sets_suffice
from shj_bayes.population.quantities import LEVELS, band_of
from shj_bayes.results.campaign import Connection
from shj_bayes.results.tables import Cells

LOWER, UPPER = "lower", "upper"
PROGRAMS = ("opensees", "sap2000", "etabs")


@dataclass(frozen=True)
class Bound:
    """One rate-free definition of a connection."""

    set_name: str  # the set, or "(any set)"
    # "lower", "middle", "upper": which of the three analyses it is for; "fresh lower", "worn lower" and so on of the
    # first run and of those after it alone
    bound: str
    # K_kN_mm to beta: stiffness, sliding force, sharpness of the knee of Eq. (1).
    K_kN_mm: float
    force_kN: float
    beta: float
    # stiffness_kN_mm, damping: effective stiffness and damping of the amplitude stated
    stiffness_kN_mm: float
    damping: float
    n_devices: int  # tested devices
    slip_mm: float | None = None  # free, from the middle to either end of the slot; None where it is not known

    def __post_init__(self) -> None:
        """Refuse what no analysis can take."""
        numbers = (self.K_kN_mm, self.force_kN, self.beta)
        if not (np.isfinite(numbers).all() and min(numbers) > 0):
            raise PopulationError(
                f"{self.set_name}, {self.bound}: stiffness {self.K_kN_mm:g} kN/mm, force {self.force_kN:g} kN and "
                f"sharpness {self.beta:g} must be above zero; test more devices of this set, or leave it out"
            )


def bounds(
    design: PopulationResult,
    parameters: PopulationResult,
    amplitude_mm: float,
    connections: Mapping[str, Connection] = MappingProxyType({}),
) -> tuple[Bound, ...]:
    """Draw up the bounds of every set, from its pooled design quantities and parameters (for the sharpness).

    Lower: 5 % of the smallest plateau of all runs. Middle: 50 % of the mean plateau of the first run. Upper: 95 % of
    the largest force of all runs. Because the force falls with travel, lower and upper of the first run alone (fresh)
    and of those after it (worn) stand beside them. Stiffness 5, 50 and 95 %; sharpness its middle. Effective
    stiffness and damping are those of an elastic-plastic loop of the amplitude: F / A and (2/pi)(1 - F / (K A)).
    """
    out = []
    # No material of a set never tested where its band would be all assumption: an analysis would take it for a result.
    untested = (ANY_SET,) if sets_suffice(len(design.sets)) else ()
    for name in (*design.set_names, *untested):
        devices = predictive_devices(design, name)
        own = own_devices(design, name, ("K",))
        force = sliding_force_bounds(devices, tested_devices(design, name))
        middle = float(np.median(devices[DEFAULT].draws["plateau"]))
        bands = {label: device.band("K") for label, device in devices.items()}
        fit = parameters.fit("beta")
        level = fit.hyper[:, 0] if name == ANY_SET else fit.mu[:, parameters.index(name)]
        beta = float(np.clip(np.exp(np.median(level)), *BETA_RANGE))
        slip = connections.get(name, Connection()).travel_mm
        for bound, side, value in (
            (LOWER, LOW, force.low),
            (MIDDLE, MIDDLE, middle),
            (UPPER, HIGH, force.high),
            (f"fresh {LOWER}", LOW, force.first_low),
            (f"fresh {UPPER}", HIGH, force.first_high),
            (f"worn {LOWER}", LOW, force.later_low),
            (f"worn {UPPER}", HIGH, force.later_high),
        ):
            if value is None:
                continue
            place = [LOW, MIDDLE, HIGH].index(side)
            stiffness = least_favourable({label: band[place] for label, band in bands.items()}, side, own)
            damping = (2.0 / math.pi) * (1.0 - min(value / (stiffness * amplitude_mm), 1.0))
            n = devices[DEFAULT].n_devices
            out.append(Bound(name, bound, stiffness, value, beta, value / amplitude_mm, damping, n, slip))
    return tuple(out)


LARGEST_EXPONENT = 20.0
"""Programs with a Wen link refuse, or stumble over, sharper knees than this."""
HELP = {
    "set": "set of devices; (any set) is one never tested",
    "bound": "lower, middle or upper: run the lower and the upper analysis at least; fresh: the first run alone, worn: "
    "the runs after it, between which the force falls with travel",
    "devices": "tested devices behind the numbers",
    "stiffness_kN_per_mm": "initial (elastic) stiffness of the link along its sliding direction",
    "stiffness_kN_per_m": "the same, where the program wants metres",
    "yield_force_kN": "sliding force; called yield force or yield strength in plastic (Wen) links",
    "post_yield_ratio": "post-yield stiffness over initial stiffness: next to 0, friction does not harden",
    "wen_exponent": "yielding exponent of a plastic (Wen) link; bilinear links do without",
    "effective_stiffness_kN_per_mm": "secant stiffness of the stated cycle, for linear analysis cases",
    "effective_damping": "equivalent viscous damping ratio of the stated cycle, for linear analysis cases",
    "free_slip_mm": "from the middle of the slot to either end, where a gap and a hook stop it; empty where not known",
}


def wen_exponent(beta: float) -> float:
    """Exponent of dz/du = 1 - z^n for which the monotonic curve passes the knee of Eq. (1): z(1) = 2^(-1/beta).

    u = z 2F1(1, 1/n; 1 + 1/n; z^n) is the displacement, over F/K, at which a Wen link carries z F.
    """
    knee = 2.0 ** (-1.0 / beta)

    def short_by(n: float) -> float:
        return float(knee * hyp2f1(1.0, 1.0 / n, 1.0 + 1.0 / n, knee**n)) - 1.0

    if short_by(LARGEST_EXPONENT) > 0:
        return LARGEST_EXPONENT
    if short_by(1.0) < 0:
        return 1.0
    return float(optimize.brentq(short_by, 1.0, LARGEST_EXPONENT))


def link_csv(bounds: Sequence[Bound], cycle: str, left_out: Sequence[str] = ()) -> str:
    """One line per set and bound, columns as in ``HELP``, as CSV under its help lines, which start with #."""
    head = [f"# {column}: {words}" for column, words in HELP.items()]
    head.append(f"# cycle of the effective values: {cycle}. Not carried: speed, loss of force with travel.")
    head += [f"# {plain(note)}" for note in left_out]
    rows = []
    for b in bounds:
        numbers = (b.K_kN_mm, 1000.0 * b.K_kN_mm, b.force_kN, HARDENING, b.stiffness_kN_mm)
        K, K_m, force, hardening, effective = (float(f"{x:.5g}") for x in numbers)
        knee = round(wen_exponent(b.beta), 1)
        row = (b.set_name, b.bound, b.n_devices, K, K_m, force, hardening, knee, effective, round(b.damping, 4))
        rows.append((*row, b.slip_mm))
    return "\n".join(head) + "\n" + Cells(tuple(HELP), rows).to_csv()


HARDENING = 1e-5
"""Post-sliding stiffness over initial stiffness: next to nothing, but not 0, so that a model keeps a tangent."""
SHARPEST = 60.0
"""Largest exponent handed to Steel02, whose powers overflow beyond; the knee is then within 2 % of the force."""
NOTES = (
    "Units: kN and mm. Force of ONE connection as tested, along its sliding direction.",
    "Not carried: the speed law. A Steel02 material does not know speed; the forces are those at "
    "the speeds of the test. Nothing is known beyond it.",
    "Not carried: the loss of force from run to run and with travel within an analysis. The lower bound is the "
    "smallest force of all runs of the test. The fresh bounds are of the first run alone, the worn ones of those after "
    "it: an analysis of a second earthquake lies between them.",
    "Not carried: the jump of Eq. (1) at reversals, slack, stick-slip.",
    "Bearing of the bolt at the end of the slot was not tested: stop the analysis where the slot ends, or state a "
    "stiffness of bearing, which adds a gap to either side where the free slip is known.",
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
    slips = "\n".join(f"    {json.dumps(b.set_name)}: {b.slip_mm!r}," for b in bounds if b.bound == LOWER)
    return filled("connection_materials.py", rows, (*NOTES, *map(plain, left_out)), amplitude_mm, source, slips=slips)


def links_script(bounds: Sequence[Bound], program: str, source: str, left_out: Sequence[str] = ()) -> str:
    """Script that defines plastic (Wen) links in an open model of SAP2000 or ETABS; arguments as `python_script`."""
    names = list(dict.fromkeys(b.set_name for b in bounds))  # with their number: two may be alike in plain letters
    rows = "\n".join(
        f"    {json.dumps(f'{names.index(b.set_name) + 1} {plain(b.set_name)}, {b.bound}')}: "
        f"({b.K_kN_mm:.6g}, {b.force_kN:.6g}, {wen_exponent(b.beta):.3g}, {b.stiffness_kN_mm:.6g}, {b.slip_mm!r}),"
        for b in bounds
    )
    notes = (NOTES[0], NOTES[1].replace("A Steel02 material", "A plastic link"), *NOTES[2:], *map(plain, left_out))
    return filled("connection_links.py", rows, notes, 0.0, source, program=program)


def stiffness_words(connections: Mapping[str, Connection]) -> tuple[str, ...]:
    """Say of each set whether grips and frame of the testing machine are in its stiffness."""
    said = {
        "device": "is that of the device alone, measured across the sliding surfaces",
        "machine": "has grips and frame of the testing machine in it; the device alone is stiffer",
        None: "may have grips and frame of the testing machine in it; displacement in set.connection would say",
    }
    found: dict[str | None, list[str]] = {}
    for name, one in connections.items():
        found.setdefault(one.displacement, []).append(name)
    return tuple(f"Stiffness of {', '.join(names)} {said[where]}." for where, names in found.items())


def filled(name: str, rows: str, notes: Sequence[str], amplitude_mm: float, source: str, **more: str) -> str:
    """Fill one of the ``scripts``."""
    text = (Path(__file__).parent / "scripts" / f"{name}.txt").read_text(encoding="utf-8")
    said = "\n".join(f"# - {note}" for note in notes)
    fixed = {"source": plain(source), "hardening": repr(HARDENING), "amplitude": repr(amplitude_mm)}
    return Template(text).substitute(fixed, rows=rows, notes=said, **more)


def tcl_script(bounds: Sequence[Bound], source: str, left_out: Sequence[str] = ()) -> str:
    """Script for OpenSees (Tcl): the same materials by number of set and bound."""
    number = {name: i for i, name in enumerate(dict.fromkeys(b.set_name for b in bounds), start=1)}
    slips = {number[b.set_name]: b.slip_mm for b in bounds if b.slip_mm is not None}
    rows = "\n".join(
        f"set frictionMaterial({number[b.set_name]},{b.bound.replace(' ', '_')}) "
        f"{{{b.force_kN:.6g} {b.K_kN_mm:.6g} {exponent_of_steel02(b.beta):.6g}}}"
        for b in bounds
    )
    more = {
        "names": "\n".join(f"#   {i}: {plain(name)}" for name, i in number.items()),
        "slips": "".join(f"set slip({i}) {slip:g}\n" for i, slip in slips.items()),
    }
    return filled("connection_materials.tcl", rows, (*NOTES, *map(plain, left_out)), 0.0, source, **more)


LOOPS_CSV = "loops.csv"


def loops(tests: Sequence[VirtualTestResult], peak_speed_mm_s: float) -> tuple[LoopBand, ...]:
    """Draw the loop bands of every set, run by run and law by law of what was not tested.

    Each branch of the widest cycle is cut to what all devices of the set went through; beyond its end it is NaN.
    """
    out = []
    for name in dict.fromkeys(test.set_name for test in tests):
        own = [test for test in tests if test.set_name == name]
        for law in max((tuple(test.loops) for test in own), key=len):  # a device that depends on nothing beyond has one
            of_law = [test.loops.get(law) or next(iter(test.loops.values())) for test in own]
            for run, cycles in enumerate(zip(*of_law, strict=False), start=1):
                ends = [(max(c[i][0].min() for c in cycles), min(c[i][0].max() for c in cycles)) for i in (0, 1)]
                low, high = min(ends[0][0], ends[1][0]), max(ends[0][1], ends[1][1])
                grid = np.linspace(low, high, N_POINTS)
                push, pull = (np.concatenate([_at(grid, c[i], ends[i]) for c in cycles]) for i in (0, 1))
                energy = work_between(np.nan_to_num(push - pull), grid, (0, grid.size - 1))[:, 0]
                bands = (np.quantile(push, LEVELS, axis=0), np.quantile(pull, LEVELS, axis=0), band_of(energy))
                head = (name, run, 0.5 * (high - low), peak_speed_mm_s, grid)
                out.append(LoopBand(*head, *bands, len(own), law))
    return tuple(out)


SLIGHT_MM = 1.0  # told beyond the ends of a branch: samples end short of a reversal


def _at(grid: FloatArray, branch: tuple[FloatArray, FloatArray], ends: tuple[float, float]) -> FloatArray:
    """Force of every draw at the displacements of a grid; NaN outside the ends of the branch."""
    x, force = branch
    order = np.argsort(x, kind="stable")
    at = np.stack([np.interp(grid, x[order], row[order]) for row in force])
    return np.where((grid >= ends[0] - SLIGHT_MM) & (grid <= ends[1] + SLIGHT_MM), at, np.nan)


def write_loops(bands: Sequence[LoopBand], folder: Path) -> Path | None:
    """Write ``loops.csv``: one line per set, run and displacement; takes an old one away when there are no loops.

    Columns: set, n_devices, run, amplitude_mm, peak_speed_mm_s, displacement_mm, push_q05_kN, push_q50_kN,
    push_q95_kN (while displacement grows), pull_q05_kN, pull_q50_kN, pull_q95_kN (while it falls), law (of what was not
    tested; "tested" where all was). A branch is empty beyond its ends.
    """
    path = folder / LOOPS_CSV
    if not bands:
        path.unlink(missing_ok=True)
        return None
    heads = ["set", "n_devices", "run", "amplitude_mm", "peak_speed_mm_s", "displacement_mm"]
    heads += [f"{side}_{level}_kN" for side in ("push", "pull") for level in ("q05", "q50", "q95")]
    rows = [
        (band.set_name, band.n_devices, band.run, band.amplitude_mm, band.peak_speed_mm_s, *numbers, band.law)
        for band in bands
        for numbers in np.column_stack([band.displacement_mm, *band.push.round(4), *band.pull.round(4)]).tolist()
    ]
    write_text(path, Cells((*heads, "law"), rows).to_csv())
    return path


MOST = 10_000
"""Devices that may be drawn of a set."""
MIDDLE_SPEED = math.pi / 6.0 + math.sqrt(3.0) / 4.0
"""Mean speed over the middle half of the stroke of a sine, as a share of its peak: the plateau force is read there."""
CHANGE = (0.5, 2.0)
"""Force at the tested speed over that at rest is held inside this range: a gamma that no data limit may reach zero."""
HEADS = ("set", "device", "K_kN_mm", "force_kN", "force_2_kN", "R_steel02", "share_at_rest", "rate_s_mm")


def draw_devices(
    design: PopulationResult, parameters: PopulationResult, n: int, speed_mm_s: float
) -> dict[str, FloatArray]:
    """Draw `n` new devices of every tested set, shape (n, 5); `PopulationError` if so many cannot be drawn.

    Columns: stiffness, kN/mm; mean plateau force of the first and of the second run at the tested speed, kN (the first
    again where no second run was tested); R of Steel02; force at rest over that at the tested speed.

    `design` are the pooled design quantities, `parameters` the pooled parameters of the law: sharpness, and gamma where
    the fits have it. The speed is the peak speed of the tests.
    """
    available = next(iter(design.posteriors.values())).mu.shape[0]
    if not 1 <= n <= min(MOST, available):
        raise PopulationError(f"{n} devices were asked for; allowed are 1 to {min(MOST, available)} of each set")
    out = {}
    for name in design.set_names:
        by_prior = predictive_devices(design, name)
        count = priors_that_count(tuple(by_prior), own_devices(design, name, ("plateau", "K")))
        width = {label: float(np.diff(np.log(by_prior[label].band("plateau")[::2]))[0]) for label in count}
        prior = max(width, key=lambda label: width[label])
        device = by_prior[prior].draws
        law = new_device(parameters, name, prior).draws
        first, second = device["plateau"], device.get("plateau_2", device["plateau"])
        of_design = np.linspace(0, first.size - 1, n).astype(np.int64)
        of_law = np.linspace(0, law["beta"].size - 1, n).astype(np.int64)
        sharpness = np.array([exponent_of_steel02(beta) for beta in np.clip(law["beta"][of_law], *BETA_RANGE).tolist()])
        gamma = law["gamma"][of_law] if "gamma" in law else np.zeros(n)
        at_rest = 1.0 / np.clip(1.0 + gamma * MIDDLE_SPEED * speed_mm_s, *CHANGE)
        out[name] = np.column_stack([device["K"][of_design], first[of_design], second[of_design], sharpness, at_rest])
    return out


def draws_csv(drawn: Mapping[str, FloatArray], speed_mm_s: float) -> str:
    """Drawn devices as CSV: one line a device, columns as in ``HEADS``."""
    rate = 1.0 / (MIDDLE_SPEED * speed_mm_s)
    rows = [
        (name, number, *(f"{x:.6g}" for x in (*row, rate)))
        for name, devices in drawn.items()
        for number, row in enumerate(devices.tolist(), start=1)
    ]
    return Cells(HEADS, rows).to_csv()


def draws_script(
    drawn: Mapping[str, FloatArray],
    amplitude_mm: float,
    speed_mm_s: float,
    source: str,
    left_out: Sequence[str] = (),
) -> str:
    """Script for OpenSeesPy: a table of devices, functions that define one, and a check that runs a cycle of each.

    `speed_mm_s` is the peak speed of the tests, `source` says where the devices come from, and `left_out` what they do
    not carry besides, one sentence each.
    """
    rows = "\n".join(
        f"    ({json.dumps(name)}, {number}): ({force:.6g}, {second:.6g}, {K:.6g}, {sharpness:.6g}, {at_rest:.6g}),"
        for name, devices in drawn.items()
        for number, (K, force, second, sharpness, at_rest) in enumerate(devices.tolist(), start=1)
    )
    rate = f"{1.0 / (MIDDLE_SPEED * speed_mm_s):.6g}"
    notes = (NOTES[0], *NOTES[2:5], *map(plain, left_out))
    return filled("connection_draws.py", rows, notes, amplitude_mm, source, rate=rate)
