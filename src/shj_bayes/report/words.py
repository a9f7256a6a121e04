"""Numbers in words: what a laboratory engineer or a designer reads on the page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from shj_bayes.report.residuals import LONG_MEMORY, Structure

VERDICTS = {
    "reliable": "The calculation has finished: independent searches agree, so the intervals below can be quoted.",
    "tentative": "The calculation has not quite finished: take the intervals below as a first look, and run it longer.",
    "unusable": "The calculation failed: do not use the numbers below.",
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


def residual_headline(s: Structure) -> str:
    """One sentence: does the model describe this device."""
    size = f"{abs(s.largest.mean_kN):.2g} kN ({100 * s.largest.share:.1f} % of the sliding force) {s.largest.where}"
    if s.seen:
        return f"The model leaves something out: the residual is structured, up to {size}, more than noise explains."
    if s.absorbed:
        return (
            "The model probably leaves something out: what remains is too slow to be noise, and the noise term of the "
            f"model has taken it up (mean residual up to {size})."
        )
    if s.unmodelled_correlation:
        return (
            "The noise was taken as independent from sample to sample, and it is not: the intervals are too narrow. "
            "Fit again with the default noise model."
        )
    return "Nothing beyond noise is seen in what the model leaves over."


def in_a_cell(structured: bool, headline: str) -> str:
    """Shorten `residual_headline` to what a cell of a table has room for."""
    if not structured:
        return "nothing beyond noise"
    head, _, rest = headline.partition(": ")
    return rest.removeprefix("the residual is structured, ") if head.startswith("The model") else headline


def band_words(s: Structure) -> str:
    """Say what the band of measured points is made of."""
    if s.absorbed:
        return (
            "The band is this wide because the noise term has taken up what the model does not describe: look at how "
            "far the line runs from the points, not at the band."
        )
    return "Points that leave the band over a stretch, cycle after cycle, are what the model does not describe."


def residual_details(s: Structure) -> list[str]:
    """How that was found, one or two sentences for each look."""
    out = [
        f"Against noise: of residuals made of the fitted noise alone, {_share(s.p_noise)} are as structured as the "
        "measured one over stroke, distance since reversal and time.",
        _repeat_words(s),
        *([] if s.independent_noise else [_memory_words(s)]),
        f"Size: the residual is {short(s.size.rms_kN)} kN in root mean square; from one sample to the next it scatters "
        f"by {short(s.size.short_kN)} kN.",
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
