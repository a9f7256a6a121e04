"""Recordings as nobody makes them on purpose: cut, decimated, shifted, scaled, joined and repeated, from a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shj_bayes.recording.reader import read

SEALS = {"columns": "time=1,displacement=5,force=#7 - 49.0874*#6", "units": "ms,mm,N"}
PLATE = {"columns": "displacement=1,force=2", "units": "mm,kN", "rate_Hz": 1.0}
OPTIONS: dict[str, dict[str, object]] = {  # by folder of the public recordings
    "brfd-lehigh": {},
    "seals-tud": SEALS,
    "emps": {"columns": "time=t,displacement=qm,force=gtau*vir", "units": "s,m,N"},
    "mr-damper-utfpr": {"columns": "time=Ts,displacement=dist,force=forc", "units": "s,mm,N"},
    "quasistatic": PLATE,
}
ENDINGS = (".csv", ".csv.gz", ".txt.gz", ".mat")
LONGEST = (300, 1000, 3000, 10_000, 60_000)  # rows, and how often a case may have so many
SHARES = (0.35, 0.35, 0.20, 0.07, 0.03)
SIMULATED = "simulated"


@dataclass(frozen=True, eq=False)
class Rows:
    """Time (s), displacement (mm) and force (kN) of a run, shape (3, n)."""

    values: NDArray[np.float64]

    @property
    def n(self) -> int:
        """Rows."""
        return int(self.values.shape[1])

    def text(self) -> str:
        """As a laboratory would export it."""
        rows = "".join(f"{t:.9g},{x:.9g},{f:.9g}\n" for t, x, f in self.values.T)
        return f"time_s,displacement_mm,force_kN\n{rows}"


Change = Callable[[Rows, np.random.Generator, Callable[[], Rows]], tuple[str, Rows]]


def _cut(rows: Rows, rng: np.random.Generator, _: Callable[[], Rows]) -> tuple[str, Rows]:
    """Keep a part, from anywhere in a stroke."""
    length = max(2, int(rows.n * np.exp(rng.uniform(np.log(0.02), 0.0))))
    first = int(rng.integers(rows.n - length + 1))
    return f"cut to rows {first} to {first + length}", Rows(rows.values[:, first : first + length])


def _decimate(rows: Rows, rng: np.random.Generator, _: Callable[[], Rows]) -> tuple[str, Rows]:
    """Every so many rows."""
    every = int(np.exp(rng.uniform(np.log(2), np.log(60))))
    return f"every {every} rows", Rows(rows.values[:, ::every])


def _shift(rows: Rows, rng: np.random.Generator, _: Callable[[], Rows]) -> tuple[str, Rows]:
    """Move one channel by a constant, or the force behind the displacement."""
    which, out = int(rng.integers(4)), rows.values.copy()
    if which == 3:
        late = int(rng.integers(1, max(2, rows.n // 20)))
        out[2] = np.roll(out[2], late)
        return f"force {late} rows late", Rows(out)
    by = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(-4, 4)) * max(np.ptp(out[which]), 1e-9))
    out[which] += by
    return f"{('time', 'displacement', 'force')[which]} shifted by {by:.3g}", Rows(out)


def _scale(rows: Rows, rng: np.random.Generator, _: Callable[[], Rows]) -> tuple[str, Rows]:
    """Multiply one channel: other devices, other units, other signs."""
    which = int(rng.integers(3))
    by = float(np.exp(rng.uniform(np.log(1e-3), np.log(1e3)))) * (float(rng.choice([-1.0, 1.0])) if which else 1.0)
    out = rows.values.copy()
    out[which] *= by
    return f"{('time', 'displacement', 'force')[which]} times {by:.3g}", Rows(out)


def _join(rows: Rows, rng: np.random.Generator, other: Callable[[], Rows]) -> tuple[str, Rows]:
    """Another recording behind it, in one file; its time goes on or begins anew."""
    added = other().values.copy()
    goes_on = rng.random() < 0.7
    if goes_on:
        added[0] += rows.values[0, -1] - added[0, 0] + float(np.median(np.diff(rows.values[0])))
    return f"joined, time {'goes on' if goes_on else 'begins anew'}", Rows(np.hstack([rows.values, added]))


def _repeat(rows: Rows, rng: np.random.Generator, _: Callable[[], Rows]) -> tuple[str, Rows]:
    """The same again, in one file."""
    times = int(rng.integers(2, 5))
    span = rows.values[0, -1] - rows.values[0, 0] + float(np.median(np.diff(rows.values[0])))
    again = [rows.values + np.array([[i * span], [0.0], [0.0]]) for i in range(times)]
    return f"{times} times", Rows(np.hstack(again))


CHANGES: dict[str, Change] = {
    "cut": _cut, "decimate": _decimate, "shift": _shift, "scale": _scale, "join": _join, "repeat": _repeat,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """One combination: the files of a device, how they came about, and the options they are fitted with."""

    number: int
    words: str
    files: tuple[Rows, ...]
    options: dict[str, str]

    def write(self, folder: Path) -> list[Path]:
        """Write the files of the device, one for each run."""
        paths = [folder / f"run{i}.csv" for i, _ in enumerate(self.files, start=1)]
        for path, rows in zip(paths, self.files, strict=True):
            path.write_text(rows.text(), encoding="utf-8")
        return paths


def sources(folder: Path | None) -> list[str]:
    """Public recordings in the folder, and the simulated ones, which are always there."""
    found = [] if folder is None else [p for sub in OPTIONS for p in (folder / sub).glob("*") if p.is_file()]
    names = sorted(f"{p.parent.name}/{p.name}" for p in found if p.name.endswith(ENDINGS))
    return names or [f"{SIMULATED} {i}" for i in range(1, 9)]


def case(seed: int, number: int, folder: Path | None, *, longest: int | None = None) -> Case:
    """Make combination `number` of a seed.

    Parameters
    ----------
    seed, number : int
        Together they say what is drawn.
    folder : Path or None
        Public recordings; without, simulated ones.
    longest : int, optional
        Most rows of a file, in place of the drawn number.

    Returns
    -------
    Case
    """
    rng = np.random.default_rng([seed, number])
    names = sources(folder)
    most = longest or int(rng.choice(LONGEST, p=SHARES))

    def one() -> tuple[str, Rows]:
        name = names[int(rng.integers(len(names)))]
        return name, _thinned(_read(name, folder), most)

    name, rows = one()
    said = [name]
    # Every change comes first in its turn, so that few cases hold all kinds.
    kinds = [sorted(CHANGES)[number % len(CHANGES)], *rng.choice(sorted(CHANGES), int(rng.integers(0, 3)))]
    for kind in kinds:
        words, rows = CHANGES[kind](rows, rng, lambda: one()[1])
        said.append(words)
    rows = Rows(rows.values[:, :most]) if longest else rows
    second = rng.random()
    if second < 0.15:
        said, files = [*said, "and the same file again"], (rows, rows)
    elif second < 0.3:
        name, another = one()
        said, files = [*said, f"and then {name}"], (rows, another)
    else:
        files = (rows,)
    options = {"model": str(rng.choice(["published", "continuous"])), "priors": "general"}
    if rng.random() < 0.5:  # otherwise a file that seems to hold several runs is refused
        options["runs"] = str(rng.choice(["split", "one"]))
    return Case(number, "; ".join([*said, *map(" ".join, options.items())]), files, options)


@cache
def _read(name: str, folder: Path | None) -> Rows:
    """Give a public recording in s, mm and kN, or a simulated one."""
    if name.startswith(SIMULATED):
        return _simulated(int(name.split()[1]))
    assert folder is not None
    recording = read(folder / name, **OPTIONS[name.split("/", maxsplit=1)[0]])  # type: ignore[arg-type]
    return Rows(np.array([recording.time_s, recording.displacement_mm, recording.force_kN]))


def _simulated(number: int) -> Rows:
    """A device of the development simulators."""
    from shj_validation.proof.cases import KINDS, development_keys  # noqa: PLC0415
    from shj_validation.proof.make import make  # noqa: PLC0415

    key = development_keys(55, number, KINDS[number % len(KINDS)], rate_Hz=5.0)[-1]
    recording = make(replace(key, protocol="paper"))[0].recording
    return Rows(np.array([recording.time_s, recording.displacement_mm, recording.force_kN]))


def _thinned(rows: Rows, most: int) -> Rows:
    """Every so many rows, so that a case does not take minutes: what a laboratory does as well."""
    return Rows(rows.values[:, :: max(1, -(-rows.n // most))])
