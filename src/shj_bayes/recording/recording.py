"""A recording: one test run of one device, in the units the rest of the tool works in (s, mm, kN)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray, frozen
from shj_bayes.errors import RecordingError, plain_text
from shj_bayes.recording.limits import GAP_STEPS

Severity = Literal["note", "assumed", "repaired", "warning", "unusable"]


@dataclass(frozen=True)
class Finding:
    """One thing that a check found, assumed or repaired, in words a laboratory engineer can act on."""

    code: str  # short stable name, ``"time-repeats"``
    severity: Severity  # what was done about it
    message: str  # one sentence with values and units
    count: int = 0  # samples concerned, 0 when it is not about samples

    def __post_init__(self) -> None:
        """Take out of a message what a file may have smuggled into it."""
        object.__setattr__(self, "message", plain_text(self.message))


@dataclass(frozen=True)
class Source:
    """Where a recording came from."""

    name: str  # file name without folders
    sha256: str = ""  # digest of the file as read; empty for recordings made in memory
    format: str = "simulated"  # id of the file format, ``csv``, ``xlsx`` ..., or ``simulated``
    # role (time, displacement, force) to the column or expression it was read from
    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)  # role to the unit it was read in

    def __post_init__(self) -> None:
        """Names of files and columns are text from outside: keep what can be shown and written."""
        object.__setattr__(self, "name", plain_text(self.name))
        for key in ("columns", "units"):
            object.__setattr__(self, key, {role: plain_text(text) for role, text in getattr(self, key).items()})


@dataclass(frozen=True, eq=False)
class Column:
    """A column, matrix or single number of a file, or what a formula makes of them."""

    name: str  # name in the file, without the unit where the unit could be told apart; ``"#3"`` without a header
    # numbers, shape (n_rows,), NaN where the cell was empty or held no number; () of a single number; empty for none
    values: FloatArray
    unit: str | None = None  # unit as written in the file
    header: str = ""  # header as written, name and unit together
    n_words: int = 0  # cells that hold text and no number
    group: str = ""  # group, struct or the like of the file that holds it
    clock_s: FloatArray | None = None  # times of its values where it has its own, shape (n_rows,), s
    clock_told: bool = True  # whether the file says that these are seconds
    parts: tuple[Column, ...] = ()  # columns that it was made of

    @property
    def label(self) -> str:
        """What the file calls it."""
        return self.header or self.name

    @property
    def made_of(self) -> tuple[Column, ...]:
        """Columns of the file in it: itself, or those of a formula."""
        return self.parts or ((self,) if self.values.ndim else ())


@dataclass(frozen=True, eq=False)
class Recording:
    """One test run of one device, or several that `shj_bayes.recording.runs.split` takes apart.

    Parameters
    ----------
    time_s, displacement_mm, force_kN : array_like, shape (n_samples,)
        The channels; copied and made read-only. Time increases strictly.
    used : array_like of bool, shape (n_samples,), optional
        False where a sample was filled in or is clipped: it drives the motion but is no evidence.
    source : Source, optional
        Where it came from.
    findings : tuple of Finding
        What was found, assumed and repaired on the way in.
    run_starts : dict of int to float
        First samples of further runs, where the file itself tells them apart (time that begins again, a run column),
        and what was added to their times, so that they follow those of the run before, s.
    extras : tuple of Column
        Further channels that were asked for (bolt tension, temperature ...), by the names given with ``--columns``: at
        the samples of the recording, NaN where there is no number near; a force, such as ``tension``, in kN.
    """

    time_s: FloatArray
    displacement_mm: FloatArray
    force_kN: FloatArray
    used: BoolArray | None = None
    source: Source = field(default_factory=lambda: Source("in memory"))
    findings: tuple[Finding, ...] = ()
    run_starts: dict[int, float] = field(default_factory=dict)
    extras: tuple[Column, ...] = ()

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        n = np.size(self.time_s)
        for name in ("time_s", "displacement_mm", "force_kN"):
            values = frozen(getattr(self, name))
            if values.shape == (n,) and not np.all(np.isfinite(values)):
                bad = int(np.flatnonzero(~np.isfinite(values))[0])
                raise RecordingError(
                    f"{name} is {values[bad]} at sample {bad}; fill or drop such samples before making a Recording"
                )
            object.__setattr__(self, name, values)
        object.__setattr__(self, "used", frozen(np.ones(n) if self.used is None else self.used, np.bool_))
        extras = tuple(
            replace(one, name=plain_text(one.name), unit=plain_text(one.unit or ""), values=frozen(one.values))
            for one in self.extras
        )
        object.__setattr__(self, "extras", extras)
        channels = {name: getattr(self, name) for name in ("time_s", "displacement_mm", "force_kN", "used")}
        for name, values in {**channels, **{extra.name: extra.values for extra in extras}}.items():
            if values.shape != (n,):
                raise RecordingError(f"{name} has shape {values.shape}; all channels need shape ({n},)")
        if n < 2 or np.any(np.diff(self.time_s) <= 0):
            raise RecordingError(f"time_s needs at least 2 strictly increasing values; got {n} samples")
        edges = [0, *self.run_starts, n]
        if any(b <= a for a, b in pairwise(edges)):
            raise RecordingError(f"run_starts at samples {edges[1:-1]}; they need to increase from 1 to {n - 1}")

    @classmethod
    def read(
        cls,
        path: str | Path,
        *,
        columns: str | None = None,
        units: str | None = None,
        rate_Hz: float | None = None,
        sheet: str | None = None,
    ) -> Recording:
        """Read a file; the same as `shj_bayes.recording.reader.read`, where the parameters and errors are described."""
        from shj_bayes.recording.reader import read  # noqa: PLC0415  the reader makes recordings, so it imports this

        return read(path, columns=columns, units=units, rate_Hz=rate_Hz, sheet=sheet)

    def _repr_html_(self) -> str:
        """Facts and findings as a small table, for notebooks."""
        unit, factor = unit_of(self.force_kN)
        x, f = self.displacement_mm, self.force_kN * factor
        rows = [
            ("samples", f"{self.n_samples} at {self.rate_Hz:.4g} Hz, {self.duration_s:.4g} s"),
            ("displacement", f"{x.min():.4g} to {x.max():.4g} mm"),
            ("force", f"{f.min():.4g} to {f.max():.4g} {unit}"),
            *((finding.severity, finding.message) for finding in self.findings),
        ]
        body = "".join(f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in rows)
        return f"<table><caption>{escape(self.source.name)}</caption><tbody>{body}</tbody></table>"

    def with_findings(self, *findings: Finding) -> Recording:
        """Give the same recording with more to say of it."""
        return replace(self, findings=(*self.findings, *findings))

    @property
    def n_samples(self) -> int:
        """Number of samples."""
        return int(self.time_s.size)

    @cached_property
    def rate_Hz(self) -> float:
        """Sampling rate between the gaps, Hz."""
        steps = np.diff(self.time_s)
        # The mean of the ordinary steps: the median alone carries the rounding of printed times.
        return float(1.0 / np.mean(steps[steps < GAP_STEPS * np.median(steps)]))

    @property
    def duration_s(self) -> float:
        """Time from the first to the last sample, s."""
        return float(self.time_s[-1] - self.time_s[0])

    @cached_property
    def restarts(self) -> BoolArray:
        """True where a sample follows a gap in time (and at the first): correlated noise starts afresh there."""
        steps = np.diff(self.time_s)
        return frozen(np.concatenate([[True], steps > GAP_STEPS * np.median(steps)]), np.bool_)

    @property
    def usable(self) -> bool:
        """False when a finding says that the recording must not be fitted."""
        return all(finding.severity != "unusable" for finding in self.findings)


SMALL_KN = 1.0  # sliding forces below are shown in N: a laboratory reads 260 N off its load cell, not 0.26 kN


def unit_for(sliding_kN: float) -> tuple[str, float]:
    """Choose the unit in which forces of a device are shown, by its sliding force; and how many of it make a kN."""
    return ("N", 1000.0) if abs(sliding_kN) < SMALL_KN else ("kN", 1.0)


def unit_of(force_kN: FloatArray) -> tuple[str, float]:
    """Choose it from a recorded force, shape (n,): half its range without rare extremes is about the sliding force."""
    low, high = np.quantile(force_kN, (0.05, 0.95))
    return unit_for(0.5 * float(high - low))


_MAD = 1.4826  # standard deviation of a normal distribution over its median absolute deviation
_THIRD = np.array([1.0, -3.0, 3.0, -1.0])
_THIRD_NORM = float(np.sqrt(np.sum(_THIRD**2)))


def resolution_of(values: FloatArray) -> float:
    """Step of an encoder or converter in a channel of shape (n,), 0 when the values come in no steps that matter.

    It is the smallest spacing of the levels, when these repeat so often that rounding is the larger part of the noise.
    """
    levels = np.unique(values)
    if levels.size < 3 or levels.size > values.size / 3:
        return 0.0
    spacing = np.diff(levels)
    # Levels that differ by rounding in the last printed digit are one level.
    spacing = spacing[spacing > 1e-9 * float(np.ptp(levels))]
    return float(np.percentile(spacing, 10)) if spacing.size else 0.0


def noise_of(values: FloatArray, resolution: float | None = None) -> float:
    """Estimate the standard deviation of the fast part of a slowly varying channel, shape (n_samples,), nearly even.

    Third differences cancel every parabola, so the motion does not count as noise; their median absolute value
    does not see the few samples at corners. Rounding to counts (`resolution`, found when not given) adds at least a
    uniform error. In the unit of the values; 0 for fewer than 8 samples.
    """
    if values.size < 8:
        return 0.0
    count = resolution_of(values) if resolution is None else resolution
    third = np.convolve(values, _THIRD, mode="valid") / _THIRD_NORM
    if count > 0.0:
        # Most differences of a slow staircase are zero, which blinds the median: use the mean square without the
        # rare largest, which are corners.
        size = np.abs(third)
        spread = float(np.sqrt(np.mean(np.minimum(size, np.percentile(size, 99.0)) ** 2)))
        return max(spread, count / float(np.sqrt(12.0)))
    return _MAD * float(np.median(np.abs(third)))


def write_csv(path: str | Path, recording: Recording, comment: str = "", digits: int = 7) -> Path:
    """Write a recording as ``time_s,displacement_mm,force_kN``; an existing file is replaced.

    Findings are not written: reading the file checks it anew. The comment stands above the header, each line after
    ``#``; a line with the word SIMULATED makes the reader say so. Displacement and force have 3 to 17 significant
    digits, time 12 at least. `RecordingError` where the digits are out of range or the file cannot be written.
    """
    path = Path(path)
    if not 3 <= digits <= 17:
        raise RecordingError(f"digits = {digits}: allowed is 3 to 17 (17 keep every bit)")
    rows = np.column_stack([recording.time_s, recording.displacement_mm, recording.force_kN])
    header = "".join(f"# {line}\n" for line in comment.splitlines()) + "time_s,displacement_mm,force_kN\n"
    try:
        with path.open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(header)
            np.savetxt(stream, rows, fmt=[f"%.{max(12, digits)}g", f"%.{digits}g", f"%.{digits}g"], delimiter=",")
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror}); choose another folder") from error
    return path
