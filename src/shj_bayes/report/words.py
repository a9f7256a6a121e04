"""Numbers in words, and the unit of forces: what a laboratory engineer or a designer reads."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from shj_bayes.model.parameters import base_of
from shj_bayes.recording import recording as rule
from shj_bayes.results.diagnosis import FAIR_PERCENT, FEWEST_CYCLES, DiagnosisVerdict, EffectParameter, LeftOver
from shj_bayes.results.fit import FitRecord, ParameterRow, Remark, RemarkRecord, Trust

# Of the calculation alone: word of the badge, class of its colour, sentence.
CONVERGENCE: dict[str, tuple[str, str, str]] = {
    Trust.RELIABLE: ("converged", "reliable", "The independent ensembles agree."),
    Trust.TENTATIVE: ("not quite converged", "tentative", "Take the intervals as a first look, and run it longer."),
    Trust.UNUSABLE: ("not converged", "unusable", "The independent ensembles disagree: do not use the numbers below."),
}
# What makes the verdict of a finished calculation tentative.
SCATTER = " The verdict is tentative: the cycles scatter more than the model and its noise allow."
# Of the model: word of the badge, class of its colour.
FIT = {
    "good": ("good fit", "reliable"),
    "fair": ("fair fit", "tentative"),
    "poor": ("poor fit", "unusable"),
    "undecided": ("fit undecided", "tentative"),
}
DIAGNOSED_WORDS: dict[str, str] = {
    DiagnosisVerdict.ADEQUATE: "The diagnosis of these recordings found nothing beyond noise.",
    DiagnosisVerdict.NAMED: "The diagnosis of these recordings says what the law leaves out.",
    DiagnosisVerdict.FAMILY: "The diagnosis of these recordings says what the law may leave out, not which.",
    DiagnosisVerdict.UNKNOWN: "The diagnosis of these recordings found something left out that has no name.",
}
_DETERMINES = {
    "K": "small cycles, or more samples where the force turns",
    "Fy": "cycles long enough to slide",
    "beta": "more samples where sliding begins",
    "gamma": "cycles of one stroke at clearly different speeds",
    "ratio": "a second run over the same strokes",
}
SEVERITIES = {"unusable": "must not be used"}  # the others say it themselves
Row = TypeVar("Row", ParameterRow, EffectParameter)


def rounded(value: float, spread: float) -> str:
    """Return `value` with as many digits as its spread (a standard deviation or width) makes meaningful."""
    if not math.isfinite(value):
        return "not known"
    if not (math.isfinite(spread) and spread > 0):
        return f"{value:.4g}"
    decimals = 1 - math.floor(math.log10(spread))
    if decimals > 7 or abs(value) >= 1e7:
        return f"{value:.5g}"
    return f"{round(value, decimals):.{max(0, decimals)}f}"


def short(value: float) -> str:
    """Return a number to three digits, without exponents in the ordinary range."""
    if not math.isfinite(value):
        return "not known"
    if value == 0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return f"{value:.2e}"


def digits(value: float, error: float = 0.0) -> str:
    """Three digits, whole numbers from 100 on; a dash where a number cannot be given.

    Fewer where its standard error `error` does not tell them: steps of 1, 2 or 5 that are no smaller than it.
    """
    if not math.isfinite(value):
        return "-"
    if value and error > 10.0 ** (math.floor(math.log10(abs(value))) - 2):
        place = math.floor(math.log10(error))
        step = next(s for s in (1, 2, 5, 10) if s * 10.0**place >= error * (1 - 1e-9)) * 10.0**place
        decimals = max(0, -place - (step >= 9.99 * 10.0**place))
        return f"{round(value / step) * step:.{decimals}f}"
    if abs(value) >= 1e4:
        return f"{value:.1e}"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def interval(row: ParameterRow) -> str:
    """90 % interval of a row of the parameter table."""
    return f"{rounded(row.q05, row.sd)} to {rounded(row.q95, row.sd)}"


def dep_words(low: float, high: float) -> str:
    """Interval of gamma, s/mm, said as dep = 1/gamma, mm/s."""
    if low <= 0 <= high:
        sides = [f"below {1 / low:+.0f}"] if low < 0 else []
        sides += [f"above {1 / high:+.0f}"] if high > 0 else []
        edges = f"; if there is any, dep is {' or '.join(sides)} mm/s" if sides else ""
        return f"dep has no bound: the force may not depend on speed at all{edges}"
    first, second = sorted((1 / low, 1 / high))
    places = min(3, max(0, 1 - math.floor(math.log10(max(second - first, 1e-6)))))
    return f"dep between {first:+.{places}f} and {second:+.{places}f} mm/s"


def speed_words(row: ParameterRow | None, peak_mm_s: float) -> str:
    """Say what gamma means at the largest tested speed; None where the law was run without speed dependence."""
    low, high = sorted(100 * q * peak_mm_s for q in ((row.q05, row.q95) if row else (0.0, 0.0)))
    if low <= 0 <= high:
        return f"At {short(peak_mm_s)} mm/s the force differs from that at standstill by {low:+.1f} to {high:+.1f} %."
    kind = "higher" if low > 0 else "lower"
    small, large = sorted((abs(low), abs(high)))
    return f"At {short(peak_mm_s)} mm/s the sliding force is {small:.1f} to {large:.1f} % {kind} than at standstill."


def alias_words(peak_mm_s: float | None) -> str:
    """Warn of the tie between speed and place; nothing when the test broke it."""
    if peak_mm_s is None:
        return ""
    return (
        f"Every cycle of this test had the same peak speed, about {short(peak_mm_s)} mm/s. With one peak speed a loss "
        "of friction away from mid-stroke looks exactly like speed dependence: the number given for gamma may be the "
        "one or the other. Cycles of the same stroke at clearly different speeds (say a fifth and five times) would "
        "tell them apart."
    )


def remark(finding: RemarkRecord, unit: str = "", factor: float = 1.0, *, family: str = "") -> str:
    """Say what the recordings do not tell of a parameter, from one of the ``remarks`` in ``fit.json``.

    Numbers are shown in `unit` (empty for none), `factor` of it in that of the file; `family` is that of the priors.
    """
    name = finding.parameter
    low, high = (short(factor * value) for value in (finding.prior_q05, finding.prior_q95))
    unit = "" if unit in ("", "1") else f" {unit}"
    if finding.kind == Remark.UNDETERMINED:
        wanted = _DETERMINES.get(base_of(name))
        return (
            f"{name} is not determined by this recording: it may lie almost anywhere in its prior, {low} to {high}"
            f"{unit} (90 %)" + (f"; {wanted} would tell." if wanted else ".")
        )
    value = f"{name} is {short(factor * finding.q50)}{unit}"
    if finding.kind == Remark.AGAINST_EARLIER:
        return (
            f"{value}, and the earlier result {low} to {high}{unit} (90 %): the two disagree, and this one is drawn "
            "towards it. Leave --priors-from out; for another device of the same kind name a campaign's set there."
        )
    check = "Check the units (--units), or g" if unit else "The law may not be that of this device; if it is, g"
    return (
        f"{value}, which the prior holds nearly impossible ({low} to "
        f"{high}{unit}, 90 %): the result is drawn towards it. {check}ive priors for this kind of device "
        f"(--priors {'with a file of your own' if family == 'general' else 'general, or a file of your own'})."
    )


def fit_words(left: LeftOver) -> str:
    """How much of the force the model leaves unexplained."""
    few = f", {left.n_cycles} full cycle{'s' * (left.n_cycles != 1)}" if left.grade == "undecided" else ""
    percent = left.unexplained_percent
    size = "more than 100" if percent > 100 else f"{percent:.0f}" if percent >= 10 else f"{percent:.2g}"
    return f"{size} % of Fy unexplained{few}"


def missing_words(left: LeftOver, effects: Sequence[str] = ()) -> str:
    """Say what a diagnosis of the same recordings found, or which one would tell of a model with these effects."""
    if left.diagnosed:
        return DIAGNOSED_WORDS[left.diagnosed]
    if effects:
        return (
            f"It holds effects that were given to it ({', '.join(effects)}); whether anything is missing beside them, "
            f"shj-bayes diagnose --effects {','.join(effects)} says."
        )
    return "Whether anything is missing, shj-bayes diagnose says."


def left_words(left: LeftOver, effects: Sequence[str] = ()) -> str:
    """One sentence: does the model, with these effects, describe this device, and what the diagnosis found."""
    if left.grade == "undecided":
        return (
            f"Too few cycles to say whether the model describes this device: {left.n_cycles} full, and "
            f"{FEWEST_CYCLES} are needed."
        )
    text = "The model follows the force."
    if left.grade == "poor":
        text = "The model does not follow the force."
    elif left.widening > 1.0:
        text = "The cycles scatter more than the model and its noise allow."
    elif left.grade == "fair":
        text = "More is left over than a load cell drifts."
    return f"{text} {missing_words(left, effects)}"


def left_cell(left: LeftOver) -> str:
    """Say the same as far as a cell of a table has room for it; the diagnosis has a column of its own there."""
    return fit_words(left) + ("; the cycles scatter more than the noise allows" if left.widening > 1.0 else "")


def band_words(left: LeftOver) -> str:
    """Say what the band of measured points is made of."""
    if left.unexplained_percent > FAIR_PERCENT:
        return (
            "The noise term takes up what the model does not describe, which widens the band: look at how far the line "
            "runs from the points."
        )
    return "Points that leave the band over a stretch, cycle after cycle, are what the model does not describe."


@dataclass(frozen=True)
class ForceUnit:
    """Unit in which forces are shown."""

    name: str  # "kN", "N": as printed
    factor: float  # of it in a kilonewton

    def of(self, unit: str) -> tuple[str, float]:
        """Give the unit in which one of a parameter is shown (N for kN, N/mm for kN/mm), and the factor to it."""
        if unit.split("/", maxsplit=1)[0] != "kN":
            return unit, 1.0
        return self.name + unit[2:], self.factor

    def shown(self, kN: float) -> str:
        """Write a force of so many kN, with its unit."""
        return f"{short(kN * self.factor)} {self.name}"

    def row(self, row: Row) -> Row:
        """Row of a parameter table in the unit that is shown."""
        unit, factor = self.of(row.unit)
        values = {key: getattr(row, key) for key in ("mean", "sd", "q05", "q50", "q95")}
        return replace(row, unit=unit, **{key: value * factor for key, value in values.items() if value is not None})


KN = ForceUnit("kN", 1.0)


def force_unit(record: FitRecord) -> ForceUnit:
    """Choose the unit for a device by its sliding force in ``fit.json``."""
    row = record.parameter("Fy")
    return unit_for(row.q50 if row else None)


def unit_for(sliding_kN: float | None) -> ForceUnit:
    """Choose the unit for a device by its sliding force, which may not be known."""
    return KN if sliding_kN is None else ForceUnit(*rule.unit_for(sliding_kN))
