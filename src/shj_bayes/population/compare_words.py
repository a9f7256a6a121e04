"""A comparison in words: never "no effect" from a small sample, but the interval and what would decide."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from shj_bayes.population.power import MOST
from shj_bayes.population.priors import ASSUMED
from shj_bayes.population.quantities import QUANTITIES

TRUSTED = 0.95
ROPE_SPEED = 10.0
"""Speed at which practical equivalence of gamma is meant as a share of the force, mm/s."""


def sentence(
    sides: tuple[str, str],
    name: str,
    band: Sequence[float],
    settled: Mapping[str, bool],
    n: tuple[int, int],
    equivalence: tuple[float, float],
    decide: tuple[float, int],
) -> str:
    """Say how two sides differ in one quantity, how sure that is, and what would decide.

    Parameters
    ----------
    sides : tuple of str
        Names.
    name : str
        Quantity.
    band : sequence of float
        5, 50 and 95 % of the quotient or difference.
    settled : mapping of str to bool
        Whether each prior of the spread gives the direction.
    n : tuple of int
        Devices.
    equivalence : tuple of float
        Half-width of the region of practical equivalence, and its probability.
    decide : tuple of (float, int)
        Power at the edge of practical equivalence, and devices a side that would find a difference of that size.
    """
    q05, q50, q95 = band
    quantity = QUANTITIES[name]
    if quantity.logarithmic:
        size = f"is {q50:.2f} times that of {sides[1]} (90 % interval {q05:.2f} to {q95:.2f})"
        open_ = f"a factor of anything from {q05:.2f} to {q95:.2f}"
        edge = f"{100 * equivalence[0]:.0f} %"
    else:
        unit = quantity.unit
        size = f"differs from {sides[1]} by {q50:+.3g} {unit} (90 % interval {q05:+.3g} to {q95:+.3g})"
        open_ = f"anything from {q05:+.3g} to {q95:+.3g} {unit}"
        edge = f"{equivalence[0] / ROPE_SPEED:.3g} {unit}"
    if not settled["default"]:
        verdict = f"the direction is not settled: {open_} is compatible with them"
    elif not all(settled.values()):
        against = ", ".join(ASSUMED.get(label, f"under the {label} prior") for label, yes in settled.items() if not yes)
        verdict = f"the direction hangs on what is assumed of the spread (not settled {against})"
    else:
        verdict = "the direction is settled at 90 %, whatever is assumed of the spread"
    text = f"{sides[0]}: {name} of a typical device {size}; with {n[0]} and {n[1]} devices {verdict}."
    if equivalence[1] > TRUSTED:
        return f"{text} They differ by less than {edge} with a probability of {equivalence[1]:.2f}."
    if all(settled.values()):
        return text
    chance, needed = decide
    count = f"about {needed}" if needed < MOST else f"more than {MOST}"
    return (
        f"{text} A sample of this size finds a true difference of {edge}, the smallest that matters here, with a "
        f"power of {chance:.2f}; a power of 0.80 takes {count} devices a side (if sets spread nearly alike)."
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
