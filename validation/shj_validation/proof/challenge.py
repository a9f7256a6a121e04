"""A challenge to anyone: recordings without truth, a sheet to fill in, a seal; and what opens and scores it.

``python -m shj_validation.proof.challenge KIT`` has this project's diagnosis fill in a sheet of its own, ``ours.csv``.
"""

import csv
import gzip
import hashlib
import io
import json
import os
import secrets
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tqdm import tqdm

from shj_bayes._util.files import damage_told, read_bytes, read_json, write_text
from shj_bayes.errors import ProofError
from shj_bayes.inference.store import versions
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.results.diagnosis import DependenceId
from shj_validation.proof import seal
from shj_validation.proof.cases import CHALLENGE, Key, draw_keys
from shj_validation.proof.pool import in_parallel
from shj_validation.proof.run import write_recordings
from shj_validation.proof.score import EITHER, LIKELY, SHORT_LIST, but_for_the_machine, rate
from shj_validation.proof.simulators.simulator import ACTIONS, COORDINATES, simulators_by_id
from shj_validation.proof.truth import truth_of

SHEET, SEAL, README, OURS, RECORDINGS = "answers.csv", "seal.json", "README.txt", "ours.csv", "recordings"
COLUMNS = ("device", "missing", "coordinate", "effect", "confidence")
MISSING = {"yes": "yes", "y": "yes", "no": "no", "n": "no", "cannot tell": "cannot tell", "can't tell": "cannot tell"}
UNKNOWN = "unknown"
MOST_BYTES, MOST_ERRORS, MOST_DEVICES = 1_000_000, 10, 999
RECORDING_BYTES = 200_000_000
ACTION_WORDS = {
    "capacity": "the sliding force is multiplied by something",
    "added": "a force is added beside the friction",
    "motion": "the device, or a channel, does not follow the displacement that was recorded",
    "noise": "the scatter changes",
}
COORDINATE_WORDS = {
    "position": "where in the slot",
    "distance": "how far from the middle of the slot, to either side",
    "travel": "distance slid since the first run began",
    "time": "time since the first run began, or since each run began",
    "heat": "warmth that sliding makes and that fades",
    "amplitude": "length of the strokes",
    "slip": "distance slid since the last reversal",
    "speed": "speed",
    "speed_by_travel": "a dependence on speed that changes with the distance slid",
    "rest": "how long the contact rested",
    "acceleration": "acceleration: a mass, or friction that lags behind the speed",
    "direction": "push or pull",
    "constant": "nothing: always the same",
    "load": "the force itself",
    "passes": "how often this place was rubbed",
    "slack": "free travel at reversals",
    "second surface": "a second surface that joins in later",
    "compliance": "an elastic part in series",
    "delay": "one channel behind the other",
    "reversal": "another rule at reversals",
    "stick-slip": "sticking and slipping in fast teeth",
}
TEXT = """A challenge: what is missing?

recordings/ holds {n} devices, D01 to D{n:02d}, two runs each (time in s, displacement in mm, force in kN; .csv, or
.csv.gz which is the same packed). Every device is a friction connection: elastic up to its sliding force, then sliding.
The law that everyone knows is, in each half-cycle, with e = F_start + K (x - x_start),

    F = e / (1 + |e/Fy|^beta)^(1/beta) x (1 + gamma |speed|)

(unloading is elastic, without a jump at reversals) with K, Fy, beta, gamma of the device, and another Fy in the second
run. About half of the devices hold nothing but this law, a slightly imperfect test, and noise. Each of the others holds
one or two pieces of physics that the law leaves out: mostly from the list of effects below, some that stand in no list.
Some are too small to be seen by anyone; these are not counted. Protocols, rates (5 to 20 Hz) and noises differ.
Displacement is measured across the slip, or at a testing machine that deforms, which K takes up: it is not missing.

Fill in answers.csv, one row for each device, with any tool or by eye:

missing     yes, no, or cannot tell: is anything missing from the law?
coordinate  where missing is yes: what the force depends on, "ACTION over COORDINATE" from the tables below. Join two
            pieces of physics with +. Where two answers are equally likely: "this or that" (right if either is).
effect      may be left empty; an id from the table, joined with + for two; "unknown" for physics in no list; at most
            four alternatives joined with "or" (right if one is)
confidence  may be left empty; how sure you are of this row, 0 to 1 or with a % sign: that nothing is missing, or of the
            coordinate

Then:  shj-bayes prove --score answers.csv

ACTION
{actions}

COORDINATE
{coordinates}

EFFECT
{effects}

The seal. seal.json holds SHA-256 digests of every recording and of the truth about every device, each with a nonce. All
follows from one seed. Whoever made the kit has the seed in a file beside the kit's folder and not in it,
{opening}, and states it when the answers are in: prove --score answers.csv --seed SEED.
It protects against this: nobody can change the truth once you have the kit, and nobody can read it off the kit (a seed
that the program drew has 128 bits; one that a person chose may be guessed by trying many).
It does not protect against that: whoever has the seed has the truth, so a kit that you made yourself, or whose seed
stands in a public repository, tells about your answers only if you did not look; and whoever makes kits can make many
and show the one that suits.
"""


@dataclass(frozen=True)
class Answer:
    """One row of a sheet.

    Parameters
    ----------
    device : str
        ``D01`` and so on.
    missing : {"yes", "no", "cannot tell"}
        Whether physics is missing from the law.
    coordinates, effects : tuple of tuple of str
        Alternatives, each of one or two words.
    confidence : float or None
        Stated probability.
    """

    device: str
    missing: str
    coordinates: tuple[tuple[str, ...], ...] = ()
    effects: tuple[tuple[str, ...], ...] = ()
    confidence: float | None = None

    @property
    def cells(self) -> tuple[str, ...]:
        """Cells of the row."""
        sure = "" if self.confidence is None else f"{self.confidence:.2f}"
        return self.device, self.missing, _cell(self.coordinates), _cell(self.effects), sure


@dataclass(frozen=True)
class Scored:
    """What came out of a sheet.

    Parameters
    ----------
    record : dict
        Content of ``challenge.json``.
    """

    record: dict[str, Any]

    @property
    def text(self) -> str:
        """Rows and totals as text."""
        head = ("device", "concealed", "", "missing", "coordinate", "effect", "", "answer")
        rows = [head, *(tuple(_row_cells(row)) for row in self.record["rows"])]
        wide = [max(len(row[i]) for row in rows) for i in range(len(head))]
        lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, wide, strict=True)).rstrip() for row in rows]
        totals = self.record["totals"]
        names = list(totals)
        first = max(len(words) for words in totals[names[0]])
        lines += ["", "  ".join([" " * first, *(name.ljust(34) for name in names)]).rstrip()]
        for words in totals[names[0]]:
            cells = (_share(totals[name][words]).ljust(34) for name in names)
            lines.append("  ".join([words.ljust(first), *cells]).rstrip())
        return "\n".join([*lines, "", *self.record["seal"]])


def make_challenge(folder: Path, n: int, seed: int | None = None, *, progress: bool = False) -> Path:
    """Write a kit: recordings, empty sheet, seal and instructions; and beside it the file that opens it.

    Parameters
    ----------
    folder : Path
        Folder of the kit; it must not hold one already.
    n : int
        Number of devices, at most 999.
    seed : int, optional
        What is concealed follows from it; drawn from 128 bits if not given.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Path
        The file that opens the kit.

    Raises
    ------
    ProofError
        If the folder or the opening file is there already.
    """
    opening = opening_of(folder)
    for path in (folder / SEAL, opening):
        if path.exists():
            raise ProofError(f"{path} is there already: this would make its answers worthless; choose another folder")
    seed = secrets.randbits(128) if seed is None else seed
    keys = draw_keys(seed, n, CHALLENGE)
    (folder / RECORDINGS).mkdir(parents=True, exist_ok=True)
    devices = []
    for key in tqdm(keys, desc="making", disable=None if progress else True, unit="device"):
        files = _made(key, folder / RECORDINGS)
        digests = [{"name": path.name, "sha256": seal.sha256(path)} for path in files]
        devices.append({"device": _name(key), "key_sha256": seal.digest_of(key, _nonce(seed, key)), "files": digests})
    record = {"schema": CHALLENGE, "versions": versions(), "devices": devices}
    write_text(folder / SEAL, json.dumps(record, indent=1))
    write_sheet(folder / SHEET, [(_name(key), "", "", "", "") for key in keys])
    write_text(folder / README, _instructions(n, opening.name))
    handle = os.open(opening, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        json.dump({"schema": CHALLENGE, "seed": str(seed), "n": n}, stream)
    return opening


def opening_of(folder: Path) -> Path:
    """File beside a kit that opens it."""
    whole = folder.resolve()
    return whole.with_name(f"{whole.name}-opening.json")


def score_challenge(sheet: Path, seed: int | None = None, out: Path | None = None, *, progress: bool = False) -> Scored:
    """Open a kit and score a filled sheet, beside ours where the kit has it.

    Parameters
    ----------
    sheet : Path
        The sheet, in the folder of the kit.
    seed : int, optional
        As the maker states it; else from the file beside the kit.
    out : Path, optional
        Folder for ``challenge.json`` and ``challenge.csv``.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Scored

    Raises
    ------
    ProofError
        If the sheet is filled in wrongly, or something is not what was sealed.
    """
    kit = sheet.resolve().parent
    if not (kit / SEAL).exists():
        raise ProofError(f"{SEAL} is not beside {sheet.name}: a sheet is scored in the folder of its kit; put it there")
    sealed = _sealed(kit)
    devices = [one["device"] for one in sealed["devices"]]
    sheets = {sheet.name: read_sheet(sheet, devices)}  # before anything is opened
    if (kit / OURS).exists() and sheet.name != OURS:
        sheets[f"{OURS}, of shj-bayes"] = read_sheet(kit / OURS, devices)
    seed = _seed(kit, len(devices)) if seed is None else seed
    keys = draw_keys(seed, len(devices), CHALLENGE)
    notes = _check(kit, sealed, keys, seed)
    truths = []
    for key in tqdm(keys, desc="opening", disable=None if progress else True, unit="device"):
        truths.append(truth_of(key).required if key.effects else set[str]())
    judged = {
        name: [judge(key, required, answers[_name(key)]) for key, required in zip(keys, truths, strict=True)]
        for name, answers in sheets.items()
    }
    record: dict[str, Any] = {
        "schema": CHALLENGE,
        "seed": str(seed),
        "seal": notes,
        "totals": {name: totals(rows) for name, rows in judged.items()},
        "rows": judged[sheet.name],
        "ours": judged.get(f"{OURS}, of shj-bayes"),
    }
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "challenge.json", json.dumps(record, indent=1, allow_nan=False))
        names = list(record["rows"][0])
        table = [[row[name] for name in names] for row in record["rows"]]
        write_sheet(out / "challenge.csv", table, names)
    return Scored(record)


def judge(key: Key, required: set[str], answer: Answer) -> dict[str, Any]:
    """Hold one row against its key; None where nothing can be judged.

    What the device holds counts where it can be seen. A coordinate is right if each one named is true of something that
    is concealed and everything that can be seen has one among them; an effect likewise, and ``unknown``, or nothing
    named, where the list has no name.
    """
    known = {one.id: simulators_by_id()[one.id] for one in key.effects}
    visible = "nothing" if not known else ("visible" if required else "too small to see")
    row: dict[str, Any] = {
        "device": _name(key),
        "concealed": " + ".join(f"{one.id} {one.size:+.3g}" for one in key.effects) or "nothing",
        "visible": visible,
        "outside": bool(known) and not all(one.inside for one in known.values()),
        "protocol": key.protocol,
        "answer": ", ".join(cell for cell in answer.cells[1:4] if cell),
        "missing": None,
        "coordinate": None,
        "effect": None,
        "confidence": answer.confidence,
    }
    if visible == "too small to see":
        return row
    said = {"yes": True, "no": False}.get(answer.missing)
    row["missing"] = "not said" if said is None else said == bool(known)
    if known:
        pairs = [{tuple(DependenceId.read(word)) for word in words} for words in answer.coordinates]
        wanted = {name: set(known[name].coordinates) for name in known}
        row["coordinate"] = any(_covers(own, wanted, required) for own in pairs) if pairs else "not said"
        names = {name: set(one.names) or {UNKNOWN} for name, one in known.items()}
        names |= {name: {*one.names, UNKNOWN} for name, one in known.items() if one.may_be_unknown}
        alternatives = [set(words) for words in answer.effects]
        if not alternatives and answer.missing == "yes" and row["outside"]:
            alternatives = [{UNKNOWN}]
        row["effect"] = any(_covers(own, names, required) for own in alternatives) if alternatives else "not said"
    return row


def _covers(own: set[Any], wanted: Mapping[str, set[Any]], required: set[str]) -> bool:
    return all(wanted[name] & own for name in required) and own <= set().union(*wanted.values())


def totals(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Count rows, with intervals."""
    null = [row for row in rows if row["visible"] == "nothing"]
    seen = [row for row in rows if row["visible"] == "visible"]
    inside, outside = ([row for row in seen if row["outside"] is own] for own in (False, True))
    answered = [row for row in seen if row["coordinate"] != "not said"]

    def share(own: Sequence[Mapping[str, Any]], column: str, value: Any) -> dict[str, Any]:
        return rate(sum(row[column] is value for row in own), len(own))

    sure = [row for row in rows if row["confidence"] is not None and row["missing"] is not None]
    right = [(row["coordinate"] if row["visible"] == "visible" else row["missing"]) is True for row in sure]
    stated = sum(row["confidence"] for row in sure) / len(sure) if sure else None
    return {
        "something claimed where nothing is concealed": share(null, "missing", False),
        "called complete, of those that visibly hold something": share(seen, "missing", False),
        "cannot tell, of all that count": rate(
            sum(row["missing"] == "not said" for row in [*null, *seen]), len(null) + len(seen)
        ),
        "coordinate right, inside the list": share(inside, "coordinate", True),
        "coordinate right, outside the list": share(outside, "coordinate", True),
        "coordinate right, where one was named": share(answered, "coordinate", True),
        "effect right, inside the list": share(inside, "effect", True),
        "a name from the list for what is outside it": rate(
            sum(row["effect"] is False for row in outside), len(outside)
        ),
        "rows with a confidence: right": rate(sum(right), len(sure)) | {"stated": stated},
    }


def read_sheet(path: Path, devices: Sequence[str]) -> dict[str, Answer]:
    """Read a sheet as people leave it: commas, semicolons or tabs, byte order marks, capital letters, blanks.

    Parameters
    ----------
    path : Path
        The sheet.
    devices : sequence of str
        Those that must stand in it once.

    Returns
    -------
    dict of str to Answer

    Raises
    ------
    ProofError
        With row, column and what is allowed, for up to `MOST_ERRORS` cells.
    """
    rows = _rows(_decoded(read_bytes(path, MOST_BYTES, ProofError)))
    if not rows:
        raise ProofError(f"{path.name} is empty; its first row names the columns {', '.join(COLUMNS)}")
    (first, head), *rest = rows
    columns = [cell.lower() for cell in head]
    for name in COLUMNS:
        if columns.count(name) > 1 or (columns.count(name) == 0 and name in COLUMNS[:2]):
            found = ", ".join(filter(None, columns)) or "nothing"
            raise ProofError(f"{path.name}, row {first}: column '{name}' must stand there once; found {found}")
    answers: dict[str, Answer] = {}
    wrong: list[str] = []
    for number, cells in rest:
        given = {name: (cells[columns.index(name)] if name in columns else "") for name in COLUMNS}
        device = _device(given["device"], devices)
        try:
            if device is None or device in answers:
                problem = "stands there twice" if device else f"'{given['device']}' is no device of this kit"
                raise _CellError("device", f"{problem}; allowed is {devices[0]} to {devices[-1]}, each once")
            answers[device] = _answer(device, given)
        except _CellError as error:
            wrong.append(f"row {number}{f' ({device})' if device else ''}, column {error.column}: {error}")
    seen = {text.partition("(")[2].partition(")")[0] for text in wrong} | set(answers)
    wrong += [
        f"no row for {name}; write 'cannot tell' where you have no answer" for name in devices if name not in seen
    ]
    if wrong:
        more = f"; and {len(wrong) - MOST_ERRORS} more" if len(wrong) > MOST_ERRORS else ""
        raise ProofError(f"{path.name} is not scored: {'; '.join(wrong[:MOST_ERRORS])}{more}")
    return answers


class _CellError(ValueError):
    """A cell that is filled in wrongly."""

    def __init__(self, column: str, words: str) -> None:
        super().__init__(words)
        self.column = column


def _answer(device: str, given: Mapping[str, str]) -> Answer:
    missing = MISSING.get(given["missing"].lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'"))
    if missing is None:
        said = f"'{given['missing']}'" if given["missing"] else "empty"
        raise _CellError("missing", f"{said}; allowed is yes, no or cannot tell")
    for column in ("coordinate", "effect"):
        if given[column] and missing != "yes":
            raise _CellError(column, f"'{given[column]}' beside missing = {missing}; leave it empty, or write yes")
    places = _alternatives(given["coordinate"], "coordinate", _place, EITHER)
    effects = _alternatives(given["effect"], "effect", _effect, SHORT_LIST)
    return Answer(device, missing, places, effects, _confidence(given["confidence"]))


def _alternatives(text: str, column: str, read: Callable[[str], str], most: int) -> tuple[tuple[str, ...], ...]:
    words = " ".join(text.lower().split())
    if not words:
        return ()
    out = tuple(tuple(read(word.strip()) for word in one.split("+")) for one in words.split(" or "))
    if len(out) > most:
        raise _CellError(column, f"{len(out)} alternatives; at most {most} may be joined with 'or'")
    return out


def _place(word: str) -> str:
    action, _, coordinate = word.replace("/", " over ").partition(" over ")
    action, coordinate = action.strip(), coordinate.strip()
    if action not in ACTIONS or coordinate not in COORDINATES:
        raise _CellError(
            "coordinate",
            f"'{word}' is none; write ACTION over COORDINATE, actions {', '.join(ACTIONS)}, coordinates "
            f"{', '.join(COORDINATES)}",
        )
    return f"{action} over {coordinate}"


def _effect(word: str) -> str:
    known, word = catalogue(), word.replace(" ", "_").replace("-", "_")
    if word == UNKNOWN:
        return word
    if word not in known:
        raise _CellError("effect", f"'{word}' is no effect; allowed is {', '.join(_mechanisms())}, {UNKNOWN}, or empty")
    return known[word].mechanism


def _confidence(text: str) -> float | None:
    if not text:
        return None
    number = text.replace(",", ".").replace("%", "").strip()
    try:
        value = float(number) / (100.0 if "%" in text else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise _CellError("confidence", f"'{text}'; allowed is 0 to 1, 0 % to 100 %, or empty")
    return value


def _device(text: str, devices: Sequence[str]) -> str | None:
    """Device of a cell; a spreadsheet may have taken letters or zeros off it."""
    number = text.upper().removeprefix("D").strip()
    return next((name for name in devices if number.isdecimal() and int(name[1:]) == int(number)), None)


def _decoded(raw: bytes) -> str:
    """Text of a sheet: UTF-8 or UTF-16 with or without its mark, else as Excel for Windows writes it."""
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return raw.decode("utf-16", "replace")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("cp1252", "replace")


def _rows(text: str) -> list[tuple[int, list[str]]]:
    """Rows that hold anything, with their numbers in the file; cells without blanks around them."""
    lines = text.replace("\0", "").splitlines()
    head = next((line for line in lines if "device" in line.lower()), lines[0] if lines else "")
    comma = max(",;\t", key=head.count)
    rows = [[" ".join(cell.split()) for cell in row] for row in csv.reader(lines, delimiter=comma)]
    wide = max((len(row) for row in rows), default=0)
    whole = [(number, row + [""] * (wide - len(row))) for number, row in enumerate(rows, start=1)]
    return [(number, row) for number, row in whole if any(row) and not row[0].lower().startswith("sep=")]


def write_sheet(path: Path, rows: Sequence[Sequence[Any]], head: Sequence[str] = COLUMNS) -> None:
    """Write rows as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    write_text(path, stream.getvalue())


def answer_of(device: str, record: Mapping[str, Any]) -> Answer:
    """Row of a diagnosis: the coordinates that are more likely there than not, or the likeliest; its names.

    As for anyone, a machine that deforms is not missing.
    """
    places = [f"{entry['action']} over {entry['coordinate']}" for entry in _ranked(record)]
    if "error" in record:
        return Answer(device, "cannot tell")
    if record["verdict"] == "adequate":
        return Answer(device, "no")
    lead = [place for place, one in zip(places, _ranked(record), strict=True) if one["probability"] >= LIKELY]
    coordinates = [tuple(dict.fromkeys(lead or places[:1]))]
    sets = record.get("sets", []) if record["verdict"] == "family" else []
    if len(sets) == EITHER:
        coordinates = [tuple(one["classes"]) for one in sets]
    effects: list[tuple[str, ...]] = [(UNKNOWN,)]
    if record["verdict"] != UNKNOWN:
        names = [effect["id"] for effect in record["effects"]]
        others = [member["id"] for member in record["family"]] if len(names) == 1 else []
        effects = [tuple(names), *((name,) for name in others if name not in names)][:SHORT_LIST]
    known = catalogue()
    named = tuple(dict.fromkeys(tuple(known[n].mechanism if n in known else n for n in one) for one in effects))
    sure = max((one["probability"] for one in _ranked(record)), default=None)
    return Answer(device, "yes", tuple(one for one in coordinates if one), named, sure)


def _ranked(record: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return sorted(record.get("coordinates", []), key=lambda entry: -float(entry["probability"]))


def answer_kit(kit: Path, workers: int = 1) -> Path:
    """Have this project's diagnosis fill in a sheet, behind the fence, and write it as ``ours.csv``."""
    devices = [one["device"] for one in _sealed(kit)["devices"]]
    answers: dict[str, Answer] = {}
    tasks = [
        {"name": name, "recordings": sorted((kit / RECORDINGS).glob(f"{name}_*")), "model": "continuous"}
        for name in devices
    ]
    with tqdm(total=len(tasks), desc="diagnosing", unit="device") as bar:

        def keep(task: Mapping[str, Any], record: dict[str, Any]) -> None:
            answers[task["name"]] = answer_of(task["name"], but_for_the_machine(record))
            bar.update()

        in_parallel([{**task, "intervals": False} for task in tasks], workers, keep)
    write_sheet(kit / OURS, [answers[name].cells for name in devices])
    return kit / OURS


def _made(key: Key, folder: Path) -> list[Path]:
    """Write the recordings of a device under plain names."""
    out = []
    with TemporaryDirectory(dir=folder) as scratch:
        for path in write_recordings(key, Path(scratch)):
            out.append(path.replace(folder / f"{_name(key)}_{path.name}"))
    return out


def _sealed(kit: Path) -> dict[str, Any]:
    """Read the seal of a kit, as far as it is one."""
    sealed = read_json(kit / SEAL, ProofError)
    if not isinstance(sealed, dict) or sealed.get("schema") != CHALLENGE:
        raise ProofError(f"{SEAL} in {kit.name} is no seal of a challenge ({CHALLENGE})")
    with damage_told(f"{SEAL} in {kit.name}", ProofError):
        devices = [
            {
                "device": str(one["device"]),
                "key_sha256": str(one["key_sha256"]),
                "files": [{"name": Path(str(f["name"])).name, "sha256": str(f["sha256"])} for f in one["files"]],
            }
            for one in sealed["devices"]
        ]
    names = [_device_name(number) for number in range(1, len(devices) + 1)]
    if not 0 < len(devices) <= MOST_DEVICES or [one["device"] for one in devices] != names:
        raise ProofError(f"{SEAL} in {kit.name} must list D01, D02 ... in order, {MOST_DEVICES} devices at most")
    return {"devices": devices, "versions": sealed.get("versions")}


def _check(kit: Path, sealed: Mapping[str, Any], keys: Sequence[Key], seed: int) -> list[str]:
    """Check keys and recordings against the seal, and say what was checked."""
    same = True
    for key, one in zip(keys, sealed["devices"], strict=True):
        if seal.digest_of(key, _nonce(seed, key)) != one["key_sha256"]:
            raise ProofError(f"the truth that follows from seed {seed} is not what was sealed; ask for the seed again")
        for file in one["files"]:
            if hashlib.sha256(_content(kit / RECORDINGS / file["name"])).hexdigest() != file["sha256"]:
                raise ProofError(f"{file['name']} is not the recording that was sealed; take the kit as it was given")
        with TemporaryDirectory() as scratch:
            again = [seal.sha256(path) for path in write_recordings(key, Path(scratch))]
        same = same and again == [file["sha256"] for file in one["files"]]
    made = (
        "the same to the byte" if same else f"NOT to the byte (made with {sealed['versions']}; other libraries round)"
    )
    return [
        f"seal: the truth about {len(keys)} devices follows from seed {seed} and is what was sealed",
        f"seal: recordings are as they were sealed; made again from the truth: {made}",
    ]


def _content(path: Path) -> bytes:
    """Read a recording, packed or not."""
    if path.exists():
        return read_bytes(path, RECORDING_BYTES, ProofError)
    packed = path.with_name(f"{path.name}.gz")
    if not packed.exists():
        raise ProofError(f"{path.name} is not in the kit, nor {packed.name}; take the kit as it was given")
    with gzip.open(packed) as stream:
        return stream.read(RECORDING_BYTES)


def _seed(kit: Path, n: int) -> int:
    """Seed from the file beside a kit."""
    path = opening_of(kit)
    if not path.exists():
        raise ProofError(
            f"{path.name} is not beside the folder {kit.name}: ask whoever made the kit for its seed, and give it with "
            "--seed"
        )
    opening = read_json(path, ProofError)
    try:
        seed, devices = int(opening["seed"]), int(opening["n"])
    except (KeyError, TypeError, ValueError) as error:
        raise ProofError(
            f"{path.name} is damaged ({type(error).__name__}: {error}); give the seed with --seed"
        ) from error
    if devices != n:
        raise ProofError(f"{path.name} opens a kit of {devices} devices; {kit.name} has {n}")
    return seed


def _name(key: Key) -> str:
    return _device_name(key.number)


def _device_name(number: int) -> str:
    return f"D{number:02d}"


def _nonce(seed: int, key: Key) -> str:
    """Nonce of a key: it follows from the seed, which alone opens the kit."""
    return hashlib.sha256(f"challenge {seed} {key.number}".encode()).hexdigest()[:32]


def _mechanisms() -> dict[str, str]:
    """Effects of the list by id, with their titles."""
    titles: dict[str, str] = {}
    for effect in catalogue().values():
        titles.setdefault(effect.mechanism, effect.title)
    return titles


def _instructions(n: int, opening: str) -> str:
    tables = (ACTION_WORDS, COORDINATE_WORDS, _mechanisms())
    lines = ("\n".join(f"{word:16} {what}" for word, what in table.items()) for table in tables)
    return TEXT.format(n=n, opening=opening, **dict(zip(("actions", "coordinates", "effects"), lines, strict=True)))


def _cell(alternatives: Sequence[Sequence[str]]) -> str:
    return " or ".join(" + ".join(words) for words in alternatives)


def _row_cells(row: Mapping[str, Any]) -> list[str]:
    words = {True: "right", False: "WRONG", None: "-", "not said": "not said"}
    marks = [words[row[column]] for column in ("missing", "coordinate", "effect")]
    return [row["device"], row["concealed"], row["visible"].replace("nothing", ""), *marks, "|", row["answer"]]


def _share(entry: Mapping[str, Any]) -> str:
    if not entry["n"]:
        return "none"
    stated = f", stated {100 * entry['stated']:.0f} %" if entry.get("stated") is not None else ""
    interval = f"{100 * entry['low']:.0f} to {100 * entry['high']:.0f} %"
    return f"{entry['hits']} of {entry['n']} ({interval}{stated})"


if __name__ == "__main__":
    print(answer_kit(Path(sys.argv[1])))
