"""Seal and open: digests of the keys are published before the diagnosis starts, the keys themselves after it."""

import hashlib
import json
import os
import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shj_bayes._util.files import read_json, write_text
from shj_bayes.errors import ProofError
from shj_validation.proof.cases import DESIGNS, PROOF_1, PROOF_2, Key, canonical, draw_keys

COMMITMENT, SECRET, OPENED = "commitment.json", "secret.json", "keys.json"


@dataclass(frozen=True)
class Opened:
    """What an opened seal holds.

    Parameters
    ----------
    schema : str
        Kind of the proof, one of `DESIGNS`.
    seed : int
        What all keys follow from.
    keys, nonces : list
        Of each trial.
    """

    schema: str
    seed: int
    keys: list[Key]
    nonces: list[str]


def digest_of(key: Key, nonce: str) -> str:
    """SHA-256 of a key with its nonce, which keeps a guess of the key from being checked against the digest."""
    return hashlib.sha256(canonical({"key": key.to_dict(), "nonce": nonce})).hexdigest()


def sha256(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_secret(folder: Path, seed: int, n: int, schema: str = PROOF_2) -> dict[str, Any]:
    """Write seed and nonces where only this user can read them; the fence keeps the diagnosis from the file.

    A secret that is there already is kept, so that a stopped proof goes on under the same commitment.
    """
    path = folder / SECRET
    if path.exists():
        secret: dict[str, Any] = {"schema": PROOF_1} | read_json(path, ProofError)
        if (secret["seed"], secret["n"], secret["schema"]) != (seed, n, schema):
            raise ProofError(
                f"{folder.name} holds an unfinished proof of {secret['n']} trials, seed {secret['seed']}"
                f"{words_of(secret['schema'])}; give the same -n and --seed to go on, or choose another folder"
            )
        return secret
    nonces = [secrets.token_hex(16) for _ in range(n)]
    secret = {"schema": schema, "seed": seed, "n": n, "nonces": nonces}
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "w", encoding="utf-8") as stream:
        json.dump(secret, stream)
    return secret


def open_seal(folder: Path) -> list[Key]:
    """Publish seed, nonces and keys; from here on nothing is concealed.

    Returns
    -------
    list of Key
    """
    secret = read_json(folder / SECRET, ProofError)
    schema = secret.get("schema", PROOF_1)
    keys = draw_keys(secret["seed"], secret["n"], schema)
    opened = {
        "schema": schema,
        "seed": secret["seed"],
        "n": secret["n"],
        "trials": [{"key": key.to_dict(), "nonce": nonce} for key, nonce in zip(keys, secret["nonces"], strict=True)],
    }
    write_text(folder / OPENED, json.dumps(opened, indent=1))
    (folder / SECRET).unlink()
    return keys


def words_of(schema: str) -> str:
    """Say what must be said on the command line of a kind of proof."""
    return " --earlier" if schema == PROOF_1 else ""


def read_opened(folder: Path) -> Opened:
    """Read an opened proof.

    Raises
    ------
    ProofError
        If the proof has not been opened, or is none.
    """
    path = folder / OPENED
    if not path.exists():
        raise ProofError(f"{folder.name} has no {OPENED}: the proof is not finished; run it again to go on")
    opened = read_json(path, ProofError)
    try:
        keys = [Key.from_dict(trial["key"]) for trial in opened["trials"]]
        nonces = [str(trial["nonce"]) for trial in opened["trials"]]
        schema, seed = str(opened["schema"]), int(opened["seed"])
    except (KeyError, TypeError, ValueError) as error:
        raise ProofError(f"{OPENED} in {folder.name} is damaged ({type(error).__name__}: {error})") from error
    if schema not in DESIGNS:
        raise ProofError(f"{OPENED} in {folder.name} is of schema '{schema}'; known are {', '.join(DESIGNS)}")
    return Opened(schema, seed, keys, nonces)
