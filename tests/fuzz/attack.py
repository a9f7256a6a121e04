"""What is done with a damaged file, and what counts as a breach."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import time
from pathlib import Path

import h5py
from corpus import Case

from shj_bayes.app.manifest import read_manifest
from shj_bayes.app.resume import earlier
from shj_bayes.errors import ShjError
from shj_bayes.inference import sampler as checkpoint
from shj_bayes.margins.history import from_file
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import device_from_fit
from shj_bayes.population.results import load_population
from shj_bayes.recording.runs import check_recording
from shj_bayes.report.campaign import render_campaign
from shj_bayes.report.device import render_device

SLOW_S = 10.0  # of work
LARGE_KB = 1_500_000  # of memory, of this process or of one that it started
A_SET = "Brass"  # of the population
HISTORY_EVERY = 3  # every so many recordings are also read as displacement histories
RENDER_EVERY = 25  # drawing takes seconds; every so many results are also shown


def attack(case: Case, folder: Path, good: Path | None = None) -> str:
    """Read one case as a user would.

    Parameters
    ----------
    case : Case
        The damaged file.
    folder : Path
        Empty folder of its own.
    good : Path, optional
        Good campaign folder, for results.

    Returns
    -------
    str
        ``"read"`` or ``"refused"``, or the breach in words, beginning with ``"BREACH"``.
    """
    before = _memory_kb()
    begin = time.process_time()  # not the clock: on a busy machine it would show the others
    try:
        word = _ATTACKS[case.kind](case, folder, good)
    except ShjError as error:
        word = _refusal(str(error), case)
    except BaseException as error:  # a traceback is exactly what is looked for
        place = _place(error)
        word = f"BREACH {type(error).__name__} at {place}: {str(error)[:120]!r}"
    taken = time.process_time() - begin
    if before < LARGE_KB <= _memory_kb():
        return f"BREACH {_memory_kb() / 1e6:.1f} GB for {case.name}"
    return f"BREACH {taken:.0f} s for {case.name}" if taken > SLOW_S else word


def _memory_kb() -> int:
    """Most memory so far."""
    return max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def _place(error: BaseException) -> str:
    """Last line of our own in the traceback."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        code = trace.tb_frame.f_code
        if "shj_bayes" in code.co_filename:
            place = f"{Path(code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _refusal(message: str, case: Case) -> str:
    """A refusal is one line without control characters that names the file or the option, and says what to do."""
    if re.search(r"[\x00-\x1f\x7f-\x9f]", message):
        return f"BREACH control characters in {message[:120]!r}"
    if len(message) > 1200:
        return f"BREACH {len(message)} characters: {message[:120]!r}"
    named = Path(case.name).name in message or "--" in message
    if not named:
        return f"BREACH nothing named in {message[:160]!r}"
    return "refused"


def _recording(case: Case, folder: Path, _: Path | None) -> str:
    path = folder / case.name
    path.write_bytes(case.content)
    if case.number % HISTORY_EVERY == 0:
        try:
            from_file(path)
        except ShjError as error:
            if (said := _refusal(str(error), case)) != "refused":
                return said
    results = check_recording(path, **case.options)
    for facts, text in results:
        json.dumps(facts, allow_nan=False)
        if re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", text):
            return f"BREACH control characters in {text[:200]!r}"
        if "error" in facts:
            return _refusal(facts["error"], case)
        text.encode("utf-8")
    return "read" if all(facts["usable"] for facts, _ in results) else "refused"


def _manifest(case: Case, folder: Path, _: Path | None) -> str:
    path = folder / case.name
    path.write_bytes(case.content)
    manifest = read_manifest(path)
    for device in manifest.devices:
        target = (folder / device.folder).resolve()
        if not target.is_relative_to(folder.resolve() / "devices"):
            return f"BREACH {device.folder!r} leaves the folder"
    return "read"


def _prior(case: Case, folder: Path, _: Path | None) -> str:
    path = folder / case.name
    path.write_bytes(case.content)
    for prior in read_priors(path).priors.values():
        prior.distribution.ppf([0.1, 0.9])
    return "read"


def _result(case: Case, folder: Path, good: Path | None) -> str:
    assert good is not None
    place = Path(shutil.copytree(good, folder / "campaign", copy_function=os.link))
    (place / case.name).unlink()
    (place / case.name).write_bytes(case.content)
    if case.number % 2:  # as if written by a version that knew no digests
        _without_digests(place / "population.json", "draws_sha256")
        _without_digests(place / "devices/one/fit.json", "files")
        _without_digests(place / "campaign.json", "")
    if case.name.startswith("population"):
        load_population(place)
        earlier(f"{place}#{case.number}" if case.number % 3 == 0 else f"{place}#{A_SET}")
    elif case.name == "campaign.json":
        render_campaign(place)
    elif case.name.endswith("checkpoint.h5"):
        with h5py.File(good / case.name, "r") as file:
            identity = {k.partition(".")[2]: v for k, v in file.attrs.items() if k.startswith("fingerprint.")}
        checkpoint.load(place / case.name, identity)
    else:
        device_from_fit(place / "devices/one", "one", "bare")
        if case.number % RENDER_EVERY == 0 or case.name.endswith(("fit.json", "posterior.nc")):
            render_device(place / "devices/one")
    return "read"


def _without_digests(path: Path, other: str) -> None:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        kept = {key: value for key, value in record.items() if key not in ("digest", other)}
    except (ValueError, AttributeError, RecursionError):
        return
    path.unlink()  # it is a link to the good file
    path.write_text(json.dumps(kept), encoding="utf-8")


_ATTACKS = {"recording": _recording, "manifest": _manifest, "prior": _prior, "result": _result}
