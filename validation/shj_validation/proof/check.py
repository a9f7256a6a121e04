"""Check the transcript of a finished proof: anyone can, with one command, and needs to believe nothing."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tqdm import tqdm

from shj_bayes._util.files import read_json
from shj_bayes.errors import ProofError
from shj_validation.proof import seal
from shj_validation.proof.cases import Key, draw_keys
from shj_validation.proof.run import SCORE, TRANSCRIPT, names, score_rows, write_recordings
from shj_validation.proof.summary import summarise


def check(folder: Path, *, workers: int = 2, progress: bool = False) -> list[str]:
    """Check all digests, make every recording again, and score again.

    Parameters
    ----------
    folder : Path
        Folder of a finished proof.
    workers : int
        Processes.
    progress : bool
        Show progress bars.

    Returns
    -------
    list of str
        What was checked, in words.

    Raises
    ------
    ProofError
        At the first thing that does not agree.
    """
    opened = seal.read_opened(folder)
    keys = opened.keys
    if missing := [name for name in ("recordings", "diagnoses") if not (folder / name).is_dir()]:
        raise ProofError(
            f"{folder.name} lacks {' and '.join(missing)}; a check needs all that a proof wrote. "
            f"`shj-bayes prove -n {len(keys)} --seed {opened.seed}{seal.words_of(opened.schema)} -o DIR` writes it anew"
        )
    sealed, transcript = (read_json(folder / name, ProofError) for name in (seal.COMMITMENT, TRANSCRIPT))
    if seal.sha256(folder / seal.COMMITMENT) != transcript["commitment_sha256"]:
        raise ProofError(f"{seal.COMMITMENT} is not the one under which the diagnosis ran")
    _keys(sealed["trials"], opened)
    n_files = _recordings(folder, sealed, keys, progress)
    n = len(transcript["diagnoses"])
    _diagnoses(folder, transcript, min(n, len(keys)))
    rows = json.loads(json.dumps(score_rows(folder, keys[:n], workers, progress)))
    recorded = read_json(folder / SCORE, ProofError)
    if recorded["trials"] != rows or recorded["targets"] != json.loads(json.dumps(summarise(rows)))["targets"]:
        raise ProofError(f"{SCORE} is not what keys and diagnoses give")
    return [
        f"{len(keys)} keys follow from seed {opened.seed} and are those that were sealed before the diagnosis",
        f"{n_files} recordings made again from the keys, the same to the byte",
        f"{n} diagnoses, of the first trials, are those made before the keys were opened",
        "all scores follow from keys and diagnoses",
    ]


def _keys(trials: list[dict[str, Any]], opened: seal.Opened) -> None:
    """Check that the opened keys follow from the seed and are those that were sealed."""
    keys, seed = opened.keys, opened.seed
    if len(trials) != len(keys):
        raise ProofError(f"{len(trials)} keys were sealed, {len(keys)} are opened")
    if [key.to_dict() for key in draw_keys(seed, len(keys), opened.schema)] != [key.to_dict() for key in keys]:
        raise ProofError(f"the opened keys do not follow from seed {seed}")
    for trial, key, nonce in zip(trials, keys, opened.nonces, strict=True):
        if seal.digest_of(key, nonce) != trial["key_sha256"]:
            raise ProofError(f"trial {trial['name']}: the opened key is not the one that was sealed")


def _recordings(folder: Path, sealed: dict[str, Any], keys: list[Key], progress: bool) -> int:
    """Make every recording again and compare digests; the number of files."""
    pairs = list(zip(names(len(keys)), sealed["trials"], keys, strict=True))
    n = 0
    with TemporaryDirectory() as scratch:
        for name, trial, key in tqdm(pairs, desc="making again", disable=None if progress else True, unit="trial"):
            again = write_recordings(key, Path(scratch) / name)
            if [path.name for path in again] != [file["name"] for file in trial["files"]]:
                raise ProofError(f"trial {name}: the commitment does not list the recordings that its key gives")
            for file, path in zip(trial["files"], again, strict=True):
                if seal.sha256(folder / "recordings" / name / path.name) != file["sha256"]:
                    raise ProofError(f"trial {name}: {path.name} has been changed since it was sealed")
                if seal.sha256(path) != file["sha256"]:
                    raise ProofError(
                        f"trial {name}: {path.name} made again from its key differs; other versions of libraries can "
                        f"do that (sealed with {sealed['versions']})"
                    )
                n += 1
    return n


def _diagnoses(folder: Path, transcript: dict[str, Any], n: int) -> None:
    """Check that the diagnoses are those that stood before the keys were opened."""
    if [entry["name"] for entry in transcript["diagnoses"]] != names(n):
        raise ProofError("the transcript does not hold one diagnosis for each trial")
    for name, entry in zip(names(n), transcript["diagnoses"], strict=True):
        if seal.sha256(folder / "diagnoses" / f"{name}.json") != entry["sha256"]:
            raise ProofError(f"trial {name}: the diagnosis has been changed since the keys were opened")
