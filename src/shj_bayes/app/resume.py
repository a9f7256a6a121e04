"""What is there already: fits and margins that stand, recognised without what making them needs; posteriors as priors.

An earlier posterior is a prior of the same device, or of the set that a new one belongs to. The noise keeps the priors
of its family: it belongs to the laboratory, not to the device. So does beta, whose law has ends: an earlier interval as
a law with ends would forbid what lies beyond it.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import shj_bayes
from shj_bayes._util.files import damage_told, file_digest, need_population, plain_name, shipped
from shj_bayes.errors import InferenceError, PopulationError, PriorError, did_you_mean
from shj_bayes.model.parameters import base_of, base_parameters
from shj_bayes.options import PLAIN, FitOptions, MarginOptions
from shj_bayes.recording.reader import by_ending
from shj_bayes.recording.recording import Finding, Recording
from shj_bayes.report import words
from shj_bayes.report.words import force_unit
from shj_bayes.results.campaign import CampaignRecord, read_campaign
from shj_bayes.results.codec import to_json
from shj_bayes.results.diagnosis import LeftOver
from shj_bayes.results.fit import FitRecord, Trust
from shj_bayes.results.store import check_files, content_of, digests, find, has, made, read

if TYPE_CHECKING:
    from shj_bayes.model.priors import Priors


class CommandResult(NamedTuple):
    """What a command made."""

    record: Any  # for machines: the record, or content, of the file that it wrote
    text: str  # what a person wants to read at the end
    fresh: bool = True  # False where an earlier, unchanged result was found and kept
    usable: bool = True  # False where no device of a campaign could be used
    note: str = ""  # why an earlier result was not kept although it is of the same fit: which file was damaged


def device_text(folder: Path, record: FitRecord, note: str = "") -> str:
    """Say what a fit found, with what its page, where there is one, says of the residual."""
    shown, left = force_unit(record), find(LeftOver, folder)
    # The word of the calculation does not stand alone: a converged fit of a wrong model is no reliable answer.
    fit = f"; {words.FIT[left.grade][0]}: {words.fit_words(left)}" if left else ""
    lines = [f"{record.device}: {record.verdict}{fit}"]
    lines += [f"  {reason}" for reason in record.reasons]
    said = words.left_words(left, record.model.effects) if left else ""
    lines += [f"  {extra}" for extra in (said, note) if extra]
    units = {row.name: shown.of(row.unit) for row in record.parameters}
    family = record.model.priors
    lines += [f"  warning: {words.remark(r, *units[r.parameter], family=family)}" for r in record.remarks]
    width = max(len(row.name) for row in record.parameters) + 1
    lines += ["", f"  {'':{width}}{'mean':>12}{'sd':>11}{'5 %':>12}{'95 %':>12}  unit"]
    for row in map(shown.row, record.parameters):
        numbers = f"{row.mean:12.5g}{row.sd:11.2g}{row.q05:12.5g}{row.q95:12.5g}  {row.unit}"
        if base_of(row.name) == "gamma":
            numbers += f"  ({words.dep_words(row.q05, row.q95)})"
        if row.name in record.undetermined:
            numbers = f"{'not determined':>47}  {row.unit}"
        lines.append(f"  {row.name:{width}}{numbers}")
    notes = [f for run in record.inputs for f in run.findings if f.severity != "note"]
    lines += dict.fromkeys(f"  {finding.severity}: {finding.message}" for finding in notes)
    return "\n".join([*lines, "", f"report: {folder / 'report.html'}"])


def kept_result(
    paths: Sequence[Path], folder: Path, options: Mapping[str, Any], name: str | None
) -> CommandResult | None:
    """Give the result of the same fit, finished earlier; None where it has to be made, or made whole."""
    there = has(FitRecord, folder) and (folder / "report.html").is_file()
    if not there or options["priors_from"] is not None:
        return None
    priors = Path(options["priors"])
    priors = priors if priors.suffix == ".toml" else shipped("priors", f"{priors}.toml")
    try:
        digests = [file_digest(path) for path in (*paths, priors)]
    except (OSError, ValueError):  # told by whoever reads them
        return None
    name = name_of_device(name, paths[0].name)
    record, _ = finished_record(folder, key_of(digests[:-1], options, digests[-1], name))
    return None if record is None else CommandResult(record, device_text(folder, record), fresh=False)


def key_of(
    digests: Sequence[str], options: Mapping[str, Any], priors_sha256: str, name: str, *, speed: bool = True
) -> str:
    """Digest of all that a result depends on: recordings in order, `FitOptions`, priors, name, `speed` of the law."""
    # Of a prior file its name and digest count, not where it lies: the folder may be reached by another path.
    chosen = {**options, "priors": Path(options["priors"]).name, "effects": sorted(options["effects"])}
    content = [list(digests), chosen, priors_sha256, name, speed, shj_bayes.__version__, sorted(base_parameters())]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def name_of_device(given: str | None, file: str) -> str:
    """Name that was given, or that of the first file without its endings (a dot inside the name stays)."""
    endings = "|".join(map(re.escape, (*by_ending(), ".gz")))
    return plain_name(given or re.sub(f"({endings})+$", "", file, flags=re.IGNORECASE))


def finished_record(folder: Path, key: str) -> tuple[FitRecord | None, str]:
    """Record of an unchanged finished fit, or None; and, where files of a fit were damaged, which and how."""
    if not has(FitRecord, folder):
        return None, ""
    try:
        record = read(FitRecord, folder)
        check_files(folder, record)
    except InferenceError as error:
        return None, f"done anew: {error}"
    return (record, "") if record.key == key else (None, "")


POPULATION = ("population.csv", "population.json", "population.npz")
POOLS = ("pool.npz", "pool-history.npz")  # of the tests that devices went through, and of another history
PAGE = "margins.html"
_OF_MARGINS = (".csv", ".xlsx", ".json", "-devices.csv", "-amplitude.csv")
MARGINS = (*(f"margins{ending}" for ending in _OF_MARGINS), "loops.csv", PAGE)


def design_margins(folder: Path, request: MarginOptions = PLAIN, *, progress: bool = False) -> CommandResult:
    """Draw up and write the margins of a folder that ``campaign`` or ``tables`` wrote.

    `PopulationError` if a set that was asked for is not there, or a cycle was not tested; nothing is written then.
    """
    need_population(folder)

    def draw_up() -> str:
        # Virtual tests, codes and pictures need most of scipy, which margins that stand need not load.
        from shj_bayes.app.design import drawn_up  # noqa: PLC0415

        return drawn_up(folder, request, progress=progress)

    chosen = asdict(request)
    for name in ("slip", "history", "drift"):
        if path := chosen[name]:
            chosen[name] = [str(path), file_digest(path)]
    rests_on = [chosen, digests(folder, POPULATION), campaign_inputs(folder)]
    text = made(folder, "margins", rests_on, MARGINS, draw_up)
    return CommandResult(content_of(folder / "margins.json", PopulationError), text)


def campaign_inputs(folder: Path) -> dict[str, Any]:
    """Give all that the pages of a campaign rest on: what ``campaign.json`` says, and the files of its devices.

    A device that was kept is one that was done. The published tables have no devices.
    """
    if not has(CampaignRecord, folder):
        return {}
    record = read_campaign(folder)
    files = {device.folder: digests(folder, [f"{device.folder}/**/*"]) for _, device in record.devices}
    content = to_json(replace(record, digest=""))
    for device in (device for group in content["sets"] for device in group["devices"]):
        device["status"] = {"kept": "done"}.get(device["status"], device["status"])
    return {"campaign": content, "files": files}


LAW = ("K", "Fy", "gamma", "ratio")
NINETY = 3.289707  # standard deviations from 5 to 95 % of a normal law
LEAST_SPREAD = 0.01  # of a factor: no two tests of one device agree better


@dataclass(frozen=True)
class Earlier:
    """What is known from earlier tests."""

    statement: str  # of which device or set
    bands: Mapping[str, Sequence[float]]  # 5, 50 and 95 % by parameter of the law
    sha256: str  # digest of the files it comes from
    recordings: frozenset[str]  # digests of the recordings that it rests on

    def __post_init__(self) -> None:
        """Refuse bands that are none."""
        for name, (low, middle, high) in self.bands.items():
            if not (-math.inf < low < middle < high < math.inf and (low > 0 or name == "gamma")):
                raise PriorError(
                    f"{name} of {self.statement} has 5, 50 and 95 % at {low:g}, {middle:g}, {high:g}; they must be "
                    "finite, grow and, but for gamma, be above zero; run the command again that made it"
                )

    def on(self, family: Priors) -> Priors:
        """Priors of a family with the laws of these parameters in place of its own."""
        own = {}
        for name, (low, middle, high) in self.bands.items():
            if name == "gamma":
                law, spread = "normal", max((high - low) / NINETY, 1e-6)
            else:
                law, spread = "lognormal", max(math.log(high / low) / NINETY, LEAST_SPREAD)
            source = f"Posterior of {self.statement}."
            own[name] = replace(family.of(name), name=name, law=law, a=middle, b=spread, source=source, earlier=True)
        return replace(
            family,
            family=f"{family.family}, and the posterior of {self.statement}",
            statement=f"{family.statement} Taken from earlier tests: {', '.join(own)}, of {self.statement}.",
            sha256=hashlib.sha256(f"{family.sha256} {self.sha256}".encode()).hexdigest(),
            earlier=own,
        )

    def remarked(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Warn of recordings that the prior rests on already: their evidence would count twice."""

        def warned(recording: Recording) -> Recording:
            message = (
                f"{recording.source.name} is in the posterior of {self.statement}, which is the prior here: what "
                "it says counts twice, and the intervals are too narrow; give recordings that are new"
            )
            return recording.with_findings(Finding("recording-in-prior", "warning", message))

        return [warned(one) if one.source.sha256 in self.recordings else one for one in recordings]


def priors_of(options: FitOptions) -> Priors:
    """Priors of the family, with what earlier tests say where they are named."""
    from shj_bayes.model.priors import read_priors  # noqa: PLC0415  (needs scipy)

    family = read_priors(options.priors)
    return family if options.priors_from is None else earlier(options.priors_from).on(family)


def check_priors(options: FitOptions, n_runs: int) -> None:
    """Refuse priors that cannot be read, or that lack a law that a device of so many runs needs."""
    assert options.device_model(n_runs, priors_of(options)).laws


def earlier(where: str) -> Earlier:
    """Read what earlier tests say, from the folder of a fit, or of a campaign with ``#SET`` behind it.

    `PriorError` if there is neither, or no such set; `InferenceError` if the fit is damaged.
    """
    from shj_bayes.population.quantities import band_of  # noqa: PLC0415  (needs scipy)
    from shj_bayes.results.device import read_group  # noqa: PLC0415  (needs h5py)

    name, _, chosen = where.partition("#")
    folder = Path(name)
    if not has(FitRecord, folder):
        if (folder / "population.json").is_file():
            return _of_set(folder, chosen)
        raise PriorError(f"--priors-from {name}: there is no fit and no campaign in it; name the folder given to -o")
    if chosen:
        raise PriorError(f"--priors-from {where}: {name} is the fit of one device and has no sets; leave #{chosen} out")
    record, draws = read(FitRecord, folder), read_group(folder, "posterior")
    if record.verdict == Trust.UNUSABLE:
        raise PriorError(f"--priors-from {folder.name}: its posterior is unusable; run that fit again first")
    bands = {n: band_of(values) for n, values in draws.items() if n in LAW or n.startswith("ratio_")}
    return Earlier(f"device {record.device}", bands, record.digest, frozenset(map(str, record.sha256_of_inputs)))


def _of_set(folder: Path, chosen: str) -> Earlier:
    """Read what is known of a new device of a set, by its name in any case, or of the only one there is."""
    from shj_bayes.population.hierarchy import ANY_SET  # noqa: PLC0415
    from shj_bayes.population.results import PopulationRecord  # noqa: PLC0415  (needs half of scipy)

    record = read(PopulationRecord, folder)
    with damage_told(f"population.json in {folder.name}", PriorError):
        sets = {one.name: one for one in record.sets if one.name != ANY_SET}
        alike = [name for name in sets if name.casefold() == chosen.casefold() or (not chosen and len(sets) == 1)]
        if chosen not in sets and len(alike) != 1:
            said = f"has no set '{chosen}'" if chosen else "holds several sets"
            hint = did_you_mean(chosen, sets) if chosen else f"; write {folder}#SET"
            raise PriorError(f"--priors-from: {folder.name} {said}; there are {', '.join(sets)}{hint}")
        name = chosen if chosen in sets else alike[0]
        bands = sets[name].new_device
        known = {q: tuple(float(bands[q][key]) for key in ("q05", "q50", "q95")) for q in LAW if q in bands}
    fits = []  # none where the population rests on published tables
    if has(CampaignRecord, folder):
        places = [folder / device.folder for of, device in read_campaign(folder).devices if of == name]
        fits = [read(FitRecord, place) for place in places if has(FitRecord, place)]
    recordings = frozenset(str(sha256) for fit in fits for sha256 in fit.sha256_of_inputs)
    return Earlier(f"a new device of set {name}", known, file_digest(folder / PopulationRecord.FILE), recordings)
