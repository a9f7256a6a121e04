"""From a results folder to margins: population, diagnoses of its devices, sheet, files, page."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shj_bayes.errors import PopulationError
from shj_bayes.files import need_population, write_text
from shj_bayes.margins.bounds import bounds
from shj_bayes.margins.diagnosed import Cases, cases, find_diagnosis
from shj_bayes.margins.files import design_table, to_json, write_margins
from shj_bayes.margins.first_cycle import by_set
from shj_bayes.margins.link_elements import link_csv
from shj_bayes.margins.loops_file import loops, write_loops
from shj_bayes.margins.opensees import python_script, tcl_script
from shj_bayes.margins.request import PLAIN, Request
from shj_bayes.margins.sheet import Sheet, margins, motion_of
from shj_bayes.population.fits import device_from_fit
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import never_tested_words, sets_suffice
from shj_bayes.population.results import load_population
from shj_bayes.report.campaign_file import read_campaign
from shj_bayes.report.margins_page import render_margins
from shj_bayes.report.sets import name_of

TABLES_NAME = "Published tables"


@dataclass(frozen=True, eq=False)
class Design:
    """Margins of a folder.

    Parameters
    ----------
    sheet : Sheet
        The margins.
    page : Path
        The designer's sheet.
    sets : tuple of str
        Sets that were asked for; all where empty.
    """

    sheet: Sheet
    page: Path
    sets: tuple[str, ...] = ()

    @property
    def record(self) -> dict[str, Any]:
        """For machines: content of ``margins.json``."""
        return to_json(self.sheet)

    @property
    def text(self) -> str:
        """For people: the design table, what to mind, and where the sheet is."""
        return "\n".join(
            [
                margin_text(self.sheet, self.sets),
                "",
                *(f"- {line}" for line in (*self.sheet.diagnoses, *self.sheet.warnings)),
                "",
                f"margins: {self.page}",
            ]
        )


def design_margins(
    folder: Path,
    request: Request = PLAIN,
    *,
    population: PopulationResult | None = None,
    progress: bool = False,
) -> Design:
    """Draw up and write the margins of a folder that ``campaign`` or ``tables`` wrote.

    Parameters
    ----------
    folder : Path
        The folder.
    request : Request
        Cycle and choices.
    population : PopulationResult, optional
        Its population; read from the folder when not given.
    progress : bool
        Show a progress bar while populations with found physics are fitted.

    Returns
    -------
    Design

    Raises
    ------
    PopulationError
        If a set that was asked for is not there, or a cycle was not tested; nothing is written then.
    """
    need_population(folder)
    result = load_population(folder) if population is None else population
    request = replace(request, sets=tuple(_set_named(result, name) for name in request.sets))
    campaign, others, words = _models(folder, result, progress)
    cycles = by_set((of_set, folder / place) for place, _, of_set in _places(campaign, result))
    sheet = margins(result, request, diagnosed=others or None, words=words, first_cycles=cycles)
    loop_bands = loops(next(iter(others.values()), result), sheet.motion)
    write_margins(sheet, folder)
    write_loops(loop_bands, folder)
    name = str(campaign["name"]) if campaign else TABLES_NAME
    page = render_margins(folder, sheet, loop_bands, name=name, simulated=bool(campaign and campaign.get("simulated")))
    return Design(sheet, page, request.sets)


def export_analysis(
    folder: Path, out: Path | None = None, amplitude_mm: float | None = None, *, progress: bool = False
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
    progress : bool
        Show a progress bar while populations with found physics are fitted.

    Returns
    -------
    tuple of Path
        ``connection_materials.py``, ``connection_materials.tcl``, ``link-elements.csv``.
    """
    need_population(folder)
    result = load_population(folder)
    motion = motion_of(result, Request(amplitude_mm=amplitude_mm))
    if motion is None:
        raise PopulationError(
            "this population does not say at which amplitudes and speeds its devices were tested, so no material can "
            "be written; run the campaign or the tables again with this version"
        )
    campaign, others, _ = _models(folder, result, progress)
    drawn = bounds(list(others.values()) or [result], motion)
    source = str(campaign["name"]) if campaign else TABLES_NAME
    place = folder / "opensees" if out is None else out
    place.mkdir(parents=True, exist_ok=True)
    cycle = f"{motion.amplitude_mm:.3g} mm at a peak speed of {motion.guard.speed_mm_s:.3g} mm/s"
    files = {
        "connection_materials.py": python_script(drawn, motion, source),
        "connection_materials.tcl": tcl_script(drawn, source),
        "link-elements.csv": link_csv(drawn, cycle),
    }
    for name, text in files.items():
        write_text(place / name, text)
    return tuple(place / name for name in files)


def _set_named(result: PopulationResult, name: str) -> str:
    """Name of a set as the population has it; case does not matter."""
    return ANY_SET if name == ANY_SET else result.set_names[result.index(name)]


def _models(
    folder: Path, result: PopulationResult, progress: bool
) -> tuple[dict[str, Any] | None, dict[str, PopulationResult], tuple[str, ...]]:
    """Campaign record, populations with the physics that diagnoses found, and what they found in words."""
    campaign = _campaign(folder)
    found = _found(folder, campaign, result) if campaign else None
    if found is None:
        return campaign, {}, ()
    others = {
        label: replace(fit_population(devices, seed=result.seed, progress=progress), tested=result.tested)
        for label, devices in found.devices
    }
    return campaign, others, found.words


def _campaign(folder: Path) -> dict[str, Any] | None:
    """Content of ``campaign.json``; None for the published tables."""
    return read_campaign(folder) if (folder / "campaign.json").exists() else None


def _found(folder: Path, campaign: dict[str, Any], result: PopulationResult) -> Cases:
    """Collect populations with the physics that diagnoses of the campaign's devices found."""
    places = _places(campaign, result)
    diagnoses, notes = {}, []
    tags = {group.name: group.tags for group in result.sets}
    for place, name, of_set in places:
        diagnosis, why = find_diagnosis(folder / place)
        if diagnosis is not None:
            diagnoses[of_set, name] = diagnosis
        if why:
            notes.append(f"{of_set}, {name}: {why}")
    wanted = places if diagnoses else []  # reading a thousand fits again takes long
    devices = [device_from_fit(folder / place, name, of_set, tags[of_set]) for place, name, of_set in wanted]
    return cases(devices, diagnoses, notes)


def _places(campaign: dict[str, Any] | None, result: PopulationResult) -> list[tuple[str, str, str]]:
    """Folder, name and set of every device of a campaign that is in its population; none for the tables."""
    members = {group.name: group.devices for group in result.sets}
    return [
        (str(entry["folder"]), str(entry["name"]), str(group["name"]))
        for group in (campaign["sets"] if campaign else ())
        for entry in group["devices"]
        if str(entry["name"]) in members.get(str(group["name"]), ())
    ]


def margin_text(sheet: Sheet, sets: tuple[str, ...] = ()) -> str:
    """Design table as text: per set and quantity the new device, EN 1990 and a tolerance limit, then the factors."""
    table = design_table(sheet)
    names = list(dict.fromkeys(row.set_name for row in sheet.rows))
    tested = [name for name in names if name != ANY_SET]
    enough = sets_suffice(len(tested))
    lines = []
    for name in sets or (names if enough else tested):
        shown = "(all devices)" if name == ANY_SET else name
        part = table[table["set"] == shown]
        count = int(part["devices"].max())
        behind = f"from {len(tested)} tested sets" if name == ANY_SET else f"{count} device{'' if count == 1 else 's'}"
        lines += ["", f"{name_of(name)}: {behind}"]
        lines.append(f"  {'':16}{'new device':>28}{'EN 1990 X_k':>22}{'EN 1990 X_d':>22}{'95/95 one-sided':>22}")
        for line in part.to_dict("records"):
            pairs = [
                _from_to(line.get(f"{head}, low", math.nan), line.get(f"{head}, high", math.nan))
                for head in ("EN 1990 characteristic", "EN 1990 design", "tolerance 95/95 one-sided")
            ]
            band = f"{line['middle']:.3g} ({line['new device, low']:.3g} to {line['new device, high']:.3g})"
            unit = "" if line["unit"] == "1" else f" {line['unit']}"
            head = f"{line['quantity']}{unit}"
            lines.append(f"  {head:16}{band:>28}{pairs[0]:>22}{pairs[1]:>22}{pairs[2]:>22}")
        if any(line.rstrip().endswith(" -") or "  -  " in line for line in lines[-len(part) :]):
            lines.append("  (-: EN 1990 has no factor for a spread known from fewer than 3 (X_k) or 4 (X_d) devices)")
        lines += [f"  {text}" for text in _factor_lines(sheet, name)]
    if not (sets or enough):
        lines += ["", never_tested_words(len(tested))]
    return "\n".join(lines[1:])


def _from_to(low: float, high: float) -> str:
    """Both ends of a range; a dash where the tables of a standard have no factor for so few devices."""
    return f"{low:.3g} to {high:.3g}" if math.isfinite(low) and math.isfinite(high) else "-"


def _factor_lines(sheet: Sheet, name: str) -> list[str]:
    own = {row.kind.partition(", importance")[0]: row for row in sheet.rows if row.set_name == name}

    def value(kind: str) -> str:
        if kind not in own:
            return "-"
        return f"{own[kind].value:.3g}" + (f" ({own[kind].warning})" if own[kind].warning else "")

    return [
        f"ASCE 7 lambda {value('lambda_min with the floor for dampers')} to "
        f"{value('lambda_max with the floor for dampers')}, bounds {value('ASCE 7 lower bound force')} to "
        f"{value('ASCE 7 upper bound force')} kN; EN 15129 {value('EN 15129 LBDP')} to {value('EN 15129 UBDP')} kN",
        f"phi {value('phi equivalent, first run')}, after a first earthquake "
        f"{value('phi equivalent, after a first earthquake')}, phi_o {value('phi_o equivalent')} "
        "(NZ practice 0.70 and 1.40)",
    ]
