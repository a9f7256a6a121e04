"""Ways to damage a file: bytes, lines and cells of text, members of archives, nodes of JSON. All from one stream."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

Rng = np.random.Generator
NASTY = (
    *("", " ", "nan", "inf", "-inf", "1e400", "-1e-400", "1e308", "0", "-0.0", "1.5D+03", "1_000", "0x1F", "1,234.5"),
    *("1.234,5", "1'234.5", "1 234,5", "\u0661\u0662", "--", "#REF!", "=cmd|' /C calc'!A0", "@SUM(A1)", '"', "'", '""'),
    *("9" * 400, "9" * 5000, "1e" + "9" * 30, "0." + "3" * 3000, "\x00", "\x1b[31m", "\x85", "\u2028", "\ufeff"),
    *(
        "<script>alert(1)</script>",
        "../../etc/passwd",
        "true",
        "2026-11-21",
        "12:00:01",
        "[" * 3000,
        "{" * 500,
        "a" * 9000,
    ),
    *("-1", "1e-320", "\uff1d1+1", "0x" + "f" * 5000, "\r" * 300_000, "\n#" * 150_000, "../../.."),
    *('"/etc/passwd"', "'yes'"),
)
SEPARATORS = (",", ";", "\t", " ", "|", "\n", "\r", "\r\n", "\x0b", "\x00")


def pick(rng: Rng, values: Any) -> Any:
    """One of several."""
    return values[int(rng.integers(len(values)))]


def bytes_damage(raw: bytes, rng: Rng) -> bytes:
    """Bits flipped, pieces cut, doubled, blanked, moved; several times."""
    content = bytearray(raw)
    for _ in range(int(rng.integers(1, 5))):
        n = len(content)
        if n == 0:
            break
        at, size = int(rng.integers(n)), int(2 ** rng.uniform(0, 10))
        kind = int(rng.integers(8))
        if kind == 0:
            content[at] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            content[at : at + min(size, 16)] = rng.bytes(min(size, 16, n - at))
        elif kind == 2:
            del content[at : at + size]
        elif kind == 3:
            content[at:at] = content[at : at + size]
        elif kind == 4:
            content[at : at + size] = bytes([pick(rng, (0, 255, 32, 10))]) * size
        elif kind == 5:
            del content[at:]
        elif kind == 6:
            content[at:at] = rng.bytes(min(size, 64))
        else:  # a number of an offset or a size is made very large
            content[at : at + 4] = pick(
                rng, (b"\xff\xff\xff\x7f", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\0\0\0\0")
            )
    return bytes(content)


def text_damage(text: str, rng: Rng) -> str:
    """Cells replaced, lines lost, doubled, moved, joined, glued to something else."""
    lines = text.split("\n")
    for _ in range(1 if rng.random() < 0.5 else int(rng.integers(2, 6))):
        at = int(rng.integers(len(lines)))
        kind = int(rng.integers(9))
        if kind <= 2:  # a cell becomes something else, most often the case
            separator = pick(rng, (",", ";", "\t", " ", "=", '"'))
            cells = lines[at].split(separator)
            cells[int(rng.integers(len(cells)))] = pick(rng, NASTY)
            lines[at] = separator.join(cells)
        elif kind == 3:
            del lines[at : at + int(rng.integers(1, 30))]
        elif kind == 4:
            lines[at:at] = lines[at : at + int(rng.integers(1, 30))]
        elif kind == 5:
            other = int(rng.integers(len(lines)))
            lines[at], lines[other] = lines[other], lines[at]
        elif kind == 6:
            lines[at] = lines[at].replace(pick(rng, (",", ";", "\t", ".")), pick(rng, SEPARATORS))
        elif kind == 7:
            lines.insert(at, pick(rng, NASTY) + pick(rng, SEPARATORS) + pick(rng, NASTY))
        else:
            lines = [line.replace(pick(rng, (",", ".", "e", "[")), pick(rng, SEPARATORS)) for line in lines]
        if not lines:
            lines = [""]
    return "\n".join(lines)


def encoded(text: str, rng: Rng) -> bytes:
    """Text in one of the usual encodings, or in a wrong one."""
    encoding = pick(
        rng, ("utf-8", "utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "utf-32", "cp037")
    )
    return text.encode(encoding, "replace")


def archive_damage(raw: bytes, rng: Rng, change: Callable[[bytes], bytes]) -> bytes:
    """One member of a zip changed, with sums that are right again, so that the change is seen by what reads it."""
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(raw)) as old, zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as new:
        names = old.namelist()
        target = pick(rng, names)
        for name in names:
            content = old.read(name)
            if name != target:
                new.writestr(name, content)
            elif rng.random() < 0.9:  # else the member is missing
                new.writestr(name, change(content))
    return stream.getvalue()


def json_damage(raw: bytes, rng: Rng) -> bytes:
    """Nodes of a JSON document replaced, deleted or added."""
    document = json.loads(raw)
    values: tuple[Any, ...] = (None, True, -1, 0, 10**400, 1e308, "", "x" * 9000, [], {}, [[]], {"a": 1}, *NASTY[:30])
    for _ in range(int(rng.integers(1, 4))):
        node, depth = document, int(rng.integers(1, 7))
        for _ in range(depth):
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys:
                break
            key = pick(rng, keys)
            if isinstance(node[key], (dict, list)) and node[key] and rng.random() < 0.8:
                node = node[key]
                continue
            if rng.random() < 0.3 and isinstance(node, dict):
                del node[key]
            else:
                node[key] = pick(rng, values)
            break
    return json.dumps(document).encode()
