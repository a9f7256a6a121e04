"""From a results folder to margins: population, diagnoses of its devices, sheet, files, page."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from shj_bayes._util.files import need_population, write_text
from shj_bayes.errors import PopulationError
from shj_bayes.margins.asked import LEEWAY, asked_for
from shj_bayes.margins.bounds import bounds
from shj_bayes.margins.codes.en15129 import kind_of
from shj_bayes.margins.diagnosed import find_diagnosis, words_of
from shj_bayes.margins.files import design_table, to_json, write_margins
from shj_bayes.margins.following import left_out_words
from shj_bayes.margins.link_elements import link_csv
from shj_bayes.margins.loops_file import loops, write_loops
from shj_bayes.margins.monte_carlo import draw_devices, draws_csv, draws_script
from shj_bayes.margins.opensees import python_script, tcl_script
from shj_bayes.margins.request import Request
from shj_bayes.margins.sheet import CAPACITY, DRIFT, Sheet, margins, pool
from shj_bayes.margins.specimen import Specimen, largest_ranges, read_specimen, specimens_of_table
from shj_bayes.margins.trial import try_all
from shj_bayes.mismatch.schema import Verdict
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import never_tested_words, sets_suffice
from shj_bayes.population.results import load_population
from shj_bayes.report.campaign import WITH_SET
from shj_bayes.report.campaign_file import read_campaign
from shj_bayes.report.campaign_physics import statements
from shj_bayes.report.margins_page import render_margins
from shj_bayes.report.sets import name_of

TABLES_NAME = "Published tables"
MOST_DRAWN = 100  # devices whose loops are drawn and written


def drawn_up(folder: Path, request: Request, *, progress: bool = False) -> dict[str, Any]:
    """Draw up and write the margins of a folder; parameters and errors as for `design_margins`.

    ``record`` is the content of ``margins.json``, ``words`` the design table and what to mind, for people.
    """
    result = load_population(folder)
    named = (name if name == ANY_SET else result.set_names[result.index(name)] for name in request.sets)
    request = replace(request, sets=tuple(named))
    campaign, specimens, words = tested_devices(folder, result)
    asked = asked_for(request, specimens) if specimens else None
    trials = try_all(specimens, asked, extrapolate=request.extrapolate)
    sheet = margins(pool(trials, result, progress=progress), trials, request, asked=asked, words=words)
    speed = min(s.ranges["speed"] for s in specimens) if asked is None else float(asked.motion.speed_mm_s.max())
    loop_bands = loops(trials, speed) if len(trials) <= MOST_DRAWN else ()
    write_margins(sheet, folder)
    write_loops(loop_bands, folder)
    name = str(campaign["name"]) if campaign else TABLES_NAME
    simulated = bool(campaign and campaign.get("simulated"))
    render_margins(folder, sheet, loop_bands, name=name, importance=request.importance, simulated=simulated)
    notes = [f"- {line}" for line in (*sheet.diagnoses, *sheet.warnings)]
    return {"record": to_json(sheet), "words": "\n".join([margin_text(sheet, request), "", *notes])}


def export_analysis(
    folder: Path,
    out: Path | None = None,
    amplitude_mm: float | None = None,
    draws: int | None = None,
    *,
    progress: bool = False,
) -> tuple[Path, ...]:
    """Write the bounds of every set for structural analysis.

    Parameters
    ----------
    folder : Path
        Folder that ``campaign`` or ``tables`` wrote.
    out : Path, optional
        Where to; ``opensees`` below the folder by default.
    amplitude_mm : float, optional
        Of the cycle for effective stiffness and damping; the largest tested by default.
    draws : int, optional
        New devices of each set for Monte Carlo, besides the bounds.
    progress : bool
        Show a progress bar.

    Returns
    -------
    tuple of Path
        ``connection_materials.py``, ``connection_materials.tcl``, ``link-elements.csv``, ``loops.csv`` (bands of the
        virtual test) and, with draws, ``connection_draws.py`` and ``connection_draws.csv``.
    """
    need_population(folder)
    result = load_population(folder)
    campaign, specimens, _ = tested_devices(folder, result)
    if not specimens:
        raise PopulationError("no device gives all of K, Fy, beta and gamma, which a material needs")
    tested = largest_ranges(specimens)["position"]
    amplitude = tested if amplitude_mm is None else amplitude_mm
    if not 0 < amplitude <= LEEWAY * tested:
        raise PopulationError(f"an amplitude of {amplitude:g} mm was not tested; tested was up to {tested:.4g} mm")
    trials = try_all(specimens, None)
    design = pool(trials, result, progress=progress)
    drawn = bounds(design, result, amplitude)
    speed = min(s.ranges["speed"] for s in specimens)
    source = str(campaign["name"]) if campaign else TABLES_NAME
    devices = () if draws is None else draw_devices(design, result, draws, speed)
    place = folder / "opensees" if out is None else out
    place.mkdir(parents=True, exist_ok=True)
    cycle = f"{amplitude:.3g} mm"
    left_out = left_out_words([trial.following for trial in trials])
    files = {
        "connection_materials.py": python_script(drawn, amplitude, source, left_out),
        "connection_materials.tcl": tcl_script(drawn, source, left_out),
        "link-elements.csv": link_csv(drawn, cycle, left_out),
    }
    if devices:
        files["connection_draws.py"] = draws_script(devices, amplitude, speed, source, left_out)
        files["connection_draws.csv"] = draws_csv(devices, speed)
    for name, text in files.items():
        write_text(place / name, text)
    drawn_loops = write_loops(loops(trials, speed) if len(trials) <= MOST_DRAWN else (), place)
    return (*(place / name for name in files), *((drawn_loops,) if drawn_loops else ()))


def tested_devices(
    folder: Path, result: PopulationResult
) -> tuple[dict[str, Any] | None, tuple[Specimen, ...], tuple[str, ...]]:
    """Read the tested devices of a folder with the models that their diagnoses ended in.

    Parameters
    ----------
    folder : Path
        Folder that ``campaign`` or ``tables`` wrote.
    result : PopulationResult
        Its population.

    Returns
    -------
    campaign : dict or None
        Content of ``campaign.json``; None for the published tables.
    specimens : tuple of Specimen
        The devices.
    words : tuple of str
        What the diagnoses found.
    """
    if not (folder / "campaign.json").exists():
        return None, specimens_of_table(result), ()
    campaign = read_campaign(folder)
    out, found, notes = [], {}, []
    places = _places(campaign, result)
    for place, name, of_set, with_set in places:
        diagnosis, why = find_diagnosis(folder / place)
        if why:
            notes.append(f"{of_set}, {name}: {why}")
        if diagnosis is not None:
            found[of_set, name] = diagnosis
        better = diagnosis.fit if diagnosis is not None and diagnosis.verdict is not Verdict.ADEQUATE else None
        if with_set:
            better = folder / place / WITH_SET
        out.append(read_specimen(folder / place, name, of_set, better))
    return campaign, tuple(out), (*statements(campaign), *words_of(found, len(places), notes))


def _places(campaign: dict[str, Any], result: PopulationResult) -> list[tuple[str, str, str, bool]]:
    """Folder, name, set of every device of a campaign in its population, and whether it was fitted with its set's."""
    members = {group.name: group.devices for group in result.sets}
    return [
        (
            str(entry["folder"]),
            str(entry["name"]),
            str(group["name"]),
            entry.get("with_set") in ("reliable", "tentative"),
        )
        for group in campaign["sets"]
        for entry in group["devices"]
        if str(entry["name"]) in members.get(str(group["name"]), ())
    ]


def margin_text(sheet: Sheet, request: Request) -> str:
    """Design table as text: per set and quantity the new device, EN 1990 and a tolerance limit, then the factors."""
    table = design_table(sheet)
    names = list(dict.fromkeys(row.set_name for row in sheet.rows))
    tested = [name for name in names if name != ANY_SET]
    enough = sets_suffice(len(tested))
    lines = []
    for name in request.sets or (names if enough else tested):
        shown = "(all devices)" if name == ANY_SET else name
        part = table[table["set"] == shown]
        count = int(part["devices"].max())
        behind = f"from {len(tested)} tested sets" if name == ANY_SET else f"{count} device{'' if count == 1 else 's'}"
        lines += ["", f"{name_of(name)}: {behind}"]
        lines.append(f"  {first_words(sheet, name)}")
        lines.append(f"  {'':16}{'new device':>28}{'EN 1990 X_k':>22}{'EN 1990 X_d':>22}{'95/95 one-sided':>22}")
        complete = True
        for line in part.to_dict("records"):
            ends = [
                (line.get(f"{head}, low", math.nan), line.get(f"{head}, high", math.nan))
                for head in ("EN 1990 characteristic", "EN 1990 design", "tolerance 95/95 one-sided")
            ]
            complete &= all(map(_known, ends))
            pairs = [f"{low:.3g} to {high:.3g}" if _known((low, high)) else "-" for low, high in ends]
            band = f"{line['middle']:.3g} ({line['new device, low']:.3g} to {line['new device, high']:.3g})"
            unit = "" if line["unit"] == "1" else f" {line['unit']}"
            head = f"{line['quantity']}{unit}"
            lines.append(f"  {head:16}{band:>28}{pairs[0]:>22}{pairs[1]:>22}{pairs[2]:>22}")
        if not complete:
            lines.append("  (-: EN 1990 has no factor for a spread known from fewer than 3 (X_k) or 4 (X_d) devices)")
        lines += [f"  {text}" for text in _factor_lines(sheet, name, request.importance)]
    if not (request.sets or enough):
        lines += ["", never_tested_words(len(tested))]
    return "\n".join(lines[1:])


def _known(ends: tuple[float, float]) -> bool:
    """Whether both ends of a range are given: a standard may have no factor for so few devices."""
    return all(map(math.isfinite, ends))


def first_words(sheet: Sheet, name: str) -> str:
    """Give the one number for drift and the one for capacity design of a set."""
    own = {row.kind: row.value for row in sheet.rows if row.set_name == name}
    return f"{DRIFT}: {own[DRIFT]:.3g} kN; {CAPACITY}: {own[CAPACITY]:.3g} kN"


def _factor_lines(sheet: Sheet, name: str, importance: str) -> list[str]:
    own = {row.kind: row for row in sheet.rows if row.set_name == name}

    def value(kind: str) -> str:
        if kind not in own:
            return "-"
        return f"{own[kind].value:.3g}" + (f" ({own[kind].warning})" if own[kind].warning else "")

    return [
        f"ASCE 7 lambda {value('lambda_min with the floor for dampers')} to "
        f"{value('lambda_max with the floor for dampers')}, bounds {value('ASCE 7 lower bound force')} to "
        f"{value('ASCE 7 upper bound force')} kN; EN 15129 {value(kind_of('LBDP', importance))} to "
        f"{value(kind_of('UBDP', importance))} kN",
        f"phi {value('phi equivalent, first run')}, after a first earthquake "
        f"{value('phi equivalent, after a first earthquake')}, phi_o {value('phi_o equivalent')} "
        "(NZ practice 0.70 and 1.40)",
    ]
