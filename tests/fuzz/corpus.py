"""The corpus: case number and seed give the damaged file, what reads it, and with which options."""

from __future__ import annotations

import gzip
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import bombs
import damage
import numpy as np
import originals

COLUMNS = (
    *(None, None, None, "time=1,displacement=2,force=3", "time=0,displacement=99", "force=#3*#2", "force=#3/0"),
    *("force=#3 - 2*#2", "time=time_s", "time=" + "(" * 300, "force=" + "-" * 399, "force='a", "force=1e999*#3"),
    *("displacement=#" + "9" * 5000, "force=" + "9" * 5000),
)
UNITS = (None, None, None, "mm,kN,s", "in,kip,ms", "time=h", "force=V", "mm,mm", "kN**9,s", "force=1e300 kN", "\x00")
RATES = (None, None, None, None, 100.0, 1e-6, 0.0, -1.0, float("nan"), float("inf"), 1e300)


@dataclass(frozen=True)
class Case:
    """One damaged file.

    Parameters
    ----------
    number : int
        Its number in the corpus.
    kind : {"recording", "manifest", "prior", "result"}
        What reads it.
    name : str
        File name; of a result, the path below the campaign folder.
    content : bytes
        What the file holds.
    options : dict
        Reading options of a recording.
    """

    number: int
    kind: str
    name: str
    content: bytes
    options: dict[str, Any]


class Corpus:
    """All cases of a seed.

    Parameters
    ----------
    seed : int
        Same seed and number, same case.
    scratch : Path
        Folder in which the good files are made.
    results : bool
        Whether files of results are among them; they take some seconds to make.
    """

    def __init__(self, seed: int, scratch: Path, *, results: bool = True) -> None:
        self.seed = seed
        self.recordings = originals.recordings(scratch) | bombs.bombs(scratch)
        self.settings = originals.settings()
        self.results = originals.results(scratch / "campaign") if results else {}

    def case(self, number: int) -> Case:
        """Case of a number."""
        rng = np.random.default_rng([self.seed, number])
        share = rng.random()
        if self.results and share < 0.2:
            # The large files are rarely chosen: what reads them stops at their digest, and they cost the time.
            names = [name for name in self.results for _ in range(1 if len(self.results[name]) > 10**6 else 6)]
            name = damage.pick(rng, names)
            return Case(number, "result", name, self._damaged(name, self.results[name], rng), {})
        if share < 0.45:
            name = damage.pick(rng, list(self.settings))
            kind = "manifest" if name == "campaign.toml" else "prior"
            return Case(number, kind, name, self._damaged(name, self.settings[name], rng), {})
        # HDF5 is read in a process of its own, which takes most of the time: less often than the others.
        seldom = ("data.h5", "seven.mat", "nested.mat", *bombs.SAID)
        name = damage.pick(rng, [n for n in self.recordings for _ in range(1 if n in seldom else 4)])
        options = {"columns": damage.pick(rng, COLUMNS), "units": damage.pick(rng, UNITS)}
        options["rate_Hz"] = damage.pick(rng, RATES)
        if rng.random() < 0.6:
            options = dict.fromkeys(options)
        return Case(number, "recording", name, self._damaged(name, self.recordings[name], rng), options)

    def _damaged(self, name: str, raw: bytes, rng: damage.Rng) -> bytes:
        """Damage that suits the format, so that it is not always the first check that stops it."""
        share = rng.random()
        if share < 0.03:
            return damage.pick(rng, list(self.recordings.values()))  # another format under this name
        if name.endswith((".xlsx", ".npz")) and share < 0.8:
            return damage.archive_damage(raw, rng, partial(self._member, rng=rng))
        if name.endswith(".json") and share < 0.8:
            return damage.json_damage(raw, rng)
        if name.endswith(".gz") and share < 0.8:
            return gzip.compress(self._text(gzip.decompress(raw), rng), mtime=0)
        if name.endswith((".csv", ".tsv", ".txt", ".dat", ".lvm", ".toml")) and share < 0.85:
            return self._text(raw, rng)
        return damage.bytes_damage(raw, rng)

    def _member(self, content: bytes, rng: damage.Rng) -> bytes:
        return damage.bytes_damage(content, rng) if rng.random() < 0.4 else self._text(content, rng)

    @staticmethod
    def _text(raw: bytes, rng: damage.Rng) -> bytes:
        try:
            text = raw.decode("utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8")
        except UnicodeDecodeError:
            text = raw.decode("cp1252", "replace")
        changed = damage.text_damage(text, rng)
        return changed.encode("utf-8", "replace") if rng.random() < 0.7 else damage.encoded(changed, rng)
