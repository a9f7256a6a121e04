"""Open the pages of results, and the viewer that lists them."""

import math
import os
import subprocess
import webbrowser
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes._util.processes import program
from shj_bayes.errors import ReportError
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.recording import Recording
from shj_bayes.report import numbers as n
from shj_bayes.report.numbers import DeviceFigures
from shj_bayes.report.page import is_ours
from shj_bayes.report.words import force_unit, unit_for
from shj_bayes.results.device import DeviceData, DiagnosisData

MAX_POINTS = 16_000  # of all runs together: about 0.5 MB of page, more than any screen has points to show
MOST = 6  # runs that can be looked into
STEPS = 20_000  # of the range of a channel: finer than a screen, and coarse enough for short numbers


def device_viewer(device: DeviceData, numbers: DeviceFigures) -> dict[str, Any]:
    """Loops of a device with the model and the 90 % band.

    ``runs`` (whole numbers by channel, ``cycles`` as places in them, ``every`` how they were thinned), ``scale`` (s, mm
    and force of one step), ``unit`` of the force, ``names`` of what is drawn, ``ink`` of the only law ("base" as on a
    diagnosis page, or "model"), ``cycle`` to show first.
    """
    runs, unit = [], force_unit(device.record)
    shown = list(zip(device.runs, numbers.bands, strict=True))[:MOST]
    for run, band in shown:
        marks = np.round(n.cycle_marks(run)).astype(np.int64)
        channels = {
            "t": run.time_s,
            "x": run.displacement_mm,
            "measured": unit.factor * run.force_kN,
            "before": unit.factor * band.median,
            "low": unit.factor * band.force_low,
            "high": unit.factor * band.force_high,
        }
        runs.append(_run(f"run {run.number}", channels, marks, run.reversals, MAX_POINTS // len(shown)))
    names = {"before": "model", "after": "", "band": "90 % of points expected"}
    return _whole(runs, names, "model", unit.name)


def diagnosis_viewer(data: DiagnosisData) -> dict[str, Any]:
    """Loops of a diagnosis, before and after; as `device_viewer`."""
    which = np.unique(data.run)[:MOST]
    runs, unit = [], unit_for(data.capacity_kN)
    for run in which:
        mine = data.run == run
        turns = np.flatnonzero(np.diff(data.direction[mine])) + 1
        cycles = np.concatenate([[0], turns[::2], [int(mine.sum())]])  # whole loops, from one end of the stroke
        channels = {
            "t": data.time_s[mine],
            "x": data.position_mm[mine],
            "measured": unit.factor * data.force_kN[mine],
            "before": unit.factor * data.before_kN[mine],
        }
        if data.changed:
            channels["after"] = unit.factor * data.after_kN[mine]
        runs.append(_run(f"run {run}", channels, cycles, turns, MAX_POINTS // which.size))
    names = {"before": "base law", "after": "with what was found" if data.changed else "", "band": ""}
    return _whole(runs, names, "base", unit.name)


def recording_viewer(
    runs: Sequence[tuple[Recording, Motion | None]], forces_kN: Sequence[FloatArray] = ()
) -> dict[str, Any]:
    """Loops of recordings, with the force of a model where there is one; as `device_viewer`."""
    shown, out = runs[:MOST], []
    unit = unit_for(max(float(np.abs(recording.force_kN).max()) for recording, _ in shown))
    for i, (recording, motion) in enumerate(shown):
        start = np.array([0, recording.n_samples]) if motion is None else motion.start
        channels = {
            "t": recording.time_s,
            "x": recording.displacement_mm,
            "measured": unit.factor * recording.force_kN,
        }
        if forces_kN:
            channels["before"] = unit.factor * forces_kN[i]
        marks = np.append(start[:-1:2], start[-1])
        out.append(_run(f"run {i + 1}", channels, marks, start[1:-1], MAX_POINTS // len(shown)))
    return _whole(out, {"before": "model", "after": "", "band": ""}, "model", unit.name)


def thinning_words(viewer: Mapping[str, Any]) -> str:
    """Say how the points were chosen."""
    every = max(int(run["every"]) for run in viewer["runs"])
    if every == 1:
        return "Every sample of the calculation is here."
    last = {2: "nd", 3: "rd"}.get(every, "th")
    return f"Every {every}{last} sample and every turning point is here; the calculation used them all."


def _run(name: str, channels: Mapping[str, FloatArray], cycles: IntArray, turns: IntArray, most: int) -> dict[str, Any]:
    """One run, thinned; `cycles` holds the places where cycles begin and the last one ends."""
    size = channels["t"].size
    every = max(1, math.ceil(size / most))
    keep = np.unique(np.concatenate([np.arange(0, size, every), turns, [size - 1]]))
    keep = keep[np.all([np.isfinite(values[keep]) for values in channels.values()], axis=0)]
    places = np.unique(np.clip(np.searchsorted(keep, cycles), 0, keep.size))
    if places.size < 2:
        places = np.array([0, keep.size])
    return {
        "name": name,
        "every": every,
        "cycles": places.tolist(),
        **{role: values[keep] for role, values in channels.items()},
    }


def _whole(runs: Sequence[dict[str, Any]], names: dict[str, str], ink: str, unit: str) -> dict[str, Any]:
    """Channels as whole numbers of steps that all runs share, and the cycle of the first run to show first."""
    forces = ("measured", "before", "after", "low", "high")
    scale = {
        "t": _step([run["t"] for run in runs]),
        "x": _step([run["x"] for run in runs]),
        "force": _step([run[role] for run in runs for role in forces if role in run]),
    }
    out = []
    for run in runs:
        steps = {
            role: np.round(values / scale["force" if role in forces else role]).astype(np.int64).tolist()
            for role, values in run.items()
            if isinstance(values, np.ndarray)
        }
        out.append({"name": run["name"], "every": run["every"], "cycles": run["cycles"], **steps})
    return {"runs": out, "scale": scale, "names": names, "ink": ink, "cycle": _first_cycle(runs[0]), "unit": unit}


def _first_cycle(run: Mapping[str, Any]) -> int:
    """Last of the largest cycles that close; the largest where none does."""
    parts = [run["x"][a:b] for a, b in pairwise(run["cycles"])]
    reach = np.array([float(np.ptp(part)) for part in parts])
    gap = np.array([abs(float(part[-1] - part[0])) for part in parts])
    closed = (reach >= 0.95 * reach.max()) & (gap <= 0.15 * reach)
    return int(np.flatnonzero(closed)[-1]) if closed.any() else int(np.argmax(reach))


def _step(channels: Sequence[FloatArray]) -> float:
    """Power of ten that cuts the range of a channel into `STEPS` or more."""
    reach = max((float(np.max(np.abs(values))) for values in channels if values.size), default=0.0)
    return float(10.0 ** math.floor(math.log10(reach / STEPS))) if reach > 0 else 1.0


PAGES = ("report", "diagnosis", "margins", "plan")  # in the order in which they are looked for
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "msedge")
WINDOWS = ("Google/Chrome/Application/chrome.exe", "Microsoft/Edge/Application/msedge.exe")
PATIENCE_S = 120.0


def page_of(place: Path, which: str | None = None) -> Path:
    """Page of a results folder: the one asked for (report, diagnosis, margins, plan), or the first that is there.

    `ReportError` where there is none.
    """
    if place.suffix == ".html" and place.is_file():
        return place
    if not place.is_dir():
        raise ReportError(f"{place} is not a folder of results; name the one that was given to -o")
    found = {name: place / f"{name}.html" for name in PAGES if (place / f"{name}.html").is_file()}
    if which in found:
        return found[which]
    there = (
        f"it has {', '.join(found)}" if found else "it has none; run shj-bayes fit, diagnose, campaign or tables first"
    )
    if which is None and found:
        return next(iter(found.values()))
    raise ReportError(f"{place.name} holds no {which or 'page'}{'.html' if which else ''}; {there}")


def open_page(page: Path) -> bool:
    """Open a page in the browser of the desk; False when there is none to open it in."""
    return webbrowser.open(page.resolve().as_uri())


def write_pdf(page: Path) -> Path:
    """Print a page to PDF (A4), beside it; `ReportError` if no Chromium is installed, or it fails."""
    browser = find_browser()
    if browser is None:
        raise ReportError(
            f"no Chromium, Chrome or Edge was found to print {page.name} with; open the page and print it from there"
        )
    target = page.with_suffix(".pdf")
    with TemporaryDirectory(dir=page.parent, prefix=".pdf-") as part, TemporaryDirectory() as profile:
        made = Path(part) / target.name
        command = [browser, "--headless", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
        command += ["--disable-sync", "--disable-component-update", "--disable-quic", f"--user-data-dir={profile}"]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            if not is_ours(page):
                raise ReportError(
                    f"{page.name} is not as this version wrote it, and Chromium prints for root only without its "
                    "sandbox; run the command again that made the page, or print it as another user"
                )
            command.append("--no-sandbox")  # Chromium does not start for root otherwise; only our script runs
        command += ["--no-pdf-header-footer", f"--print-to-pdf={made.resolve()}", page.resolve().as_uri()]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=PATIENCE_S)
            os.replace(made, target)
        except (OSError, subprocess.SubprocessError) as error:
            raise ReportError(f"{Path(browser).name} could not print {page.name}: {type(error).__name__}") from error
    return target


def find_browser() -> str | None:
    """Program of a Chromium-like browser; None when there is none on the path or at its usual place on Windows."""
    on_path = next((found for name in BROWSERS if (found := program(name))), None)
    if on_path:
        return on_path
    roots = [os.environ[name] for name in ("PROGRAMFILES", "PROGRAMFILES(X86)", "LOCALAPPDATA") if name in os.environ]
    return next((str(p) for root in roots for tail in WINDOWS if (p := Path(root) / tail).is_file()), None)
