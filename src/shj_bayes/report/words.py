"""Numbers in words: what a laboratory engineer or a designer reads on the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from shj_bayes.report.residuals import Structure

# Of the typical cycle. Against the shortest one (3.7 s in Table 1) ordinary noise of phi 0.7 at 5 Hz was called misfit.
LONG_MEMORY = 0.2

# Of the calculation alone: word of the badge, class of its colour, sentence.
CONVERGENCE = {
    "reliable": ("converged", "reliable", "The independent ensembles agree."),
    "tentative": ("not quite converged", "tentative", "Take the intervals as a first look, and run it longer."),
    "unusable": ("not converged", "unusable", "The independent ensembles disagree: do not use the numbers below."),
}
# Of the model: word of the badge, class of its colour.
FIT = {
    "good": ("good fit", "reliable"),
    "fair": ("fair fit", "tentative"),
    "poor": ("poor fit", "unusable"),
    "undecided": ("fit undecided", "tentative"),
}
_DETERMINES = {
    "K": "small cycles, or more samples where the force turns",
    "Fy": "cycles long enough to slide",
    "beta": "more samples where sliding begins",
    "gamma": "cycles of one stroke at clearly different speeds",
    "ratio": "a second run over the same strokes",
}
SEVERITIES = {
    "unusable": "must not be used",
    "warning": "warning",
    "repaired": "repaired",
    "assumed": "assumed",
    "note": "note",
}


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


def interval(row: Mapping[str, Any]) -> str:
    """90 % interval of a row of the parameter table."""
    return f"{rounded(row['q05'], row['sd'])} to {rounded(row['q95'], row['sd'])}"


def dep_words(row: Mapping[str, Any]) -> str:
    """Interval of gamma, s/mm, said as dep = 1/gamma, mm/s."""
    low, high = float(row["q05"]), float(row["q95"])
    if low <= 0 <= high:
        sides = [f"below {1 / low:+.0f}"] if low < 0 else []
        sides += [f"above {1 / high:+.0f}"] if high > 0 else []
        edges = f"; if there is any, dep is {' or '.join(sides)} mm/s" if sides else ""
        return f"dep has no bound: the force may not depend on speed at all{edges}"
    first, second = sorted((1 / low, 1 / high))
    digits = max(0, 1 - math.floor(math.log10(max(second - first, 1e-6))))
    return f"dep between {first:+.{min(digits, 3)}f} and {second:+.{min(digits, 3)}f} mm/s"


def speed_words(row: Mapping[str, Any], peak_mm_s: float) -> str:
    """Say what gamma means at the largest tested speed."""
    low, high = sorted(100 * float(row[q]) * peak_mm_s for q in ("q05", "q95"))
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


def remark(finding: Mapping[str, Any], unit: str = "", factor: float = 1.0) -> str:
    """Say what the recordings do not tell of a parameter.

    Parameters
    ----------
    finding : mapping
        Of ``remarks`` in ``fit.json``.
    unit : str
        Of the numbers shown, empty for none.
    factor : float
        To that unit.
    """
    name = str(finding["parameter"])
    low, high = (short(factor * float(finding[key])) for key in ("prior_q05", "prior_q95"))
    unit = "" if unit in ("", "1") else f" {unit}"
    if finding["kind"] == "undetermined":
        wanted = _DETERMINES.get(name.partition("_")[0])
        return (
            f"{name} is not determined by this recording: it may lie almost anywhere in its prior, {low} to {high}"
            f"{unit} (90 %)" + (f"; {wanted} would tell." if wanted else ".")
        )
    return (
        f"{name} is {short(factor * float(finding['q50']))}{unit}, which the prior holds nearly impossible ({low} to "
        f"{high}{unit}, 90 %): the result is drawn towards it. Check the units (--units), or give priors for this kind "
        "of device (--priors general, or a file of your own)."
    )


def fit_words(s: Structure) -> str:
    """How much of the force the model leaves unexplained."""
    if s.grade == "undecided":
        return f"{s.unexplained_percent:.2g} % of Fy unexplained, {s.n_cycles} full cycle{'s' * (s.n_cycles != 1)}"
    return f"{s.unexplained_percent:.2g} % of Fy unexplained"


def residual_headline(s: Structure, unit: str = "kN", factor: float = 1.0) -> str:
    """One sentence: does the model describe this device."""
    if s.grade == "undecided":
        return (
            f"Too few cycles to say whether the model describes this device ({s.n_cycles} full cycles, "
            f"{s.least_cycles} are needed); it leaves {s.unexplained_percent:.2g} % of the sliding force unexplained."
        )
    if s.seen:
        return f"The model leaves something out: the residuals are structured, {in_a_cell(s, unit, factor)}"
    if s.absorbed:
        return f"The model probably leaves something out: {in_a_cell(s, unit, factor)}"
    if s.unmodelled_correlation:
        return (
            "The noise was taken as independent from sample to sample, and it is not: the intervals are too narrow. "
            "Fit again with the default noise model."
        )
    if s.grade != "good":
        return (
            f"The residuals look like noise, but they are large: {s.unexplained_percent:.2g} % of the sliding force is "
            "unexplained."
        )
    return "Nothing beyond noise is seen in the residuals."


def in_a_cell(s: Structure, unit: str = "kN", factor: float = 1.0) -> str:
    """Say the same as `residual_headline`, as far as a cell of a table has room for it."""
    force = f"{factor * abs(s.largest.mean_kN):.2g} {unit}"
    size = f"{force} ({100 * s.largest.share:.1f} % of the sliding force) {s.largest.where}"
    if s.seen and s.grade != "undecided":
        return f"up to {size}, more than noise explains."
    if s.absorbed and s.grade != "undecided":
        return (
            "what remains is too slow to be noise, and the noise term of the model has taken it up (mean residual up "
            f"to {size})."
        )
    return "nothing beyond noise" if s.grade == "good" else residual_headline(s, unit, factor)


def band_words(s: Structure) -> str:
    """Say what the band of measured points is made of."""
    if s.absorbed:
        return (
            "The band is this wide because the noise term has taken up what the model does not describe: look at how "
            "far the line runs from the points, not at the band."
        )
    return "Points that leave the band over a stretch, cycle after cycle, are what the model does not describe."


def residual_details(s: Structure, unit: str = "kN", factor: float = 1.0) -> list[str]:
    """How that was found, one or two sentences for each look."""
    out = [
        f"Against noise: of residuals made of the fitted noise alone, {_share(s.p_noise)} are as structured as the "
        "measured one over stroke, distance since reversal and time.",
        _repeat_words(s),
        *([] if s.independent_noise else [_memory_words(s)]),
        f"Size: the residuals are {short(factor * s.size.rms_kN)} {unit} in root mean square; from one sample to the "
        f"next they scatter by {short(factor * s.size.short_kN)} {unit}.",
    ]
    if s.size.rms_kN > 5 * s.size.short_kN:
        out[-1] += " It changes far more slowly than the instruments scatter, so most of it is not their noise."
    return out


def _repeat_words(s: Structure) -> str:
    if s.p_repeat is None:
        return "From cycle to cycle: fewer than eight full cycles, too few to see what comes again."
    return (
        "From cycle to cycle: noise changes sign at random from one cycle to the next, shape comes again. If it were "
        f"noise, {_share(s.p_repeat)} such tests would show as much repetition."
    )


def _memory_words(s: Structure) -> str:
    text = (
        f"Memory of the noise: the fitted noise remembers itself for {short(s.memory_s)} s; a typical cycle takes "
        f"{short(s.typical_cycle_s)} s. "
    )
    if not s.absorbed:
        return text + "Measurement noise forgets faster than the device moves, as it should."
    share = 100 * s.memory_s / s.typical_cycle_s
    return (
        f"{text}That is {share:.0f} % of a cycle, above {100 * LONG_MEMORY:.0f} %: the noise model has absorbed "
        "misfit. What stays inside the noise band of the pictures below is then not only noise."
    )


def _share(p: float) -> str:
    """Return a p value as a share of tests."""
    if p > 0.995:
        return "nearly all"
    return f"at most 1 in {float(f'{1 / p:.2g}'):.0f}" if p <= 0.02 else f"about {100 * p:.0f} in 100"
