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
from shj_bayes.report.numbers import DeviceFigures, cycle_marks
from shj_bayes.report.page import is_ours
from shj_bayes.report.words import ForceUnit, force_unit, unit_for
from shj_bayes.results.device import DeviceData, DiagnosisData

MAX_POINTS = 16_000  # of all runs together: about 0.5 MB of page, more than any screen has points to show
MOST = 6  # runs that can be looked into
STEPS = 20_000  # of the range of a channel: finer than a screen, and coarse enough for short numbers
FORCES = ("measured", "before", "after", "low", "high")
# a run: places where cycles begin and the last one ends, turning points, channels by role
Loops = tuple[str, IntArray, IntArray, dict[str, FloatArray]]


def device_viewer(device: DeviceData, numbers: DeviceFigures) -> dict[str, Any]:
    """Loops of a device with the model and the 90 % band.

    ``runs`` (whole numbers by channel, ``cycles`` as places in them, ``every`` how they were thinned), ``scale`` (s, mm
    and force of one step), ``unit`` of the force, ``names`` of what is drawn, ``ink`` of the only law ("base" as on a
    diagnosis page, or "model"), ``cycle`` to show first.
    """
    runs: list[Loops] = []
    for run, band in list(zip(device.runs, numbers.bands, strict=True))[:MOST]:
        channels = {"t": run.time_s, "x": run.displacement_mm, "measured": run.force_kN}
        channels |= {"before": band.median, "low": band.force_low, "high": band.force_high}
        marks = np.round(cycle_marks(run)).astype(np.int64)
        runs.append((f"run {run.number}", marks, run.reversals, channels))
    return _viewer(runs, force_unit(device.record), {"before": "model", "after": "", "band": "90 % of points expected"})


def diagnosis_viewer(data: DiagnosisData) -> dict[str, Any]:
    """Loops of a diagnosis, before and after; as `device_viewer`."""
    runs: list[Loops] = []
    for run in np.unique(data.run)[:MOST]:
        mine = data.run == run
        turns = np.flatnonzero(np.diff(data.direction[mine])) + 1
        cycles = np.concatenate([[0], turns[::2], [int(mine.sum())]])  # whole loops, from one end of the stroke
        channels = {"t": data.time_s, "x": data.position_mm, "measured": data.force_kN, "before": data.before_kN}
        channels |= {"after": data.after_kN} if data.changed else {}
        runs.append((f"run {run}", cycles, turns, {role: values[mine] for role, values in channels.items()}))
    names = {"before": "base law", "after": "with what was found" if data.changed else "", "band": ""}
    return _viewer(runs, unit_for(data.capacity_kN), names, "base")


def recording_viewer(
    runs: Sequence[tuple[Recording, Motion | None]], forces_kN: Sequence[FloatArray] = ()
) -> dict[str, Any]:
    """Loops of recordings, with the force of a model where there is one; as `device_viewer`."""
    out: list[Loops] = []
    for i, (recording, motion) in enumerate(runs[:MOST]):
        start = np.array([0, recording.n_samples]) if motion is None else motion.start
        channels = {"t": recording.time_s, "x": recording.displacement_mm, "measured": recording.force_kN}
        channels |= {"before": forces_kN[i]} if forces_kN else {}
        out.append((f"run {i + 1}", np.append(start[:-1:2], start[-1]), start[1:-1], channels))
    unit = unit_for(max(float(np.abs(channels["measured"]).max()) for *_, channels in out))
    return _viewer(out, unit, {"before": "model", "after": "", "band": ""})


def thinning_words(viewer: Mapping[str, Any]) -> str:
    """Say how the points were chosen."""
    every = max(int(run["every"]) for run in viewer["runs"])
    if every == 1:
        return "Every sample of the calculation is here."
    last = {2: "nd", 3: "rd"}.get(every, "th")
    return f"Every {every}{last} sample and every turning point is here; the calculation used them all."


def _viewer(runs: Sequence[Loops], unit: ForceUnit, names: dict[str, str], ink: str = "model") -> dict[str, Any]:
    """Thin the channels of runs, and give them as whole numbers of steps that all runs share."""
    thinned = []
    for _, cycles, turns, channels in runs:
        size = channels["t"].size
        every = max(1, math.ceil(size / (MAX_POINTS // len(runs))))
        keep = np.unique(np.concatenate([np.arange(0, size, every), turns, [size - 1]]))
        keep = keep[np.all([np.isfinite(values[keep]) for values in channels.values()], axis=0)]
        places = np.unique(np.clip(np.searchsorted(keep, cycles), 0, keep.size)).tolist()
        kept = {role: (unit.factor if role in FORCES else 1.0) * values[keep] for role, values in channels.items()}
        thinned.append((every, places if len(places) > 1 else [0, keep.size], kept))
    scale = {
        name: _step([values for *_, kept in thinned for role, values in kept.items() if role in roles])
        for name, roles in (("t", ("t",)), ("x", ("x",)), ("force", FORCES))
    }
    out = []
    for (name, *_), (every, places, kept) in zip(runs, thinned, strict=True):
        steps = {role: np.round(v / scale.get(role, scale["force"])).astype(int).tolist() for role, v in kept.items()}
        out.append({"name": name, "every": every, "cycles": places, **steps})
    _, places, first = thinned[0]
    return {
        "runs": out,
        "scale": scale,
        "names": names,
        "ink": ink,
        "cycle": _first_cycle([first["x"][a:b] for a, b in pairwise(places)]),
        "unit": unit.name,
    }


def _first_cycle(parts: Sequence[FloatArray]) -> int:
    """Last of the largest cycles, by their displacements, that close; the largest where none does."""
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
    if which in found or (which is None and found):
        return found[which or next(iter(found))]
    none = "none; run shj-bayes fit, diagnose, campaign or tables first"
    wanted = f"{which}.html" if which else "page"
    raise ReportError(f"{place.name} holds no {wanted}; it has {', '.join(found) or none}")


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
