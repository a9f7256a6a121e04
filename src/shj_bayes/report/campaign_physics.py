"""What the devices of each set have in common, in words and numbers."""

from collections.abc import Iterable
from typing import Any

from shj_bayes.mismatch.hypothesis import ALPHA, MIN_EFFECT
from shj_bayes.report.diagnosis_words import over_words, percent
from shj_bayes.results.campaign import SetTogether, SharedDependence
from shj_bayes.results.diagnosis import DependenceId

ALL = "all devices of the campaign"
# Where a coordinate is no quantity that varies.
PLAIN = {
    DependenceId("added", "constant"): "a constant force beside friction",
    DependenceId("capacity", "direction"): "another force in push than in pull",
}
ACTS = {"capacity": "Sliding force", "added": "Added force", "motion": "Motion"}
NUMBERS = ("None", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten")


def certain(one: SharedDependence) -> bool:
    """Whether something is said of a class: the set has it, or it or a rival, with 95 %."""
    return bool(one.holders) and (one.enters or one.probability >= 1.0 - ALPHA)


def statements(together: Iterable[SetTogether]) -> tuple[str, ...]:
    """Say what each set of two devices or more has in common."""
    out = []
    for group in together:
        if group.classes and len(group.devices) > 1:
            said = [statement(one, group.set) for one in group.classes if certain(one)]
            out += said or [f"Nothing beyond the law is certain to be common to {set_words(group.set)}."]
    return tuple(out)


def statement(row: SharedDependence, set_name: str) -> str:
    """Say of one class what a set has in common, how much, how surely, and what it may be instead."""
    has, n, of_class = row.holders, len(row.alone), row.id
    changes = [row.change_percent[i] for i in has]
    sizes = [row.size_percent[i] or 0.0 for i in has]
    known = [c for c in changes if c is not None]
    one_way = len(known) == len(has) and len({c > 0 for c in known}) == 1
    # A curve that only rises or falls changes by more from end to end than can be seen beside the law.
    one_way = one_way and all(abs(c) >= s for c, s in zip(known, sizes, strict=True))
    of = f"devices of set {set_name}" if set_name else "devices of the campaign"
    who = f"{_count(len(has))} of {_count(n).lower()} {of}"
    where = over_words(row.coordinate)
    if row.action == "capacity" and one_way:
        verb = "gain" if known[0] > 0 else "lose"
        text = f"{who} {verb} sliding force with {where}: {_span(map(abs, known))} of Fy over what was tested"
    elif of_class in PLAIN or row.action == "motion":
        text = f"{who} show {PLAIN.get(of_class, where)}: up to {_span(sizes)} of Fy"
    else:
        what = "sliding force" if row.action == "capacity" else "force that is added"
        text = f"{who} have a {what} that depends on {where}: {_span(sizes)} of Fy"
    alone = sum(row.alone)
    shows = "each shows it alone" if alone == n else f"{_count(alone).lower()} shows it alone"
    shows = shows if alone <= 1 or alone == n else f"{_count(alone).lower()} show it alone"
    text += f" (probability {percent(row.probability)}; {shows})."
    if row.rivals:
        others = ", ".join(class_words(DependenceId.read(word)) for word in row.rivals)
        text += f" Their tests do not tell it from {others}."
    if max(sizes) < 100.0 * MIN_EFFECT:
        text += (
            f" In none of them can more than {100 * MIN_EFFECT:g} % of Fy be seen beside the law: little for design."
        )
    return text


def class_words(one: DependenceId) -> str:
    """Name a class."""
    if one in PLAIN:
        return PLAIN[one]
    over = over_words(one.coordinate)
    return f"{ACTS[one.action].lower()} over {over}" if one.action in ("capacity", "added") else over


def set_words(set_name: str) -> str:
    """Name the devices of a set, or all."""
    return f"the devices of set {set_name}" if set_name else ALL


def table(together: Iterable[SetTogether]) -> dict[str, Any] | None:
    """Tabulate every class that is not excluded in some set, or that a device shows alone; None without diagnoses."""
    groups = [group for group in together if group.classes]
    by_class: dict[DependenceId, dict[str, SharedDependence]] = {}
    for group in groups:
        for shared in group.classes:
            by_class.setdefault(shared.id, {})[group.set] = shared
    kept, excluded = [], dict[str, list[str]]()  # classes by what they act on
    for key in sorted(by_class, key=str):
        rows = by_class[key].values()
        if any(row.probability >= ALPHA or any(row.alone) for row in rows):
            kept.append((max(row.probability for row in rows), key))
        else:
            word = PLAIN.get(key) or over_words(key.coordinate)
            excluded.setdefault(ACTS.get(key.action, key.action), []).append(word)
    kept.sort(key=lambda found: -found[0])
    if not groups:
        return None
    return {
        "sets": [{"name": group.set or ALL, "n": len(group.devices)} for group in groups],
        "classes": [
            {"words": class_words(key), "cells": [by_class[key].get(group.set) for group in groups]} for _, key in kept
        ],
        "excluded": excluded,
    }


def _count(n: int) -> str:
    return NUMBERS[n] if n < len(NUMBERS) else str(n)


def _span(values: Iterable[float]) -> str:
    """Give the range of some percentages."""
    own = sorted(values)
    low, high = f"{own[0]:.2g}", f"{own[-1]:.2g}"
    return f"{low} %" if low == high else f"{low} to {high} %"
