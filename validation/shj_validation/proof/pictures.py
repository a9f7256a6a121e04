"""Pictures of a proof; they only draw what the score holds."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from shj_bayes._util.arrays import FloatArray
from shj_bayes.report.figures.canvas import BLUE, GREY, INK, PALE, RED
from shj_bayes.report.page import Picture
from shj_validation.canvas import WIDE, label, legend, sheet, svg
from shj_validation.proof.answers import Band

MOST_DOTS = 400  # of a picture: a page is kept small
HELD_OUT = 1.5  # the aim for 90 % of the trials


def _plain(axes: Axes) -> None:
    """Write logarithmic axes as plain numbers, at the decades only."""
    for axis in (axes.xaxis, axes.yaxis):
        if axis.get_scale() == "log":
            axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
            axis.set_minor_formatter(NullFormatter())


def power(curves: Mapping[str, Any]) -> Picture:
    """Draw detected or not against the visible size, with the logistic curve of all trials."""
    figure, axes = sheet(WIDE, 3.4)
    every = curves["all"]
    x, y = np.asarray(every["visible_share"]), np.asarray(every["seen"], dtype=np.float64)
    if x.size:
        spread = np.linspace(-0.06, 0.06, x.size)
        axes.scatter(100 * x, y + spread, s=22, color=np.where(y > 0, BLUE, RED), alpha=0.7, linewidths=0)
        if every["half_seen_at"]:
            grid = np.geomspace(max(x.min(), 2e-4), x.max(), 200)
            axes.plot(100 * grid, 1 / (1 + np.exp(-every["slope"] * np.log(grid / every["half_seen_at"]))), color=INK)
            axes.axvline(100 * every["half_seen_at"], color=GREY, linestyle=":")
        axes.set_xscale("log")
        _plain(axes)
    axes.set_yticks([0, 0.5, 1], ["missed", "half", "detected"])
    label(axes, "visible part of what is concealed (% of Fy)", "")
    half = every["half_seen_at"]
    words = f"Half of the effects are detected at {100 * half:.2g} % of Fy. " if half else ""
    return Picture(
        svg(figure),
        "Trials with something concealed, detected or missed, against the size",
        words + "Each dot is a trial with one effect; the size is what no base parameter takes up (99th percentile).",
        "How small an effect is detected",
        wide=True,
    )


def confusion(entries: Sequence[Mapping[str, Any]], what: str) -> Picture:
    """Draw what was concealed against the answer, by ``family`` or by ``effect``."""
    truths = sorted({e["truth"] for e in entries})
    last = ("several", "unknown", "adequate")
    answers = [*truths, *sorted({e["answer"] for e in entries} - set(truths) - set(last)), *last]
    counts = np.zeros((max(len(truths), 1), len(answers)))
    for e in entries:
        counts[truths.index(e["truth"]), answers.index(e["answer"])] += e["n"]
    figure, axes = sheet(WIDE, 0.8 + 0.34 * max(len(truths), 3))
    axes.grid(visible=False)
    axes.imshow(
        counts / np.maximum(counts.sum(axis=1, keepdims=True), 1), cmap="Blues", vmin=0, vmax=1.4, aspect="auto"
    )
    for i, j in np.argwhere(counts > 0):
        axes.text(j, i, f"{counts[i, j]:.0f}", ha="center", va="center", color=INK, fontsize=10)
    axes.set_xticks(range(len(answers)), [a.replace("_", " ") for a in answers], rotation=35, ha="right")
    axes.set_yticks(range(len(truths)), [t.replace("_", " ") for t in truths])
    label(axes, "answer", "concealed")
    return Picture(
        svg(figure),
        f"Confusion matrix by {what}",
        "Detectable single effects. A family that lists the truth counts as right; several is more than one name.",
        f"What was concealed, and what was answered, by {what}",
        wide=True,
    )


def heldout(rows: Sequence[Mapping[str, Any]]) -> Picture:
    """Draw the error on the slowed earthquake, before and after."""
    figure, axes = sheet()
    chosen = [r for r in rows if r.get("detectable") and "heldout" in r]
    for outcomes, colour, words in ((("right", "right family"), BLUE, "rightly named"), (None, PALE, "other answers")):
        own = [r for r in chosen if (r["outcome"] in ("right", "right family")) == (outcomes is not None)]
        if own:
            axes.scatter(
                [r["heldout"]["earthquake_before"] for r in own],
                [r["heldout"]["earthquake_after"] for r in own],
                s=20,
                color=colour,
                label=words,
                edgecolors=GREY,
                linewidths=0.4,
            )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.axline((1, 1), (2, 2), color=GREY, linewidth=0.8)
    axes.axhline(HELD_OUT, color=RED, linewidth=0.8, linestyle="--")
    _plain(axes)
    if chosen:
        legend(axes, 2)
    label(axes, "published law (x noise floor)", "with what was found (x noise floor)")
    return Picture(
        svg(figure),
        "Prediction error on an unseen displacement history, before and after",
        "A slowed earthquake that the diagnosis never saw; dashed: 1.5 x the noise floor, the aim for 90 % of them.",
        "Does it predict another history?",
    )


def before_after(rows: Sequence[Mapping[str, Any]]) -> Picture:
    """Draw how far off gamma is, before and after."""
    figure, axes = sheet()
    own = [r for r in rows if r.get("outcome") in ("right", "right family") and "gamma" in r.get("coverage", {})]
    before = [1e3 * abs(r["coverage"]["gamma"]["off_before"]) for r in own]
    after = [1e3 * abs(r["coverage"]["gamma"]["off_after"]) for r in own]
    axes.scatter(np.maximum(before, 1e-3), np.maximum(after, 1e-3), s=20, color=BLUE)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.axline((1, 1), (2, 2), color=GREY, linewidth=0.8)
    _plain(axes)
    label(axes, "published law, error of gamma (10⁻³ s/mm)", "with what was found (10⁻³ s/mm)")
    return Picture(
        svg(figure),
        "Error of the speed coefficient before and after",
        "Rightly named effects. Below the line: the effect, once modelled, brought gamma nearer to the truth.",
        "How wrong would the published model have been?",
    )


def reliability(tables: Mapping[str, Sequence[Mapping[str, Any]]]) -> Picture:
    """Draw how many of the stated probabilities came true, with 95 % intervals."""
    figure, axes = sheet()
    for (of, bins), colour, shift in zip(tables.items(), (BLUE, RED), (-0.4, 0.4), strict=True):
        own = [one for one in bins if one["true"]["n"]]
        x = np.array([100 * one["stated"] for one in own]) + shift
        true, low, high = (np.array([100 * one["true"][name] for one in own]) for name in ("share", "low", "high"))
        axes.errorbar(x, true, [true - low, high - true], fmt="o", color=colour, ms=5, lw=1.2, label=of)
    axes.axline((0, 0), (100, 100), color=GREY, linewidth=0.8)
    axes.set_xlim(-2, 102)
    axes.set_ylim(-2, 102)
    legend(axes, 2)
    label(axes, "stated probability (%)", "came true (%)")
    return Picture(
        svg(figure),
        "Stated probabilities against how many came true",
        "One dot for each bin of stated probabilities, with its 95 % interval; on the line they mean what they say.",
        "Do probabilities mean what they say?",
    )


def clamping(band: Band, diagnosed: Mapping[str, tuple[FloatArray, FloatArray]]) -> Picture:
    """Draw the change of a band's force that was withheld, and that of the clamping which was diagnosed."""
    figure, axes = sheet(WIDE, 3.4)
    axes.axvspan(band.begin_s, band.end_s, color=INK, alpha=0.06, linewidth=0)
    for side, colour in (("push", BLUE), ("pull", RED)):
        at, change = band.change[side]
        few = slice(None, None, max(at.size // MOST_DOTS, 1))
        axes.scatter(at[few], 100 * change[few], s=5, color=colour, alpha=0.5, linewidths=0, label=f"{side}, measured")
        if side in diagnosed:
            at, change = diagnosed[side]
            waits = np.append(False, np.diff(at) > 10.0 * np.median(np.diff(at)))  # while the other end pulls
            drawn = np.where(waits, np.nan, 100 * change)
            kept = waits | (np.arange(at.size) % max(at.size // MOST_DOTS, 1) == 0)
            axes.plot(at[kept], drawn[kept], color=colour, linewidth=1.8, label=f"{side}, diagnosed")
    legend(axes, 4)
    label(axes, "time (s)", "change (%)")
    return Picture(
        svg(figure),
        "Force of the band and clamping that was diagnosed, over time",
        "Dots: force of the band while it pulls, which the diagnosis did not see. Lines: clamping as diagnosed from "
        "displacement and force, while that end of the band pulls. Grey: the band was moved.",
        "Clamping over time",
        wide=True,
    )
