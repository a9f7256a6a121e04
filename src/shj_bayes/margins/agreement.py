"""Do the lower and upper bounds of one sheet agree with each other? What was compared is said in words."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from shj_bayes.margins.bounds import FORCES
from shj_bayes.margins.row import BANDS, FACTORS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.model.parameters import base_of

SLACK = 0.02
"""Share of the typical value by which two numbers may differ before they count as contradicting: noise of draws."""


@dataclass(frozen=True)
class Agreement:
    """What was compared, and what contradicts."""

    words: str  # what was compared with what, in one sentence
    contradictions: tuple[str, ...]  # one sentence each, with both numbers; empty where everything agrees


def agreement(rows: Sequence[Margin]) -> Agreement:
    """Compare the bounds of every set with each other and with the bands of a new device."""
    names = list(dict.fromkeys(row.set_name for row in rows))
    found = [text for name in names for text in _of_set(name, [row for row in rows if row.set_name == name])]
    sets = f"{len(names)} set{'s' * (len(names) != 1)}"
    words = (
        f"Compared in {sets}: each lower bound force (ASCE 7, LBDP) with the 5 % ends, and each upper bound "
        "force (ASCE 7, UBDP) with the 95 % ends, of the smallest plateau, mean plateau, third cycle and largest force "
        "of every run; lower with upper bounds; low, middle and high value of every other margin. "
        + (f"{len(found)} contradict." if found else "None contradict.")
    )
    return Agreement(words, tuple(found))


def _of_set(name: str, rows: Sequence[Margin]) -> Iterator[str]:
    forces = [row for row in rows if row.method == FACTORS and row.unit == "kN"]  # that codes bound by factors
    lower, upper = ([row for row in forces if row.side == side] for side in (LOW, HIGH))
    scale = max((abs(row.value) for row in rows if row.quantity == "third" and row.side == MIDDLE), default=0.0)
    ends = [row for row in rows if row.method == BANDS and base_of(row.quantity) in FORCES]
    for bound in lower:
        for end in (*(e for e in ends if e.side == LOW), *upper):
            yield from _above(name, bound, end, scale)
    for bound in upper:
        for end in ends:
            if end.side == HIGH:
                yield from _above(name, end, bound, scale)
    ladder: dict[tuple[str, str], dict[str, Margin]] = {}
    for row in rows:
        kind = "new device" if row.method == BANDS else row.kind
        ladder.setdefault((row.quantity, kind), {})[row.side] = row
    for steps in ladder.values():
        ordered = [steps[side] for side in (LOW, MIDDLE, HIGH) if side in steps]
        for a, b in pairwise(ordered):
            yield from _above(name, a, b, abs(a.value))


def _above(name: str, lesser: Margin, greater: Margin, scale: float) -> Iterator[str]:
    """Say so where what should be the lesser lies above; NaN, which stands for no value, contradicts nothing."""
    if lesser.value > greater.value + SLACK * scale:
        yield (
            f"CONTRADICTION, {name}: {lesser.kind} ({lesser.quantity}, {lesser.value:.4g} {lesser.unit}) lies above "
            f"{greater.kind} ({greater.quantity}, {greater.value:.4g} {greater.unit}). Use neither before it is settled"
        )
