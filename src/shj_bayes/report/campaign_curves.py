"""Curves of devices over the coordinates that their sets have in common. Importing this imports matplotlib."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from shj_bayes.errors import ShjError
from shj_bayes.model.curve import curve_named
from shj_bayes.report.campaign_physics import certain, class_words, set_words, statement
from shj_bayes.report.diagnosis_words import along_words
from shj_bayes.report.figures import population as figures
from shj_bayes.report.figures.population import DeviceCurve
from shj_bayes.report.page import Picture
from shj_bayes.results.campaign import WITH_SET, SetTogether, SharedDependence
from shj_bayes.results.device import DeviceResult
from shj_bayes.results.diagnosis import DependenceId, DiagnosisRecord
from shj_bayes.results.store import DIAGNOSIS, read

PLACES = 61  # of a curve
Panel = tuple[str, SharedDependence, list[DeviceCurve]]  # set, class, curves of its devices
MOST = 40  # curves in a panel, and panels in a picture


def pictures(folder: Path, together: Sequence[SetTogether], with_set: Mapping[str, bool]) -> list[Picture]:
    """Draw one picture for each class that some set has: a panel for each set, a curve for each device.

    `with_set` says, for the folder of each device, whether it has a usable fit with what its set has.
    """
    by_class: dict[DependenceId, list[Panel]] = {}
    for group in together:
        for row in group.classes if group.set else ():
            if not certain(row) or row.action == "motion":
                continue
            places = [(i, group.devices[i]) for i in row.holders[:MOST]]
            curves = [c for i, at in places if (c := _curve(folder / at, row, i, with_set[at])) is not None]
            if curves:
                by_class.setdefault(row.id, []).append((group.set, row, curves))
    return [_picture(parts[:MOST]) for parts in by_class.values()]


def _picture(parts: Sequence[Panel]) -> Picture:
    first = parts[0][1]
    over = along_words(first.coordinate).removeprefix("the ")
    unit = "" if first.unit == "1" else f" ({first.unit})"
    what = class_words(first.id)
    drawn = figures.curves([(name, curves) for name, _, curves in parts], f"{over}{unit}")
    who = ", ".join(set_words(name) for name, *_ in parts)
    said = " ".join(statement(row, name) for name, row, _ in parts)
    alt = f"Change of the {what}, per cent of Fy, for each device of {who}."
    return Picture(drawn, alt, said, f"Change of the {what}", wide=True)


def _curve(place: Path, row: SharedDependence, i: int, with_set: bool) -> DeviceCurve | None:
    """Curve of a device: of its fit with what its set has, or of its diagnosis; None where neither holds one."""
    try:
        if with_set and curve_named(row.effects[i]) is not None:
            return _of_fit(place, row.effects[i], alone=row.alone[i])
        return _of_diagnosis(place / DIAGNOSIS, row)
    except (ShjError, OSError, KeyError, TypeError, ValueError):  # a damaged file: the page goes without that curve
        return None


def _of_fit(place: Path, effect: str, *, alone: bool) -> DeviceCurve | None:
    """Curve of a device's fit with what its set has, from its posterior; None where that does not hold it."""
    curve, fit = curve_named(effect), DeviceResult.read(place / WITH_SET)
    if curve is None or curve.sides or effect not in fit.record.model.effects:
        return None
    history = DeviceResult.read(place).histories[0]
    coefficients = np.stack([fit.draws[f"{effect}.c{k}"] for k in range(1, curve.n + 1)])
    share = np.linspace(0.0, 1.0, PLACES)
    values = 100.0 * curve.rows(share, np.ones(PLACES)) @ coefficients
    low, high = np.quantile(values, [0.05, 0.95], axis=1)
    return DeviceCurve(curve.over.value_of(share, history), values.mean(axis=1), low, high, alone)


def _of_diagnosis(place: Path, row: SharedDependence) -> DeviceCurve | None:
    """Curve that the diagnosis of a device found."""
    for one in read(DiagnosisRecord, place).coordinates:
        if (one.action, one.coordinate, one.direction) == (row.action, row.coordinate, "both") and one.curve:
            curve = one.curve
            at, mean, low, high = map(np.array, (curve.at, curve.mean, curve.q05, curve.q95))
            return DeviceCurve(at, mean, low, high, alone=True)
    return None
