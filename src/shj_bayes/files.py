"""Files that are written whole or not at all, TOML files that are checked, and names that are safe everywhere."""

from __future__ import annotations

import hashlib
import os
import re
import tomllib
from pathlib import Path
from typing import Any

from shj_bayes.errors import ShjError


def write_text(path: Path, text: str) -> None:
    """Write a text file beside the old one, then put it in its place."""
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8", newline="")
    os.replace(part, path)


def read_toml(path: Path, schema: str, max_bytes: int, error: type[ShjError]) -> tuple[dict[str, Any], str]:
    """Read a TOML file of a known schema.

    Parameters
    ----------
    path : Path
        The file.
    schema : str
        What its ``schema`` key must say.
    max_bytes : int
        Largest size that is read.
    error : type
        Kind of error to raise.

    Returns
    -------
    dict, str
        Content, and the SHA-256 of the file.
    """
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise error(f"{path.name} has {size} bytes; at most {max_bytes} are read")
        raw = path.read_bytes()
        table = tomllib.loads(raw.decode("utf-8"))
    except OSError as problem:
        raise error(f"cannot read {path.name}: {problem.strerror}") from problem
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise error(f"{path.name} is not valid TOML: {problem}") from problem
    if table.get("schema") != schema:
        raise error(f"{path.name}: schema is {table.get('schema')!r}; this version reads {schema!r}")
    return table, hashlib.sha256(raw).hexdigest()


def plain_name(name: str) -> str:
    """Name without control characters, at most 80 characters long."""
    return re.sub(r"[\x00-\x1f\x7f]+", " ", name).strip()[:80] or "device"


def folder_name(name: str) -> str:
    """Name of a folder made from any text: letters, digits, dot, dash; never empty, hidden or a device of Windows."""
    slug = re.sub(r"[^A-Za-z0-9.-]+", "-", name).strip("-.").lower()[:60]
    return f"{slug}-{hashlib.sha256(name.encode('utf-8', 'replace')).hexdigest()[:6]}".strip("-")
