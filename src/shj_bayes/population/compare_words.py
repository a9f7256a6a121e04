"""A comparison in words: never "no effect" from a small sample, but the interval and what would decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from shj_bayes.population.power import MOST
from shj_bayes.population.priors import ASSUMED

if TYPE_CHECKING:
    from shj_bayes.population.compare import Contrast

TRUSTED = 0.95
ROPE_SPEED = 10.0
"""Speed at which practical equivalence of gamma is meant as a share of the force, mm/s."""


def sentence(c: Contrast, sides: tuple[str, str], settled: Mapping[str, bool], rope: float) -> str:
    """Say how two sides differ in one quantity, how sure that is, and what would decide.

    `settled` is whether each prior of the spread gives the direction, `rope` the half-width of the region of practical
    equivalence.
    """
    if c.kind == "quotient":
        # As many digits, four at most, as tell the ends of a narrow interval apart.
        digits = next((d for d in (2, 3) if round(c.q05, d) != round(c.q95, d)), 4)
        between = f"{c.q05:.{digits}f} to {c.q95:.{digits}f}"
        size = f"is {c.q50:.{digits}f} times that of {sides[1]} (90 % interval {between})"
        open_ = f"a factor of anything from {between}"
        edge = f"{100 * rope:.0f} %"
    else:
        size = f"differs from {sides[1]} by {c.q50:+.3g} {c.unit} (90 % interval {c.q05:+.3g} to {c.q95:+.3g})"
        open_ = f"anything from {c.q05:+.3g} to {c.q95:+.3g} {c.unit}"
        edge = f"{rope / ROPE_SPEED:.3g} {c.unit}"
    if not settled["default"]:
        verdict = f"the direction is not settled: {open_} is compatible with them"
    elif not all(settled.values()):
        against = ", ".join(ASSUMED.get(label, f"under the {label} prior") for label, yes in settled.items() if not yes)
        verdict = f"the direction hangs on what is assumed of the spread (not settled {against})"
    else:
        verdict = "the direction is settled at 90 %, whatever is assumed of the spread"
    text = f"{sides[0]}: {c.quantity} of a typical device {size}; with {c.n_a} and {c.n_b} devices {verdict}."
    if c.probability_rope > TRUSTED:
        return f"{text} They differ by less than {edge} with a probability of {c.probability_rope:.2f}."
    if all(settled.values()):
        return text
    count = f"about {c.n_to_decide}" if c.n_to_decide < MOST else f"more than {MOST}"
    return (
        f"{text} A sample of this size finds a true difference of {edge}, the smallest that matters here, with a "
        f"power of {c.power_edge:.2f}; a power of 0.80 takes {count} devices a side (if sets spread nearly alike)."
    )


def multiplicity_words(n_quantities: int, n_strata: int, tests: Sequence[str]) -> str:
    """Say how many comparisons were made at once, by which test of each quantity, and how that is allowed for."""
    over = f", each averaged over {n_strata} pairs of sets alike in all else" if n_strata > 1 else ""
    said = {
        "permutation": "on the exact permutation",
        "Welch": "on Welch's test where no arrangement of so few devices could bring the permutation to 0.05 after "
        "that (its least p stands beside it)",
    }
    basis = " and ".join(words for name, words in said.items() if name in tests)
    rest = [f"The p-values marked Holm allow for that number; they rest {basis}."] if basis else []
    rest += ["Where neither permutation nor Welch's test can reach 0.05 there is none."] if "" in tests else []
    return (
        f"{n_quantities} quantities were compared{over}. {' '.join(rest)} The posterior draws the sets towards each "
        "other by itself. Whoever picks among many pairs must divide once more."
    )
