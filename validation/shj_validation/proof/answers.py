"""The withheld answers of the real recordings, and how a diagnosis is held against each.

What is known stands in the publications (see the README of the recordings' folder); columns of the band actuator and of
the pressure are read only after the diagnosis is done.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.coordinates import coordinates_of
from shj_bayes.model.effects.effect import Base, catalogue, combine
from shj_bayes.model.history import History, histories
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording
from shj_validation.proof.predict import acting_in, law_of

PISTON_MM2 = 490.874  # of the seal rig: pi/4 (25 mm)^2
EMPS = {"mass": 95.1, "coulomb_N": 20.4, "viscous": 203.5, "offset_N": -3.16}  # Janot, Gautier, Brunot 2019
BACKLASH_MM = (2.8, 3.3)
BACKLASH_20_LB_MM = (1.4, 1.6)  # given as 1.5 mm for the loosest band
LEVEL = 0.05  # push and pull levels can be read off a loop to about this share of their mean
LOADS = (
    "restoring",
    "load_offset",
    "reversal_form",
)  # elastic stiffness, the load cell's zero and the law: not friction
MOVED_IN = 0.002  # of the band actuator: more than its resolution
EARLY = 0.1  # of a test: strokes grow
HALF = 0.5  # of its usual force: with less an end of the band is being loaded or unloaded
WAITS = 0.2  # of the peak speed; below it a device waits, or turns


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
    rate_Hz : float or None
        Sampling rate stated for a file without time.
    without : tuple of str
        Effects taken out of the catalogue.
    """

    id: str
    file: str
    withheld: str
    judge: Judge
    columns: str | None = None
    units: str | None = None
    rate_Hz: float | None = None
    without: tuple[str, ...] = ()

    @property
    def band(self) -> bool:
        """Whether the columns of a band's actuator were withheld."""
        return self.judge is _band


def _found(answer: Answer, name: str) -> dict[str, Any] | None:
    """Give what a diagnosis says of an effect, or None where it was not found."""
    return next((one for one in answer["effects"] if one["id"] == name), None)


def effect(answer: Answer, name: str) -> dict[str, float] | None:
    """Give the medians of an effect's parameters, or None where it was not found."""
    one = _found(answer, name)
    return {key: float(row["q50"]) for key, row in one["parameters"].items()} if one else None


def _offset_N(answer: Answer) -> float | None:
    """Constant force that was found, N; not share times Fy, which may both be open where their product is not."""
    one = _found(answer, "load_offset")
    return float(np.copysign(1000 * one["size_kN"], one["parameters"]["size"]["q50"])) if one else None


@dataclass(frozen=True, eq=False)
class Band:
    """What the actuator of a band did during a test.

    Parameters
    ----------
    begin_s, end_s, test_s : float
        When the band was moved, and how long the test lasts, s.
    change : dict
        For push and pull: times, s, while that end of the band pulls, and the force of the band there over its mean
        before and after it was moved, less 1; shapes (n,).
    """

    begin_s: float
    end_s: float
    test_s: float
    change: dict[str, tuple[FloatArray, FloatArray]]

    def inside(self, at_s: FloatArray) -> Any:
        """Whether the band was moved then."""
        return (at_s > self.begin_s) & (at_s < self.end_s)


def band_of(file: Path) -> Band:
    """Read what was withheld."""
    table = pd.read_csv(file)
    time, position = table["Time (s)"].to_numpy(), table["Band position 1 (in)"].to_numpy()
    moved = time[np.abs(position - position[0]) > MOVED_IN]
    begin_s, end_s, test_s = float(moved.min()), float(moved.max()), float(time[-1])
    rest = ((time <= begin_s) | (time >= end_s)) & (time > EARLY * test_s)
    slides = _slides(np.abs(np.gradient(table["Displacement (in)"].to_numpy(), time)))
    push, pull = (table[f"Band force {end} (lb)"].to_numpy() for end in (2, 1))
    change = {}
    for side, force, other in (("push", push, pull), ("pull", pull, push)):
        taut = slides & (force > other)
        pulling = taut & (force > HALF * np.median(force[taut & rest]))
        change[side] = (time[pulling], force[pulling] / np.mean(force[pulling & rest]) - 1.0)
    return Band(begin_s, end_s, test_s, change)


def _slides(speed: FloatArray) -> Any:
    """Whether a device moves, and neither waits nor turns."""
    return speed > WAITS * np.percentile(speed, 95)


def clamping_changes(answer: Answer, band: Band) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Give what was diagnosed of push and of pull, as `Band.change`: what was named, or a curve over time.

    At the times at which that end of the band pulls: at others nothing is known of it. A curve is held against its mean
    before and after the band was moved. Empty where neither was found.
    """
    found, curves, out = effect(answer, "tension_step"), _curves_over_time(answer), {}
    for side, sense in (("push", 1.0), ("pull", -1.0)):
        at = band.change[side][0]
        if found is not None and "begin" in found:
            since = at / band.test_s - found["begin"]
            there = (since >= 0.0) & (since <= found["length"])
            out[side] = (at, np.where(there, found["size"] * (1.0 + sense * found["side"]), 0.0))
        elif side in curves:
            own, early = np.interp(at, *curves[side]), at < EARLY * band.test_s
            rest = float(np.mean(own[~band.inside(at) & ~early]))
            out[side] = (at, np.where(early, 0.0, own / rest - 1.0))
    return out


def _band(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare when the clamping changed, and by how much in each direction, with the band's own columns."""
    band = band_of(file)
    known = {side: float(np.mean(change[band.inside(at)])) for side, (at, change) in band.change.items()}
    size = f"push {100 * known['push']:+.0f} %, pull {100 * known['pull']:+.0f} %"
    truth = f"the band was moved from {band.begin_s:.1f} to {band.end_s:.1f} s (band force {size})"
    changes = clamping_changes(answer, band)
    if not changes:
        return [Judged(False, f"{truth}; no change of clamping was found")]
    own = {side: float(np.mean(change[band.inside(at)])) for side, (at, change) in changes.items()}
    at, change = changes[max(own, key=lambda side: abs(own[side]))]
    low, high = (float(at[np.abs(change) >= 0.5 * np.abs(change).max()][i]) for i in (0, -1))
    shared = max(0.0, min(band.end_s, high) - max(band.begin_s, low))
    shared /= max(band.end_s, high) - min(band.begin_s, low)
    out = [Judged(shared >= 0.5, f"{truth}; diagnosed from {low:.1f} to {high:.1f} s ({100 * shared:.1f} % shared)")]
    for side, found_in in own.items():
        near = abs(found_in - known[side]) <= max(0.1, 0.5 * abs(known[side]))
        out.append(
            Judged(near, f"{side}: band force {100 * known[side]:+.0f} %, diagnosed clamping {100 * found_in:+.0f} %")
        )
    return out


def _curves_over_time(answer: Answer) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Give times and clamping, 1 where the law has it, of the curves over time in push and in pull, where found."""
    out: dict[str, tuple[FloatArray, FloatArray]] = {}
    for row in answer.get("coordinates", []):
        if (row["action"], row["coordinate"]) == ("capacity", "time") and row["curve"] and not row["period"]:
            both = (np.array(row["curve"]["at"]), 1.0 + np.array(row["curve"]["mean"]) / 100.0)
            out |= dict.fromkeys(("push", "pull") if row["direction"] == "both" else (row["direction"],), both)
    return out


def _pressure(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare the constant in the force with pressure times area."""
    table = pd.read_csv(file, sep="\t", header=None)
    newton = float(np.median(table[5])) * 0.1 * PISTON_MM2
    own = _offset_N(answer)
    if own is None:
        return [Judged(False, f"the pressure pushes with {newton:.1f} N; no constant force was named")]
    near = abs(own - newton) <= max(0.1 * newton, 1.0)
    return [Judged(near, f"the pressure pushes with {newton:.1f} N; diagnosed constant {own:.1f} N")]


def _emps(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare mass, Coulomb and viscous friction and offset with the published identification.

    The published law has no asymmetry and one slope: what is compared is its fit to the diagnosed friction.
    """
    coulomb, viscous, offset = _straight(answer, file)
    out = []
    for words, own, known, near in (
        ("Coulomb {:.1f} N", coulomb, EMPS["coulomb_N"], 0.1 * EMPS["coulomb_N"]),
        ("viscous {:.1f} N s/m", viscous, EMPS["viscous"], 0.15 * EMPS["viscous"]),
        ("offset {:.2f} N", offset, EMPS["offset_N"], 1.0),
    ):
        out.append(Judged(abs(own - known) < near, f"{words.format(known)}; diagnosed {words.format(own)}"))
    mass = effect(answer, "inertia")
    weighed = f"diagnosed {mass['size']:.1f} kg" if mass else "no mass was named"
    near = mass is not None and abs(mass["size"] / EMPS["mass"] - 1) < 0.1
    return [*out, Judged(near, f"mass {EMPS['mass']} kg; {weighed}")]


def _friction_of(answer: Answer, recording: Recording) -> tuple[History, FloatArray]:
    """Friction of the model that was diagnosed where a device slides, and what it adds to it but for a mass, kN."""
    (history,) = histories([recording.time_s], [motion_of(recording)])
    law = law_of(answer, "after")
    base = Base(law["K"], law["Fy"], law["beta"], law.get("gamma", 0.0), law["Fy"])
    does = combine([of.act(history, values, base) for of, values in acting_in(answer) if of.id != "inertia"])
    speed = history.speed_mm_s
    friction = history.direction * base.Fy * does.clamping * (1.0 + (base.gamma + does.gamma_s_per_mm) * speed)
    return history, np.broadcast_to(friction + does.added_kN, speed.shape)


def _straight(answer: Answer, file: Path) -> tuple[float, float, float]:
    """Fit Coulomb friction (N), viscous friction (N s/m) and offset (N) to the friction of a diagnosed model."""
    history, friction = _friction_of(answer, read(file, columns=EMPS_COLUMNS, units="s,m,N"))
    speed = history.speed_mm_s
    columns = np.stack([history.direction, history.direction * speed / 1000.0, np.ones(speed.size)], axis=1)
    slides = speed > 0.01 * history.peak_speed_mm_s
    coulomb, viscous, offset = np.linalg.lstsq(columns[slides], 1000.0 * friction[slides], rcond=None)[0].tolist()
    return coulomb, viscous, offset


def _apart(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare how far push and pull are apart with their levels at mid-stroke, read off the loop.

    By the friction of the model that was diagnosed: the difference may stand in an asymmetry, in a constant force, or
    in curves for push and pull.
    """
    recording = read(file)
    history, friction = _friction_of(answer, recording)
    position = recording.displacement_mm - np.median(recording.displacement_mm)
    middle = np.abs(position) < 0.25 * np.percentile(np.abs(position), 99)
    middle &= _slides(history.speed_mm_s)

    def level(force: FloatArray) -> float:
        push, pull = (q * float(np.median(force[middle & (history.direction == q)])) for q in (1, -1))
        return (push - pull) / (push + pull)

    known, own = level(recording.force_kN), level(friction)
    words = f"push is {100 * known:+.0f} % off the mean of push and pull at mid-stroke; diagnosed {100 * own:+.0f} %"
    return [Judged(abs(own - known) <= LEVEL, words)]


def _change(expected: bool) -> Judge:
    """Compare whether the force changes from cycle to cycle."""

    def judge(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
        slow = [one["id"] for one in answer["effects"] if catalogue()[one["id"]].family == "slow_change"]
        slow += [
            f"a curve over {row['coordinate']}"
            for row in answer.get("coordinates", [])
            if row["curve"] and not row["matches"]
            if any(over.family == "slow_change" for over in coordinates_of(row["coordinate"]))
        ]
        known = "the force grows from cycle to cycle" if expected else "the force is steady from cycle to cycle"
        own = f"diagnosed {', '.join(slow)}" if slow else "no slow change was found"
        return [Judged(bool(slow) == expected, f"{known}; {own}")]

    return judge


def _no_friction(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Check that metal which yields is not given the name of a friction effect."""
    named = [one["id"] for one in answer["effects"] if one["id"] not in LOADS]
    if answer["verdict"] not in ("named", "family"):
        return [Judged(True, f"metal that yields, nothing slides; the answer is {answer['verdict']}")]
    words = f"metal that yields, nothing slides; named: {', '.join(named) or 'no friction effect'}"
    return [Judged(not named, words)]


def _gas(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
    """Compare the constant in the force with what is known of the damper's gas accumulator."""
    own = _offset_N(answer)
    words = "no constant force was named" if own is None else f"diagnosed {own:.0f} N"
    return [Judged(own is not None and 64.0 <= own <= 105.0, f"the gas pushes with 64 to 105 N; {words}")]


def _both(*judges: Judge) -> Judge:
    """Make several comparisons with one diagnosis."""

    def judge(answer: Answer, file: Path, answers: Mapping[str, Answer]) -> list[Judged]:
        return [one for judge in judges for one in judge(answer, file, answers)]

    return judge


def _backlash_within(low: float, high: float) -> Judge:
    """Compare the free travel with the published backlash."""

    def judge(answer: Answer, file: Path, _: Mapping[str, Answer]) -> list[Judged]:
        found = _found(answer, "slack")
        if found is None:
            return [Judged(False, f"backlash {low} to {high} mm; no free travel was named")]
        size = found["parameters"]["size"]
        own = f"diagnosed {size['q50']:.2f} mm (90 % interval {size['q05']:.2f} to {size['q95']:.2f} mm)"
        return [Judged(low <= size["q50"] <= high, f"backlash {low} to {high} mm; {own}")]

    return judge


_backlash = _backlash_within(*BACKLASH_MM)


def _hidden(pair: str) -> Judge:
    """Compare a diagnosis without slack in the catalogue: unknown, at the reversals, worse on held-out cycles."""

    def judge(answer: Answer, file: Path, answers: Mapping[str, Answer]) -> list[Judged]:
        unknown = answer["verdict"] == "unknown"
        places = [where["coordinate"] for where in [*answer.get("coordinates", []), *answer["location"]]]
        out = [
            Judged(unknown, f"without slack in the catalogue the answer is {answer['verdict']}"),
            Judged(
                bool({"slip", "slip since reversal"} & set(places)),
                f"located over {', '.join(dict.fromkeys(places)) or 'nothing'}",
            ),
        ]
        full = answers.get(pair)
        if full and "error" not in full:
            before, after = answer["after"]["heldout_rmse_kN"], full["after"]["heldout_rmse_kN"]
            words = f"held-out error {before:.3g} kN without slack in the catalogue, {after:.3g} kN with it"
            out.append(Judged(after < before, words))
        return out

    return judge


def _seal(name: str, judge: Judge = _pressure, *, friction: bool = False) -> Case:
    """Make the case of one seal: its force with the pressure withheld, or friction alone, which the pressure gives."""
    file, force = f"seals-tud/{name}.txt.gz", f"#7 - {0.1 * PISTON_MM2}*#6" if friction else "7"
    id, withheld = (f"friction of {name}", "how it goes on") if friction else (f"seal {name}", "pressure")
    return Case(id, file, withheld, judge, f"time=1,displacement=5,force={force}", "ms,mm,N")


def _brfd(name: str, judge: Judge = _backlash) -> Case:
    """Make the case of one test of the band brake whose backlash is published."""
    return Case(f"brfd {name}", f"brfd-lehigh/{name}.csv.gz", "the published backlash", judge)


def _gas_damper(id: str, file: str) -> Case:
    """Make the case of one test of the damper with a gas accumulator."""
    columns = "time=Ts,displacement=dist,force=forc"
    return Case(id, f"mr-damper-utfpr/{file}.mat", "the gas accumulator", _gas, columns, "s,mm,N")


def _metal(id: str, file: str, columns: str = "displacement=1,force=2") -> Case:
    """Make the case of a test without friction and without time."""
    return Case(id, file, "that nothing slides", _no_friction, columns, "mm,kN", rate_Hz=1.0)


COUPON = "displacement=#1*1000,force=#2*0.1"  # strain and MPa, as if of a bar of 1 m and 100 mm2
EMPS_COLUMNS = "time=t,displacement=qm,force=gtau*vir"
BRFD = "brfd-lehigh/ds1_0.5Hz80lb.csv.gz"
CASES = (
    Case("brfd step", "brfd-lehigh/ds4_step0.03ea1forward.csv.gz", "band position and band force", _band),
    Case("brfd harmonic", "brfd-lehigh/ds4_harmonic0.03ea1forward.csv.gz", "band position and band force", _band),
    Case("brfd slack", BRFD, "the published backlash", _both(_backlash, _apart)),
    Case("brfd slack hidden", BRFD, "slack, taken out of the catalogue", _hidden("brfd slack"), without=("slack",)),
    _brfd("ds1_0.5Hz25lb"),
    _brfd("ds2_0.5Hz30lb0.5in"),
    _brfd("ds2_0.5Hz30lb1in"),
    _brfd("ds2_0.5Hz36lb0.5in"),
    _brfd("ds2_0.25Hz36lb1in", _both(_backlash, _apart)),
    _brfd("ds2_0.5Hz36lb1in", _both(_backlash, _apart)),
    _brfd("ds2_1Hz36lb1in"),
    _brfd("ds2_eq_ImperialValleyMCE"),
    *(_seal(name) for name in ("KDN_1bar", "KDN_3bar", "KDN_7bar", "PK_1bar", "O-ring_7bar")),
    *(_seal(name, _change(expected=False), friction=True) for name in ("KDN_1bar", "KDN_3bar", "KDN_7bar", "PK_1bar")),
    _seal("O-ring_7bar", _change(expected=True), friction=True),
    Case("emps", "emps/DATA_EMPS.mat", "published mass, friction and offset", _emps, EMPS_COLUMNS, "s,m,N"),
    _gas_damper("mr damper", "ensaio5.1"),
    _metal("flexural plate", "quasistatic/Ganey2015_UFP_damper.csv"),
    _metal("slit damper", "quasistatic/Chan_Albermani_slit_damper_digitised.csv"),
    _metal("steel coupon 1", "steel-coupons/RESSPyLab_example_1.csv", COUPON),
    _metal("steel coupon 2", "steel-coupons/RESSPyLab_example_2.csv", COUPON),
    _brfd("ds1_0.5Hz20lb", _backlash_within(*BACKLASH_20_LB_MM)),
    *(_seal(name) for name in ("PK_5bar", "PK_7bar", "O-ring_1bar")),
    _gas_damper("mr damper 5.2", "ensaio5.2"),
    _gas_damper("mr damper B.5", "ensaio.B.5"),
)
