"""What a page waits for, done in a process of its own by the functions of the commands; results are plain values.

Each function takes the folder first and ends with `tell`, which says how far it is. What fails raises, and is told in
words by who asked.
"""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np

from shj_bayes.app.campaign import fit_one, run_campaign, summarise_campaign
from shj_bayes.app.design import PooledTests, compare_sets, pooled_tests, sheet_of, write_comparison
from shj_bayes.app.device import Work, read_device
from shj_bayes.app.manifest import Device, read_manifest
from shj_bayes.app.plan import plan_next
from shj_bayes.app.resume import POPULATION, design_margins, kept_result, priors_of
from shj_bayes.bench.session import MANIFEST
from shj_bayes.errors import CampaignError, RecordingError, ShjError, shown
from shj_bayes.inference.binning import runs_of
from shj_bayes.model.device import meaning_of
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.options import FitOptions, MarginOptions, PlanOptions
from shj_bayes.planning.identifiability import Doubt, Identifiability, first_answer
from shj_bayes.recording.motion import Motion, motion_of
from shj_bayes.recording.reader import read_table, recording_of
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.runs import describe, settle, to_dict
from shj_bayes.report import words
from shj_bayes.report.browse import recording_viewer
from shj_bayes.report.margins_page import shown_cards
from shj_bayes.report.sets import PLATEAUS, plain_words
from shj_bayes.report.words import ForceUnit, force_unit, unit_for
from shj_bayes.results.campaign import CampaignRecord
from shj_bayes.results.diagnosis import DiagnosisRecord, LeftOver
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import DIAGNOSIS, digests, find

FIRST_ROWS = 8  # of a file, for choosing its columns
Tell = Callable[[float | None, str], None]
Told = dict[str, Any]


def prepare() -> None:
    """Compile or load what the first answer needs, so that nobody waits for it."""
    from shj_bayes.model.simulate import Truth, simulate_device  # noqa: PLC0415  (here alone)

    runs = runs_of(simulate_device(Truth(gamma=1 / 60), seed=1, rate_Hz=10.0))
    first_answer(runs, FitOptions().device_model(len(runs), priors_of(FitOptions())))


def ready(tell: Tell) -> bool:
    """Answer, once the process has begun."""
    return True


def read_file(folder: Path, path: Path, options: Mapping[str, Any], tell: Tell) -> Told:
    """Read one file with options of `FitOptions`: what was found in it, its loops, and columns to choose from."""
    chosen = FitOptions(**options)
    told: Told = {"name": path.name, "usable": False, "error": "", "runs": [], "columns": [], "rows": [], "form": ""}
    try:
        table = read_table(path, chosen.sheet)
    except ShjError as error:
        return told | {"error": str(error)}
    told["columns"] = [column.header or column.name for column in table.columns]
    told["rows"] = [
        ["" if not np.isfinite(v) else f"{v:.6g}" for v in row]
        for row in zip(*(column.values[:FIRST_ROWS].tolist() for column in table.columns), strict=False)
    ]
    told["form"] = _digest(table.format, *told["columns"])
    try:
        recording = recording_of(table, chosen.columns, chosen.units, chosen.rate_Hz)
        recordings = settle([recording], chosen.runs)
    except ShjError as error:
        return told | {"error": str(error)}
    facts = [to_dict(one) for one in recordings]
    return told | {
        "usable": all(one.usable for one in recordings),
        "runs": facts,
        "text": "\n\n".join(map(describe, recordings, facts)),
        "viewer": recording_viewer([(one, _motion(one)) for one in recordings]),
    }


def _motion(recording: Recording) -> Motion | None:
    try:
        return motion_of(recording)
    except RecordingError:
        return None


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode("utf-8", "replace")).hexdigest()[:16]


NOTHING: Told = {"error": "", "devices": [], "pooled": False, "changed": False, "pages": []}


def overview(folder: Path, tell: Tell) -> Told:
    """Say what of the campaign is done: the verdicts and numbers of each device, and which pages there are."""
    if not (folder / MANIFEST).is_file():
        return dict(NOTHING)
    try:
        manifest = read_manifest(folder / MANIFEST)
    except ShjError as error:
        return NOTHING | {"error": str(error)}
    record = find(CampaignRecord, folder)
    devices = [_state(folder, device) for device in manifest.devices]
    done = {(name, one.name) for name, one in record.devices if one.status != "failed"} if record else set()
    fitted = {(one["set"], one["name"]) for one in devices if one["fit"]}
    there = bool(done) and (folder / "population.json").is_file()
    told = {one.name: (one.connection, one.note or "") for one in record.sets} if record else {}
    now = {device.set_name: (device.connection, device.set_note) for device in manifest.devices}
    pooled = there and done == fitted and told == now
    pages = [name for name in ("report", "margins") if pooled and (folder / f"{name}.html").is_file()]
    return NOTHING | {"devices": devices, "pooled": pooled, "changed": there and not pooled, "pages": pages}


def _state(folder: Path, device: Device) -> Told:
    """Say what is finished of a device, and unchanged since."""
    told: Told = {"set": device.set_name, "name": device.name, "fit": "", "diagnosis": "", "numbers": [], "pages": []}
    place = folder / device.folder
    kept = kept_result(device.recordings, place, asdict(device.options), device.name)
    if kept is None:
        return told
    record: FitRecord = kept.record
    left, looked = find(LeftOver, place), find(DiagnosisRecord, place / DIAGNOSIS)
    rows = map(force_unit(record).row, record.parameters)
    pages = {"report": "report.html", "diagnosis": f"{DIAGNOSIS}/diagnosis.html", "plan": "next/plan.html"}
    return told | {
        "fit": record.verdict,
        "reasons": list(record.reasons),
        "left": words.left_words(left, record.model.effects) if left else "",
        "diagnosis": looked.verdict if looked else "",
        "numbers": [
            {"name": r.name, "value": words.rounded(r.q50, r.sd), "interval": words.interval(r), "unit": r.unit}
            for r in rows
            if r.name not in record.undetermined
        ],
        "pages": [name for name, page in pages.items() if (place / page).is_file()],
        "folder": device.folder,
    }


def device_in(folder: Path, set_name: str, name: str) -> Device:
    """Find a device of the campaign."""
    return next(d for d in read_manifest(folder / MANIFEST).devices if (d.set_name, d.name) == (set_name, name))


def check(folder: Path, set_name: str, name: str, tell: Tell) -> Told:
    """Say what the recordings of a device can tell, with its most probable loop; what stands in the way of a fit."""
    device = device_in(folder, set_name, name)
    how, told = device.options, {"passed": False, "lines": [], "rows": []}
    try:
        recordings = read_device(device.recordings, how)
    except RecordingError as error:
        return told | {"reasons": [str(error)]}
    found = [f for one in recordings for f in one.findings]
    if blocking := [f.message for f in found if f.severity == "unusable"]:
        return told | {"reasons": blocking, "viewer": recording_viewer([(one, _motion(one)) for one in recordings])}
    runs = runs_of(recordings)
    said, forces_kN = first_answer(runs, how.device_model(len(runs), priors_of(how)))
    return (
        told
        | answer_words(said, how.priors)
        | {
            "passed": not said.doubts,
            "warnings": [f.message for f in found if f.severity == "warning"],
            "viewer": recording_viewer([(run.recording, run.motion) for run in runs], forces_kN),
        }
    )


DOUBTS = {
    Doubt.NEVER_SLIDES: (
        "No half-cycle slides fully, so that nothing is seen of the sliding force: its value would be that of the "
        "prior. Test with a larger amplitude, or look whether displacement and force are exchanged."
    ),
    Doubt.NO_TOP: (
        "No parameters of the law describe these recordings. Look at the loops: units, signs, and whether the columns "
        "are those of displacement and force."
    ),
}
BASE_LAW = "base law"
MOST_CONFUSIONS = 6


def answer_words(said: Identifiability, family: str) -> Told:
    """Say what recordings can tell of a device; `family` is that of the priors.

    ``reasons`` why a fit would say nothing of it, ``headline``, ``lines`` to mind before a fit, ``rows`` of a table of
    the parameters (what each is, its value, its width after and before the test), ``confusions``: what this
    displacement history cannot tell apart, with the cheapest test that would.
    """
    by_name = {row.name: row for row in said.parameters}
    unit = unit_for(by_name["Fy"].mean if "Fy" in by_name else None)
    rows = []
    for row in said.parameters:
        name, factor = unit.of(row.unit)
        sd = factor * row.sd
        rows.append(
            {
                "name": row.name,
                "meaning": meaning_of(row.name).meaning,
                "unit": "" if name == "1" else name,
                "value": words.rounded(factor * row.mean, sd),
                "expected": f"{words.rounded(factor * row.q05, sd)} to {words.rounded(factor * row.q95, sd)}",
                "before": f"{words.short(factor * row.prior_q05)} to {words.short(factor * row.prior_q95)}",
                "narrowed": f"{100.0 * row.narrowed:.2g} %",
            }
        )
    known, confusions = catalogue(), []
    for one in said.confusions[:MOST_CONFUSIONS]:
        first, second = ("the base law" if name == BASE_LAW else known[name].title for name in one.pair)
        test = next(known[name].next_test for name in one.pair if name in known)
        confusions.append(
            {"first": first, "second": second, "alike": f"{100.0 * abs(one.correlation):.0f} %", "test": test}
        )
    return {
        "reasons": [DOUBTS[doubt] for doubt in said.doubts],
        "headline": _headline(said, unit) if said.parameters else "",
        "lines": _lines(said, unit, family),
        "rows": rows,
        "confusions": confusions,
        "rmse": "" if said.rmse_kN is None else f"{said.rmse_kN:.3g} kN",
        "half_cycles": said.half_cycles,
    }


def _headline(said: Identifiability, unit: ForceUnit) -> str:
    """Say in a sentence at which force the device slides, and how stiff it is before."""
    K, Fy = (next(row for row in said.parameters if row.name == name) for name in ("K", "Fy"))
    at = f", at about {words.short(said.one_speed_mm_s)} mm/s" if said.one_speed_mm_s is not None else ""
    least = "" if said.least_kN is None else unit.shown(said.least_kN)
    slides = f"Slides at {least} or more as tested{at} (the smallest plateau of the last run). " if least else ""
    name, factor = unit.of(K.unit)
    stiff = f"{words.short(factor * K.mean)} {name}"
    return f"{slides}Fy, the force at standstill in the first run: {unit.shown(Fy.mean)}; initial stiffness: {stiff}."


def _lines(said: Identifiability, unit: ForceUnit, family: str) -> list[str]:
    """Say what to mind before a fit."""
    units = {row.name: unit.of(row.unit) for row in said.parameters}
    out = [words.remark(one, *units[one.parameter], family=family) for one in said.remarks]
    if said.one_speed_mm_s is not None:
        out.append(words.alias_words(said.one_speed_mm_s))
    if said.few_readings:
        out.append(
            f"About {said.readings_of_knee:.0f} readings of a half-cycle lie on the way from one plateau to the other: "
            "K and beta rest on few of them. Record at a higher rate, or test more slowly."
        )
    if said.least_kN is not None and said.least_sd_kN is not None:
        least, sd = unit.factor * said.least_kN, unit.factor * said.least_sd_kN
        out.append(
            f"The smallest plateau force of the last run, on which displacements rest, is "
            f"{words.rounded(least, sd)} {unit.name}, and will be known to about ± {1.645 * sd:.2g} {unit.name} (90 %)."
        )
    return out


def fit(folder: Path, set_name: str, name: str, threads: int, tell: Tell) -> Told:
    """Fit and diagnose one device as a campaign does."""
    work = Work(
        threads=threads,
        tell=lambda line: tell(None, line),
        watch=lambda share, said: tell(share, f"sampling: {said}"),
    )
    outcome = fit_one(device_in(folder, set_name, name), folder, work)
    if outcome.failures and outcome.status == "failed":
        raise CampaignError(outcome.failures[0])
    return {"verdict": outcome.verdict, "failures": list(outcome.failures)}


def pool(folder: Path, workers: int, tell: Tell) -> Told:
    """Do what `shj-bayes campaign` does: what is missing of the devices, population, margins and report."""
    manifest = read_manifest(folder / MANIFEST)
    tell(None, f"devices: {len(manifest.devices)}")
    outcomes = run_campaign(manifest, folder, workers=workers)
    tell(None, "pooling, margins and report")
    result = summarise_campaign(outcomes, folder, seed=1)
    return {"text": result.text, "usable": result.usable}


def _request(asked: Mapping[str, Any]) -> MarginOptions:
    """Options of the margins from those of a page."""
    hints, chosen = get_type_hints(MarginOptions), dict(asked)
    for name, value in asked.items():
        if name not in hints:
            raise CampaignError(f"the margins have no option {shown(name, 30)}")
        kinds = get_args(hints[name]) or (hints[name],)
        if int in kinds and not isinstance(value, int):
            raise CampaignError(f"{name.replace('_', ' ')} = {shown(value)}; it needs a whole number")
        if Path in kinds:
            chosen[name] = Path(value)
    return MarginOptions(**chosen)


@lru_cache(maxsize=2)
def _pooled(folder: Path, stamp: str, request: MarginOptions) -> PooledTests:
    return pooled_tests(folder, request)


DRIFT = ("drift", "storey_height", "lever_arm", "brace_angle_deg")
TESTS = ("amplitude_mm", "speed_mm_s", "cycles", "history", "extrapolate")  # options that need other virtual tests


def card(folder: Path, asked: Mapping[str, Any], tell: Tell) -> Told:
    """Draw up the card of each set; what needs no new pooling comes from what is kept in memory."""
    request = _request(asked)
    drawn = MarginOptions(**{name: getattr(request, name) for name in (*TESTS, *(DRIFT if request.drift else ()))})
    stamp = str(digests(folder, [*POPULATION, "campaign.json", "bench/history.*"]))
    sheet = sheet_of(_pooled(folder, stamp, drawn), request)
    return {"cards": shown_cards(sheet), "warnings": list(sheet.warnings), "history": sheet.history}


def margins(folder: Path, asked: Mapping[str, Any], tell: Tell) -> Told:
    """Draw up and write the margins, as `shj-bayes margins` does."""
    tell(None, "drawing up the margins")
    return {"text": design_margins(folder, _request(asked)).text}


def compare(folder: Path, set_a: str, set_b: str, tell: Tell) -> Told:
    """Compare two sets."""
    record, _ = compare_sets(folder, set_a, set_b)
    write_comparison(record, folder / "compare")
    first = [plain_words(row, set_a, set_b) for row in record["contrasts"] if row["quantity"] in PLATEAUS]
    return {**record, "first": first}


def plan(folder: Path, set_name: str, name: str, limits: Mapping[str, Any], tell: Tell) -> Told:
    """Plan the next test of a device within the limits of a rig."""
    place = folder / device_in(folder, set_name, name).folder
    result = plan_next([place], place / "next", PlanOptions(**limits), tell=lambda line: tell(None, line))
    return {"text": result.text}
