"""The page of one device."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.files import damage_told
from shj_bayes.errors import ReportError
from shj_bayes.model.device import meaning_of
from shj_bayes.model.law import variant_named
from shj_bayes.model.parameters import base_of
from shj_bayes.population.quantities import LEVELS
from shj_bayes.report import words
from shj_bayes.report.browse import device_viewer, thinning_words
from shj_bayes.report.figures.device import draw
from shj_bayes.report.numbers import Beforehand, DeviceFigures, left_over, numbers_of
from shj_bayes.report.page import LOOPS, PAGE, write_page
from shj_bayes.report.words import ForceUnit, force_unit
from shj_bayes.results.device import DeviceData, read_device
from shj_bayes.results.diagnosis import LeftOver
from shj_bayes.results.fit import FitRecord, ParameterRow, Trust
from shj_bayes.results.store import diagnosis_in, write


def render_device(folder: Path) -> Path:
    """Write ``report.html`` of a finished fit, one file that needs nothing else.

    `InferenceError` or `ReportError` where the folder holds no readable fit.
    """
    with damage_told(f"fit.json or posterior.nc in {folder.name}", ReportError):
        device = read_device(folder)
        numbers, left = numbers_of(device), left_over(device, folder)
        viewer = device_viewer(device, numbers)
        moving = {"pictures": draw(device, numbers), "viewer": viewer, "thinning": thinning_words(viewer)}
        filled = content(device, numbers, left) | moving
        filled["diagnosis"] = f"{diagnosis_in(folder)}/diagnosis.html" if left.diagnosed else ""
        write(left, folder)
        return write_page(folder, "device.html", filled, LOOPS, name=PAGE)


def content(device: DeviceData, numbers: DeviceFigures, left: LeftOver) -> dict[str, Any]:
    """Everything on the page but the pictures, as plain values."""
    record, unit = device.record, force_unit(device.record)
    units = {row.name: unit.of(row.unit) for row in record.parameters}
    rows = list(map(unit.row, record.parameters))
    gamma = record.parameter("gamma") or record.parameter("velocity.size")
    peaks = [float(e.peak_speed_mm_s.max()) for e in numbers.cycles if e.peak_speed_mm_s.size]
    peak = numbers.one_speed or max(peaks, default=float(max(run.speed_mm_s.max() for run in device.runs)))
    return {
        "name": record.device,
        "simulated": any(entry.simulated for entry in record.inputs),
        "badges": badges(record, left),
        "remarks": [words.remark(r, *units[r.parameter], family=record.model.priors) for r in record.remarks],
        "doubtful": left.grade in ("fair", "poor") and not left.diagnosed,
        "cards": cards(record, rows, numbers.one_speed is not None),
        "rows": [
            vars(row)
            | {
                "meaning": meaning_of(row.name).meaning,
                "unknown": row.name in record.undetermined,
                "speed": base_of(row.name) == "gamma",
            }
            for row in rows
        ],
        "alias": words.alias_words(numbers.one_speed),
        "speed": words.speed_words(gamma, peak),
        "peak_speed": words.short(peak),
        "runs": run_rows(device, unit),
        "findings": [vars(f) | {"run": i} for i, entry in enumerate(record.inputs, start=1) for f in entry.findings],
        "energy": energy_words(numbers),
        "losses": loss_words(device, numbers),
        "left": left,
        "law_width": unit.factor * max(band.law_width_kN for band in numbers.bands),
        "friction": any("tension" in run.extras for run in device.runs),
        "freed": freed_words(device),
        "before": before_words(numbers.before, unit),
        "force_unit": unit.name,
        "priors": [
            (law, *unit.of(law.unit), np.quantile(device.prior[law.name], LEVELS), after)
            for law in record.prior_laws
            for after in rows
            if after.name == law.name
        ],
        "made": _day(record.created),
        "model": replace(record.model, variant=variant_named(record.model.variant)),
        "record": record,
    }


def loss_words(device: DeviceData, numbers: DeviceFigures) -> list[str]:
    """Say how much of the sliding force was lost from the first run to each later one, and over which travel."""
    out, travel = [], [run.travel_m for run in device.runs]
    for number, (low, middle, high) in numbers.losses.items():
        metres = sum(travel[: number - 1])
        before = "in the first" if number == 2 else "in the runs before it"
        out.append(
            f"From run 1 to run {number} the sliding force fell by {middle:.1f} % (90 % interval {low:.1f} to "
            f"{high:.1f} %; a negative number is a gain), after {metres:.3g} m of travel {before}: "
            f"{middle / metres:.2g} % per metre."
        )
    return out


def freed_words(device: DeviceData) -> list[str]:
    """Say of each parameter that the runs have for themselves whether it changed between them."""
    out = []
    for name, later in device.draws.items():
        base, _, run = name.partition("_")
        if base not in ("K", "beta", "gamma") or not run:
            continue
        change, none, unit, how = later / device.draws[base], 1, "", "over"
        if base == "gamma":
            change, none, unit, how = later - device.draws[base], 0, " s/mm", "less"
        low, high = np.quantile(change, [0.05, 0.95])
        verdict = f"no change ({none}) is outside it: {base} changed between the runs"
        if low <= none <= high:
            verdict = f"no change ({none}) is within it: this test does not show that {base} changed"
        between = f"{words.short(low)} to {words.short(high)}{unit}"
        out.append(f"{base}, run {run} {how} run 1: 90 % interval {between}; {verdict}.")
    return out


def badges(record: FitRecord, left: LeftOver) -> list[dict[str, str]]:
    """Two verdicts, since neither says anything of the other: of the calculation, and of the model."""
    word = record.convergence or record.verdict
    name, colour, sentence = words.CONVERGENCE[word]
    if (word, record.verdict) == (Trust.RELIABLE, Trust.TENTATIVE):
        sentence += words.SCATTER
    (grade, shade), said = words.FIT[left.grade], words.fit_words(left)
    model = words.left_words(left, record.model.effects)
    return [
        {"what": "Convergence", "name": name, "colour": colour, "words": sentence},
        {"what": "Model", "name": f"{grade}: {said}", "colour": shade, "words": model},
    ]


def cards(record: FitRecord, rows: list[ParameterRow], one_speed: bool) -> list[dict[str, str]]:
    """Give the numbers that matter, for the first screen; of what the data do not determine, no number."""
    out, by_name = [], {row.name: row for row in rows}
    for name in ("K", "Fy", "beta", "gamma", "ratio"):
        row = by_name.get(name)
        if row is None:
            continue
        card = dict.fromkeys(("exact", "unit", "interval", "note"), "")
        card |= {"name": name, "meaning": meaning_of(name).meaning, "value": "not determined"}
        if name not in record.undetermined:
            note = words.dep_words(row.q05, row.q95) if name == "gamma" else ""
            card |= {"unit": "" if row.unit == "1" else row.unit, "interval": words.interval(row)}
            card |= {"value": words.rounded(row.q50, row.sd), "exact": repr(row.q50)}
            card["note"] = note + ("; one peak speed only: it may be place, not speed" if note and one_speed else "")
        out.append(card)
    return out


def run_rows(device: DeviceData, unit: ForceUnit) -> list[dict[str, Any]]:
    """Each recording, for the table of what was tested."""
    out = []
    for run, entry in zip(device.runs, device.record.inputs, strict=True):
        x, force, zero = run.displacement_mm, unit.factor * run.force_kN, entry.zero_error_kN
        row = vars(entry) | {"number": run.number, "unused": entry.n_samples - int(np.count_nonzero(run.used))}
        row |= {"stroke_mm": (x.min(), x.max()), "force": (force.min(), force.max()), "zero": ""}
        if zero is not None:  # results of earlier versions do not state it
            mean, sd = unit.factor * zero.mean, unit.factor * zero.sd
            row["zero"] = f"the load cell reads {mean:+.2g} ± {sd:.1g} {unit.name} at no load"
        out.append(row)
    return out


def energy_words(numbers: DeviceFigures) -> str:
    """How well the energy is predicted."""
    n = sum(e.measured_J.size for e in numbers.cycles)
    if n == 0:
        return "The recording holds no full cycle from mid-stroke to mid-stroke, so no energy per cycle is given."
    outside = sum(e.n_outside for e in numbers.cycles)
    measured = sum(float(e.measured_J.sum()) for e in numbers.cycles)
    error = 100 * (sum(float(e.median_J.sum()) for e in numbers.cycles) / measured - 1)
    shown = f"{measured / 1000:.4g} kJ" if measured >= 1000 else f"{measured:.4g} J"
    said = "the same to within 0.1 %" if abs(error) < 0.1 else f"{abs(error):.1f} % {'more' if error > 0 else 'less'}"
    return (
        f"The {n} full cycles dissipated {shown}; the model predicts {said}. {outside} of {n} cycles lie "
        f"outside their 90 % band; about {max(1, round(0.1 * n))} would by chance."
    )


def before_words(b: Beforehand, unit: ForceUnit) -> str:
    """Say what the priors allow, beside what was found."""
    k, n = unit.factor, b.paper_kN.shape[0]
    text = (
        f"One cycle of {words.short(b.amplitude_mm)} mm at a peak speed of {words.short(b.peak_speed_mm_s)} mm/s. "
        f"Before the test, the largest force was held to lie between {words.short(k * b.prior_range_kN[0])} and "
        f"{words.short(k * b.prior_range_kN[1])} {unit.name} (90 %); after it, between "
        f"{k * b.posterior_range_kN[0]:.4g} and {k * b.posterior_range_kN[1]:.4g} {unit.name}."
    )
    if n:
        reached = k * np.abs(b.paper_kN).max(axis=1)
        text += (
            f" The published devices of Tables 3 to 7 would reach {words.short(reached.min())} to "
            f"{words.short(reached.max())} {unit.name}: "
            f"{'all' if b.paper_inside == n else b.paper_inside} of their {n} loops lie within the central "
            "98 % of what the priors allow, so the priors leave room for devices of this kind."
        )
    return text


def _day(stamp: str) -> str:
    """Date and time as one reads them; the stamp itself where it is none."""
    try:
        return f"{datetime.fromisoformat(stamp).astimezone(UTC):%d %B %Y, %H:%M} UTC"
    except ValueError:
        return stamp
