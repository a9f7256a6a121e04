"""Seal and open: digests of the keys are published before the diagnosis starts, the keys themselves after it."""

import hashlib
import json
import os
import secrets
from pathlib import Path
from typing import Any

from shj_bayes._util.files import read_json, write_text
from shj_bayes.errors import ProofError
from shj_validation.proof.cases import Key, canonical, draw_keys

COMMITMENT, SECRET, OPENED = "commitment.json", "secret.json", "keys.json"
SCHEMA = "shj-bayes/proof/1"


def digest_of(key: Key, nonce: str) -> str:
    """SHA-256 of a key with its nonce, which keeps a guess of the key from being checked against the digest."""
    return hashlib.sha256(canonical({"key": key.to_dict(), "nonce": nonce})).hexdigest()


def sha256(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_secret(folder: Path, seed: int, n: int) -> dict[str, Any]:
    """Write seed and nonces where only this user can read them; the fence keeps the diagnosis from the file.

    A secret that is there already is kept, so that a stopped proof goes on under the same commitment.
    """
    path = folder / SECRET
    if path.exists():
        secret: dict[str, Any] = read_json(path, ProofError)
        if (secret["seed"], secret["n"]) != (seed, n):
            raise ProofError(
                f"{folder.name} holds an unfinished proof of {secret['n']} trials, seed {secret['seed']}; "
                "give the same -n and --seed to go on, or choose another folder"
            )
        return secret
    secret = {"seed": seed, "n": n, "nonces": [secrets.token_hex(16) for _ in range(n)]}
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
    keys = draw_keys(secret["seed"], secret["n"])
    opened = {
        "schema": SCHEMA,
        "seed": secret["seed"],
        "n": secret["n"],
        "trials": [{"key": key.to_dict(), "nonce": nonce} for key, nonce in zip(keys, secret["nonces"], strict=True)],
    }
    write_text(folder / OPENED, json.dumps(opened, indent=1))
    (folder / SECRET).unlink()
    return keys


def read_opened(folder: Path) -> tuple[int, list[Key], list[str]]:
    """Seed, keys and nonces of an opened proof.

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
        return int(opened["seed"]), keys, [str(trial["nonce"]) for trial in opened["trials"]]
    except (KeyError, TypeError, ValueError) as error:
        raise ProofError(f"{OPENED} in {folder.name} is damaged ({type(error).__name__}: {error})") from error
