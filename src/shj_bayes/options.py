"""What users choose, declared once: the command line, the checks and the help in Python read these fields.

A field carries its words, and what the command line needs: its flag is the field's name without the unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from shj_bayes.errors import ModelError, PopulationError, ShjError, shown

if TYPE_CHECKING:
    from shj_bayes.model.device import DeviceModel
    from shj_bayes.model.priors import Priors

DIAGNOSES = ("quick", "full", "off")  # how a campaign looks for what the law leaves out
Kind = TypeVar("Kind")
SEEDS = (0, 2**32 - 1)
Rule = tuple[str, Callable[[Any], bool]]  # what a value must be, in words, and whether it is
LEAST_MM = 20.0  # lengths of a storey below it are metres: no storey is 20 mm high, and no arm 20 m long
POSITIVE: Rule = ("a number above zero", lambda value: 0 < value < math.inf)
SHARE: Rule = ("a number between 0 and 1", lambda value: 0 < value < 1)


def between(least: float, most: float) -> Rule:
    """Numbers from one to another."""
    return f"{least} to {most}", lambda value: least <= value <= most


def in_mm(length: float) -> float:
    """Length of a storey in mm, stated in m or mm."""
    return 1000.0 * length if length < LEAST_MM else length


def length(least_mm: float, most_mm: float) -> Rule:
    """Lengths of a storey."""
    words = (
        f"{least_mm:g} to {most_mm:g} mm, or {least_mm / 1000:g} to {most_mm / 1000:g} m: below {LEAST_MM:g} it is m"
    )
    return words, lambda value: least_mm <= in_mm(value) <= most_mm


_UNIT = re.compile("_(mm|mm_s|kN|Hz|deg)$")  # at the end of a name, that the flag has not


def flag_of(kind: Any, name: str) -> str:
    """Flag of a field of a class of options, as a command writes it."""
    says = next(one for one in fields(kind) if one.name == name).metadata
    return str(says["flag"] or f"--{_UNIT.sub('', name).replace('_', '-')}")


def option(
    default: Any,
    words: str,  # what it is, for the help of the command and of the class
    metavar: str | None = None,  # value as the help of the command writes it
    rule: Rule | None = None,  # what a value must be where one is given
    *,
    flag: str = "",  # in the place of the field's name
    choices: Sequence[str] = (),  # words that a command takes
    typed: tuple[int, int] | None = None,  # smallest and largest whole number that a command takes
    commas: bool = False,  # several values stand between commas; else the flag may be given again
    shown: bool = True,  # whether the help of the command states the default
) -> Any:
    """Field of options: what it is, and how it is written in a command."""
    says = {"words": words, "metavar": metavar, "flag": flag, "choices": choices, "commas": commas, "shown": shown}
    return field(default=default, metadata=says | {"rule": rule, "typed": typed})


def documented(kind: type[Kind]) -> type[Kind]:
    """Give a class of options the numpydoc section of its fields."""
    own: Any = kind
    rows = ["", "Parameters", "----------"]
    for one in fields(own):
        choices, rule = one.metadata["choices"], one.metadata["rule"]
        allowed = f" One of {', '.join(choices)}." if choices else f" Allowed is {rule[0]}." if rule else ""
        rows.append(f"{one.name} : {one.type}, default {one.default!r}\n    {one.metadata['words']}{allowed}")
    kind.__doc__ = "\n".join([str(kind.__doc__), *rows])
    return kind


def _check_rules(options: Any, error: type[ShjError]) -> None:
    """Refuse values that are not what their fields allow."""
    for one in fields(options):
        found, rule = getattr(options, one.name), one.metadata["rule"]
        if rule and found is not None and not rule[1](found):
            raise error(f"{one.name} = {shown(found, 20)}; allowed is {rule[0]}")


@documented
@dataclass(frozen=True)
class FitOptions:
    """How to read and fit a device; the same words as on the command line."""

    columns: str | None = option(None, "time=, displacement=, force=, and others to show.", "ROLE=COLUMN,...")
    units: str | None = option(None, "Units, where the header does not say.", "mm,kN,s")
    rate_Hz: float | None = option(None, "Sampling rate of files without time, Hz.", "HZ")
    sheet: str | None = option(None, "Sheet of a workbook, or group of a TDMS, HDF5 or MAT file.", "NAME")
    priors: str = option("afc", "Family that ships (afc, general) or TOML file.")
    model: str = option(
        "published", "Eq. 1 as published, or without its jump at reversals.", choices=("published", "continuous")
    )
    noise: str = option(
        "slow",
        "White and slow noise; for comparison ar1 (at the recorded rate), independent; student has heavy tails.",
        choices=("slow", "ar1", "independent", "student"),
    )
    effects: tuple[str, ...] = option((), "Physical effects that are known to be there.", "slack,wear", commas=True)
    free: tuple[str, ...] = option((), "Parameters that each run has for itself.", "K,beta,gamma", commas=True)
    seed: int = option(1, "Same seed and inputs, same numbers.", rule=between(*SEEDS), typed=SEEDS)
    max_steps: int = option(
        10_000,
        "Steps after which sampling stops even if it has not converged.",
        rule=between(1, 1_000_000),
        typed=(200, 1_000_000),
    )
    runs: int | Literal["split", "one"] | None = option(
        None, 'Runs that the files hold together; "split" parts files where runs are found, "one" never does.'
    )
    priors_from: str | None = option(
        None, "Posterior of an earlier fit, or of a campaign's set, as prior.", "DIR[#SET]"
    )

    def __post_init__(self) -> None:
        """Refuse choices that no fit could take, before any device is read."""
        from shj_bayes.model.law import variant_named
        from shj_bayes.recording.columns import check_rate, parse_columns
        from shj_bayes.recording.runs import check_runs
        from shj_bayes.recording.units import parse_units

        object.__setattr__(self, "model", variant_named(self.model))
        _check_rules(self, ModelError)
        asked = parse_columns(self.columns)
        parse_units(self.units)
        if self.rate_Hz is not None:
            check_rate(self.rate_Hz, asked)
        check_runs(self.runs)
        if "velocity" in self.effects:
            raise ModelError(
                "the base law depends on speed already; take 'velocity' out of the effects (or --without velocity)"
            )
        self.device_model(1, None)

    def device_model(self, n_runs: int, priors: Priors | None) -> DeviceModel:
        """Model of a device with so many runs; without priors those of the default family stand in."""
        from shj_bayes.model.device import DeviceModel, effects_named
        from shj_bayes.model.noise import noise_model
        from shj_bayes.model.priors import read_priors

        return DeviceModel(
            n_runs,
            priors or read_priors(),
            effects=effects_named(self.effects),
            noise=noise_model(self.noise),
            free=self.free,
            variant=self.model,
        )


@documented
@dataclass(frozen=True)
class DiagnoseOptions:
    """How to look for what a model leaves out."""

    without: tuple[str, ...] = option((), "velocity: base law without it; others: not tried.", "EFFECT")
    quick: bool = option(False, "A first look: approximate intervals, no sampling.")
    name: str = option("device", "Name of the device; by default that of the first file.", shown=False)

    def hidden(self, device: DeviceModel) -> frozenset[str]:
        """Mechanisms that are not looked for: those taken out, and those that the model of the device has already."""
        speed = {"velocity"} if device.speed else set()
        return frozenset({*self.without, *(effect.mechanism for effect in device.effects)} - {"velocity"} | speed)


@documented
@dataclass(frozen=True)
class PlanOptions:
    """What is asked of a plan; limits go before those of the rig, and those not stated are what the tests reached."""

    question: str | None = option(None, "which, gamma, ratio, K, Fy, beta, least or force; which by default.", "Q")
    among: tuple[str, ...] = option((), "Mechanisms to tell apart; velocity: base law.", "velocity,prying", commas=True)
    max_stroke_mm: float | None = option(None, "Largest displacement to either side.", "MM")
    max_speed_mm_s: float | None = option(None, "Largest speed.", "MM/S")
    max_force_kN: float | None = option(None, "Largest force.", "KN")
    max_minutes: float | None = option(None, "Longest test.", "MIN")
    rate_Hz: float | None = option(None, "Rate of the displacement history.", "HZ")
    histories: tuple[Path, ...] = option(
        (), "A further candidate: displacement (mm) over time (s).", "FILE", flag="--history"
    )
    priors: str = option("afc", "Family that ships (afc, general) or TOML file: a plan before any test.", shown=False)
    seed: int = option(1, "Same seed and inputs, same numbers.", rule=between(*SEEDS), typed=SEEDS)


@documented
@dataclass(frozen=True)
class MarginOptions:
    """What is asked of the margins."""

    amplitude_mm: float | None = option(None, "Of a sine, in place of the tests themselves.", "MM", POSITIVE)
    speed_mm_s: float | None = option(None, "Its peak speed; largest tested by default.", "MM/S", POSITIVE)
    cycles: int | None = option(None, "Its cycles; 3 by default.", "N", POSITIVE)
    slip: Path | None = option(
        None, "Slip of the device (mm) over time (s), two columns, in place of the tests themselves.", "FILE"
    )
    history: Path | None = option(None, "The same as --slip.", "FILE")
    drift: Path | None = option(None, "Drift of a storey (mm) over time (s); slip follows by:", "FILE")
    storey_height: float | None = option(
        None, "Slip = drift x lever arm / height; m, from 20 on mm.", "M", length(1000.0, 19_999.0)
    )
    lever_arm: float | None = option(
        None, "From the centre of rotation to the sliding plane; m or mm.", "M", length(20.0, 10_000.0)
    )
    brace_angle_deg: float | None = option(
        None,
        "Or slip = drift x cos of the angle to the horizontal.",
        "DEG",
        rule=("0 to below 90 degrees", lambda value: 0 <= value < 90),
    )
    extrapolate: bool = option(False, "Allow speed, travel and time beyond the tests: bounded laws.")
    nominal_kN: float | None = option(None, "Nominal sliding force; typical device by default.", "KN", POSITIVE)
    bolts: int | None = option(
        None, "Nominal force V_ss = bolts x surfaces x mu x clamping, in its place.", "N", POSITIVE
    )
    surfaces: int = option(2, "Sliding surfaces of V_ss.", rule=POSITIVE)
    mu: float | None = option(
        None, "Coefficient of friction of V_ss.", "MU", rule=("between 0 and 2", lambda value: 0 < value < 2)
    )
    clamping_kN: float | None = option(None, "Clamping force (proof load) of one bolt, of V_ss.", "KN", POSITIVE)
    importance: str = option("II", "Importance class of the structure (EN 15129).", choices=("I", "II", "III"))
    v_known: float | None = option(None, "Known coefficient of variation of the sliding force.", "V", SHARE)
    v_reason: str = option("", "Where V is known from; printed beside the values.", "WORDS")
    reliability: str = option("0.95", "Of the forces: share of devices within, or beta=1.5 (EN 1990).", "P")
    connections: int | None = option(
        None, "Connections that act together: their sum, the largest of them.", "N", between(1, 1000)
    )
    force_wanted_kN: float | None = option(None, "Force to count on: bolts and clamping that it needs.", "KN", POSITIVE)
    clamping_cov: float | None = option(None, "Coefficient of variation of one bolt's tightening.", "V", SHARE)
    sets: tuple[str, ...] = option((), "Draw up this set alone; may be given again.", "NAME", flag="--set")

    def __post_init__(self) -> None:
        """Refuse a nominal force that is none, a drift without its slip, and a known spread without a reason."""
        _check_rules(self, PopulationError)
        files = [path for path in (self.slip, self.history, self.drift) if path is not None]
        if len(files) + ((self.amplitude_mm, self.speed_mm_s, self.cycles) != (None, None, None)) > 1:
            raise PopulationError("give one history: a slip, a drift, or amplitude, speed and cycles of a sine")
        turned = tuple(value is not None for value in (self.storey_height, self.lever_arm, self.brace_angle_deg))
        # Without a drift, the arm or the angle alone make a moment or a storey force of the force of a device.
        alone = {(False, False, False), (False, True, False), (False, False, True)}
        if turned not in (alone if self.drift is None else {(True, True, False), (False, False, True)}):
            raise PopulationError(
                "--drift goes with --storey-height and --lever-arm, or with --brace-angle alone: a device feels slip, "
                "not drift; a history that is slip already is given by --slip"
            )
        parts = (self.bolts, self.mu, self.clamping_kN)
        if self.mu is not None and (None in parts or self.nominal_kN is not None):
            raise PopulationError(
                "V_ss needs --bolts, --mu and --clamping (kN of one bolt) together, and no --nominal beside them"
            )
        if not 0.5 <= self.probability <= 0.999:
            raise PopulationError(
                f"a reliability of {shown(self.reliability)}; allowed is a share of 0.5 to 0.999, or beta=0 to "
                "beta=3.09 (share Phi(beta)): rarer devices no draws tell of"
            )
        if (self.v_known is None) != (not self.v_reason.strip()):
            raise PopulationError(
                "a coefficient of variation taken as known needs the reason, and a reason needs the value: give "
                '--v-known 0.06 --v-reason "factory control of 300 devices"; without both, V counts as unknown'
            )

    @property
    def probability(self) -> float:
        """Reliability as the share of devices within a bound; NaN where it is none."""
        word, _, number = str(self.reliability).replace(" ", "").rpartition("=")
        try:
            value = float(number)
        except ValueError:
            return math.nan
        return value if not word else 0.5 * math.erfc(-value / math.sqrt(2.0)) if word == "beta" else math.nan

    @property
    def slip_of_drift(self) -> tuple[float, str]:
        """Slip of the device over drift of the storey, and how it was worked out; 1 for a history of slip."""
        if self.brace_angle_deg is not None:
            share = math.cos(math.radians(self.brace_angle_deg))
            return share, f"slip = drift x cos {self.brace_angle_deg:g} deg = {share:.4g} x drift"
        if self.storey_height is None or self.lever_arm is None:
            return 1.0, ""
        arm, height = in_mm(self.lever_arm), in_mm(self.storey_height)
        said = f"slip = drift x lever arm / storey height = {arm:g} / {height:g} mm = {arm / height:.4g} x drift"
        return arm / height, said

    @property
    def stated_nominal(self) -> tuple[float, str] | None:
        """Nominal force that the user states, kN, and what it is; None where a typical device stands for it."""
        if self.bolts is not None and self.mu is not None and self.clamping_kN is not None:
            force = self.bolts * self.surfaces * self.mu * self.clamping_kN
            said = f"{self.bolts} bolts x {self.surfaces} surfaces x mu {self.mu:g} x {self.clamping_kN:g} kN"
            return force, f"V_ss = {said}"
        return None if self.nominal_kN is None else (self.nominal_kN, "stated by the user")


PLAIN = MarginOptions()
