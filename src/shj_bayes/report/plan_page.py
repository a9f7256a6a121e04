"""The page of a plan, its pictures and its summary in words: what to run next, and what it would tell."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.model.history import histories
from shj_bayes.planning.information import WHICH
from shj_bayes.planning.plan import Plan, PlanRecord, WorthOfTest
from shj_bayes.planning.rivals import ASSURANCE, WITHIN, PretestPosterior, mechanisms_of
from shj_bayes.report.diagnosis_words import over_words
from shj_bayes.report.figures.canvas import BLUE, PALE, RED, WIDE, Figure, alike, drawn, label, sheet, svg
from shj_bayes.report.page import write_page

MOST = 6000  # points of a line


def render_plan(folder: Path, record: PlanRecord, plan: Plan | None) -> Path:
    """Write ``plan.html`` from the content of ``plan.json``; the plan itself is for the pictures of a next test."""
    content = {
        "names": ", ".join(d.name for d in record.devices),
        "headline": headline(record),
        "lines": lines(record),
        "record": record,
        "set_words": set_words,
        "pictures": _devices(record) if plan is None else _pictures(plan),
    }
    return write_page(folder, "plan.html", content)


def headline(record: PlanRecord) -> str:
    """Give the answer in one sentence."""
    if record.further_devices:
        n = record.further_devices.n_further
        words = {
            None: "No affordable number of further devices makes the 5 % force known to 5 %: they differ too much.",
            0: "The 5 % force is known to 5 % already.",
        }
        chance = f"with a chance of {100 * ASSURANCE:.0f} %"
        return words.get(n, f"{n} further devices make the 5 % force known to 5 %, {chance}.")
    if record.worth == WorthOfTest.DECIDED:
        p = record.now.largest_probability or 0.0
        return f"No test is needed for this question: it is decided already ({100 * p:.3g} %)."
    if not record.candidates:
        return "No protocol keeps to the limits of the rig; raise the limit that each breaks."
    best = record.candidates[0]
    if record.worth == WorthOfTest.LITTLE:
        return (
            "No test within these limits is worth its time for this question; another limit (speed, time) or another "
            "question may be."
        )
    if record.question == WHICH:
        gives = f"it is expected to name the right one with a chance of {100 * best.chance_right:.3g} %"
    else:
        now = record.now
        gives = f"it should take the standard deviation of {record.question} from {now.sd:.3g} to {best.sd:.3g}"
        gives += f" {now.unit}"
    return f"Run {best.file}, {best.minutes:.1f} minutes on the rig: {gives}."


def lines(record: PlanRecord) -> list[str]:
    """Sentences below the headline."""
    if f := record.further_devices:
        return [
            f"From {f.n_tested} devices: 95 % of devices exceed {f.force_kN:.4g} kN, known to "
            f"{100 * f.half_width_now:.3g} % (half of the 90 % interval).",
            f"Devices differ by {100 * f.spread:.3g} % (standard deviation).",
            f"Wanted: {100 * WITHIN:.0f} %.",
        ]
    out = []
    if record.question == WHICH:
        for d in record.devices:
            listed = "; ".join(f"{set_words(s.classes, s.mechanisms)} {100 * s.probability:.3g} %" for s in d.sets[:4])
            out.append(f"{d.name}: {listed}.")
    for d in record.devices:
        for c in d.channels or ():
            value = f"{c.value:.4g} {c.unit}".strip()
            out.append(
                f"{d.name}: {over_words(c.coordinate)} is taken to stay at {value}, its median so far, in the "
                "planned test. Record it again: a test in which it changes on its own tells most of it."
            )
    if record.worth == WorthOfTest.YES and record.candidates:
        table = record.compared[0]
        if record.question == WHICH:
            out.append(
                f"{table.name} ({table.minutes:.1f} minutes) names it with a chance of "
                f"{100 * table.chance_right:.3g} %."
            )
        else:
            out.append(f"{table.name} ({table.minutes:.1f} minutes) takes it to {table.sd:.3g}.")
    return out


def plan_text(record: PlanRecord) -> str:
    """Give the summary for the terminal."""
    rows = [headline(record), *(f"  {line}" for line in lines(record))]
    if record.candidates or record.compared:
        head = f"{'protocol':44} {'min':>6} {'gain':>8} {'per min':>8} {'apart':>8} {'right':>7}"
        rows += ["", f"  {head}"]
        for r in (*record.candidates, *record.compared):
            mark = "  (outside the limits)" if r.limits_broken else ""
            rows.append(
                f"  {r.name[:44]:44} {r.minutes:6.1f} {r.gain_nats:8.3f} {r.gain_per_minute:8.3f} "
                f"{r.apart_nats:8.1f} {100 * r.chance_right:6.1f}%{mark}"
            )
    return "\n".join(rows)


def set_words(classes: Sequence[str], mechanisms: Sequence[str]) -> str:
    """Say what a set of classes is."""
    if not classes:
        return "nothing beyond the base law"
    names = " or ".join(m.replace("_", " ") for m in mechanisms)
    where = ", ".join(classes)
    return f"{names} ({where})" if names else where


def _pictures(plan: Plan) -> dict[str, Any]:
    """Displacement over time, predicted loops of the two leading rivals, and where they differ."""
    if not plan.best:
        return {}
    known, protocol = plan.known[0], plan.best[0]
    time, motion = protocol.sampled(plan.rig.rate_Hz)
    thin = slice(None, None, max(1, time.size // MOST))
    t, x = time[thin], motion.displacement_mm[thin]
    figure = Figure(WIDE, 302, (3, 1))
    top, low = figure.axes
    top.plot(t, x, color=BLUE, linewidth=1.0)
    low.plot(t, motion.speed_mm_s[thin], linewidth=0.8)
    alike(figure.axes, x=True)
    top.x_numbers = 0
    label(top, "", "displacement (mm)")
    label(low, "time (s)", "speed (mm/s)")
    out: dict[str, Any] = {"history": svg(figure), "protocol": protocol}
    leading = [next(b for b in known.rivals if b.key == key) for key in known.keys[:2]]
    if len(leading) < 2 or not known.runs:  # before any test a curve is as likely above 0 as below it: no loop to draw
        return out
    placed = known.placed(histories([time], [motion])[0])
    forces = [b.model.force(b.model.laws.natural(b.z[None]), placed, 0.0)[0] for b in leading]
    names = [set_words(sorted(b.key), mechanisms_of(b.key)) for b in leading]
    figure = Figure(WIDE, 288, columns=2, top=22)
    for axes, force, other, colour, name in zip(figure.axes, forces, reversed(forces), (BLUE, RED), names, strict=True):
        axes.plot(x, other[thin], color=PALE, linewidth=0.8)
        axes.plot(x, force[thin], color=colour, linewidth=0.9)
        axes.title = f"if {name}"
        label(axes, "displacement (mm)", "force (kN)" if axes is figure.axes[0] else "")
    alike(figure.axes, y=True)
    figure.axes[1].rows = ("",)
    out["rivals"] = svg(figure)
    gap, noise = forces[0] - forces[1], _noise(known)
    figure, axes = sheet(WIDE, 202)
    axes.fill([-np.inf, np.inf], -2 * noise, 2 * noise, color=PALE, alpha=0.5, label="noise of a sample, 95 %")
    axes.plot(t, gap[thin], color=BLUE, linewidth=0.9, label="first less second")
    apart = drawn(figure, "time (s)", "difference (kN)", 2)
    return out | {"apart": apart, "names": names, "gap_kN": np.abs(gap).max(), "noise_kN": noise}


def _noise(known: PretestPosterior) -> float:
    """Give the standard deviation of the noise of one sample, kN."""
    model = known.device
    values = model.laws.natural(np.append(np.zeros(model.n_law), known.setting.z)[None])[0, model.n_law :]
    named = dict(zip(model.noise.parameters, values, strict=True))
    return math.hypot(*(float(v) for name, v in named.items() if name.startswith("sigma")))


def _devices(record: PlanRecord) -> dict[str, str]:
    """Half width of the 5 % force over the number of further devices."""
    table = record.further_devices.table if record.further_devices else ()
    if not table:
        return {}
    n = [row["n_further"] for row in table]
    figure, axes = sheet(WIDE, 216)
    axes.across(100 * WITHIN, "--", label="wanted")
    axes.plot(n, [100 * row["half_width_expected"] for row in table], "o-", color=BLUE, size=4, label="typical")
    assured = [100 * row["half_width_assured"] for row in table]
    axes.plot(n, assured, "s-", color=RED, size=4, label="kept with a chance of 80 %")
    return {"devices": drawn(figure, "further devices", "half width (% of the force)", 3)}
