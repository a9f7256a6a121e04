"""What the devices of each set have in common, in words and numbers, from ``campaign.json``."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from shj_bayes.errors import ReportError, shown
from shj_bayes.mismatch.class_id import ClassId
from shj_bayes.mismatch.classes import DOUBT, MATTERS
from shj_bayes.mismatch.sets import LIKELY
from shj_bayes.report.campaign_file import safe_folder
from shj_bayes.report.diagnosis_words import over_words, percent

ALL = "all devices of the campaign"
# Where a coordinate is no quantity that varies.
PLAIN = {
    ClassId("added", "constant"): "a constant force beside friction",
    ClassId("capacity", "direction"): "another force in push than in pull",
}
ACTS = {"capacity": "Sliding force", "added": "Added force", "motion": "Motion"}
NUMBERS = ("None", "One", "Two", "Three", "Four", "Five", "Six", "Seven", "Eight", "Nine", "Ten")


@dataclass(frozen=True)
class Row:
    """A class of coordinates in a set."""

    set_name: str  # the set; empty for all devices of the campaign
    folders: tuple[str, ...]  # folders of its diagnosed devices
    action: str
    coordinate: str
    unit: str
    probability: float  # that the set has it
    enters: bool  # whether models of its devices hold it
    rivals: tuple[ClassId, ...]  # classes that may stand in its place
    of_devices: tuple[float, ...]  # that each device has it
    alone: tuple[bool, ...]  # whether each device shows it alone
    effects: tuple[str, ...]  # effect that stands, or would stand, for it in each
    # size_percent, change_percent: size in each, and its change from one end of the coordinate to the other, per cent
    # of Fy
    size_percent: tuple[float | None, ...]
    change_percent: tuple[float | None, ...]

    def __post_init__(self) -> None:
        """Refuse what does not belong together."""
        lists = (self.of_devices, self.alone, self.effects, self.size_percent, self.change_percent)
        if any(len(one) != len(self.folders) for one in lists) or not all(map(safe_folder, self.folders)):
            raise ValueError(f"{self.id} of {shown(self.set_name)}")

    @property
    def id(self) -> ClassId:
        """The class."""
        return ClassId(self.action, self.coordinate)

    @property
    def holders(self) -> tuple[int, ...]:
        """Places of the devices that have it, more probably than not."""
        return tuple(i for i, p in enumerate(self.of_devices) if p >= LIKELY)

    @property
    def certain(self) -> bool:
        """Whether something is said of it: the set has it, or it or a rival, with 95 %."""
        return bool(self.holders) and (self.enters or self.probability >= 1.0 - DOUBT)


def rows_of(record: Mapping[str, Any]) -> tuple[Row, ...]:
    """Read from ``campaign.json`` what the devices of each set have in common; `ReportError` where that fails."""
    try:
        return tuple(_rows(record.get("together", ())))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ReportError(f"campaign.json: what sets have in common cannot be read ({error})") from error


def _rows(groups: Any) -> Iterator[Row]:
    def numbers(values: Any) -> tuple[float | None, ...]:
        return tuple(None if value is None else float(value) for value in values)

    for group in groups:
        for one in group["classes"]:
            yield Row(
                str(group["set"]),
                tuple(str(folder) for folder in group["devices"]),
                str(one["action"]),
                str(one["coordinate"]),
                str(one["unit"]),
                float(one["probability"]),
                bool(one["enters"]),
                tuple(map(ClassId.read, one["rivals"])),
                tuple(float(p) for p in one["of_devices"]),
                tuple(bool(found) for found in one["alone"]),
                tuple(str(word) for word in one["effects"]),
                numbers(one["size_percent"]),
                numbers(one["change_percent"]),
            )


def statements(record: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Say what each set of two devices or more has in common; nothing where no device was diagnosed."""
    rows = [row for row in rows_of(record or {}) if len(row.folders) > 1]
    out = []
    for name in dict.fromkeys(row.set_name for row in rows):
        own = [row for row in rows if row.set_name == name]
        said = [statement(row) for row in own if row.certain]
        out += said or [f"Nothing beyond the law is certain to be common to {set_words(own[0])}."]
    return tuple(out)


def statement(row: Row) -> str:
    """Say of one class what a set has in common, how much, how surely, and what it may be instead."""
    has, n = row.holders, len(row.folders)
    changes = [row.change_percent[i] for i in has]
    sizes = [row.size_percent[i] or 0.0 for i in has]
    known = [c for c in changes if c is not None]
    one_way = len(known) == len(has) and len({c > 0 for c in known}) == 1
    # A curve that only rises or falls changes by more from end to end than can be seen beside the law.
    one_way = one_way and all(abs(c) >= s for c, s in zip(known, sizes, strict=True))
    of = f"devices of set {row.set_name}" if row.set_name else "devices of the campaign"
    who = f"{_count(len(has))} of {_count(n).lower()} {of}"
    where = over_words(row.coordinate)
    if row.action == "capacity" and one_way:
        verb = "gain" if known[0] > 0 else "lose"
        text = f"{who} {verb} sliding force with {where}: {_span(map(abs, known))} of Fy over what was tested"
    elif row.id in PLAIN or row.action == "motion":
        text = f"{who} show {PLAIN.get(row.id, where)}: up to {_span(sizes)} of Fy"
    else:
        what = "sliding force" if row.action == "capacity" else "force that is added"
        text = f"{who} have a {what} that depends on {where}: {_span(sizes)} of Fy"
    alone = sum(row.alone)
    shows = "each shows it alone" if alone == n else f"{_count(alone).lower()} shows it alone"
    shows = shows if alone <= 1 or alone == n else f"{_count(alone).lower()} show it alone"
    text += f" (probability {percent(row.probability)}; {shows})."
    if row.rivals:
        others = ", ".join(map(class_words, row.rivals))
        text += f" Their tests do not tell it from {others}."
    if max(sizes) < 100.0 * MATTERS:
        text += f" In none of them can more than {100 * MATTERS:g} % of Fy be seen beside the law: little for design."
    return text


def class_words(one: ClassId) -> str:
    """Name a class."""
    if one in PLAIN:
        return PLAIN[one]
    over = over_words(one.coordinate)
    return f"{ACTS[one.action].lower()} over {over}" if one.action in ("capacity", "added") else over


def set_words(row: Row) -> str:
    """Name the devices that a row speaks of."""
    return f"the devices of set {row.set_name}" if row.set_name else ALL


def table(record: Mapping[str, Any]) -> dict[str, Any] | None:
    """Tabulate every class that is not excluded in some set, or that a device shows alone; None without diagnoses."""
    rows = rows_of(record)
    if not rows:
        return None
    names = list(dict.fromkeys(row.set_name for row in rows))
    by_class: dict[ClassId, dict[str, Row]] = {}
    for row in rows:
        by_class.setdefault(row.id, {})[row.set_name] = row
    kept = {
        one: own
        for one, own in by_class.items()
        if any(row.probability >= DOUBT or any(row.alone) for row in own.values())
    }
    order = sorted(kept, key=lambda one: (-max(row.probability for row in kept[one].values()), str(one)))
    return {
        "sets": [
            {"name": name or ALL, "n": next(len(r.folders) for r in rows if r.set_name == name)} for name in names
        ],
        "classes": [{"words": class_words(one), "cells": [kept[one].get(name) for name in names]} for one in order],
        "excluded": _by_action([one for one in sorted(by_class, key=str) if one not in kept]),
    }


def _by_action(classes: Iterable[ClassId]) -> dict[str, list[str]]:
    """Name classes by what they act on."""
    out: dict[str, list[str]] = {}
    for one in classes:
        word = PLAIN.get(one) or over_words(one.coordinate)
        out.setdefault(ACTS.get(one.action, one.action), []).append(word)
    return out


def _count(n: int) -> str:
    return NUMBERS[n] if n < len(NUMBERS) else str(n)


def _span(values: Iterable[float]) -> str:
    """Give the range of some percentages."""
    own = sorted(values)
    low, high = f"{own[0]:.2g}", f"{own[-1]:.2g}"
    return f"{low} %" if low == high else f"{low} to {high} %"
