"""Several runs in one file, told apart by the file or found; and what shj-bayes check says of each."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import RecordingError, plain_text
from shj_bayes.recording import limits
from shj_bayes.recording.checks import inspect
from shj_bayes.recording.clock import clock_findings
from shj_bayes.recording.motion import Motion, hysteresis, least_return, motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.readings import runs as stretches
from shj_bayes.recording.recording import Finding, Recording, Severity, noise_of, unit_of

Runs = int | Literal["split", "one"] | None
"""What the user says of a file: how many runs it holds, that it may be split, that it is one; None for nothing said."""
_OTHER = "use --split or --one-run, or put each run into a file of its own"


class Division(NamedTuple):
    """One way to part a recording into runs."""

    # the file tells its runs apart; the protocol begins again; the device rests for long
    why: Literal["file", "repeat", "rest"]
    # first sample of each run, and the sample behind its last; a rest between two runs belongs to neither, but for its
    # last samples, which show the force from which the next run starts
    spans: tuple[tuple[int, int], ...]
    words: str  # what was found, for a finding

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.spans)


def divisions(recording: Recording) -> tuple[Division, ...]:
    """Find the ways in which a recording may hold several runs, the surest first; none where nothing speaks for it."""
    told = list(recording.run_starts)
    found = [Division("file", _spans(recording, told), f"the file tells {len(told) + 1} runs apart")] if told else []
    sketch = _sketch(recording)
    if sketch is None:
        return tuple(found)
    rests = _rests(recording, sketch, limits.FEW_HALF_CYCLES)
    strokes = [np.abs(np.diff(part.x_mm[[0, *part.turns()]])) for part in sketch.parts(rests)]
    again = [rest for rest, own in zip(rests, strokes[1:], strict=True) if _begins_again(strokes[0], own)]
    if again:
        words = f"after {_said(again)} the protocol begins again as it began"
        found.append(Division("repeat", _between(recording, sketch, again), words))
    else:
        found += _repeated(recording, sketch)
    # A long rest is longer than every half-cycle that holds none.
    edges = sketch.time_s[[0, *sketch.turns(), sketch.time_s.size - 1]]
    holding = np.searchsorted(edges, [0.5 * (begin + end) for begin, end in rests]) - 1
    longest = float(np.max(np.delete(np.diff(edges), holding), initial=0.0))
    rests = [rest for rest in rests if rest[1] - rest[0] > longest and not _is_hold(sketch, rest)]
    if rests:
        found.append(Division("rest", _between(recording, sketch, rests), f"{_said(rests)} between movements"))
    return tuple(found)


def split(recording: Recording, n_runs: int | None = None) -> tuple[Recording, ...]:
    """Part a recording into `n_runs`, or by the surest division; into itself where there is nothing to part.

    The runs come in order, without the rests between them. Each has the digest of the file, its name with ``run 2``
    behind it, and the findings of the whole but for those on the clock and the half-cycles, which are its own.
    `RecordingError` if it cannot be parted into `n_runs`; the message says what was found.
    """
    if n_runs == 1:
        return (recording,)
    ways = divisions(recording)
    if n_runs is None:
        return _cut(recording, ways[0]) if ways else (recording,)
    chosen = next((way for way in ways if way.n_runs == n_runs), None) or _longest_rests(recording, n_runs)
    if chosen is not None:
        return _cut(recording, chosen)
    seen = "; ".join(f"{way.words} ({way.n_runs} runs)" for way in ways)
    seen = seen or "no long rest, no protocol that begins again"
    raise RecordingError(
        f"{recording.source.name}: {n_runs} runs were expected, but found was: {seen}; correct --runs, or {_OTHER}"
    )


def check_runs(runs: Runs) -> None:
    """Refuse what is neither a number of runs nor one of the two words (`RecordingError`)."""
    number = isinstance(runs, int) and not isinstance(runs, bool) and runs >= 1
    if not (number or runs in ("split", "one", None)):
        raise RecordingError(f'runs = {runs!r}: allowed are a number of runs from 1 on, "split" and "one"')


def settle(recordings: Sequence[Recording], runs: Runs = None) -> list[Recording]:
    """Part the recordings of a device, one from each file, into its runs as the user says.

    A number of runs is that of all files together; ``"split"`` parts where runs are found; ``"one"`` never parts. Where
    nothing is said, only a file that tells its own runs apart is parted: a recording whose protocol begins again
    carries an ``unusable`` finding, one with long rests between unlike stretches a ``warning``; both name the options.
    `RecordingError` if they cannot be parted into the number of runs that was given.
    """
    if runs == "one":
        return list(recordings)
    if runs is None:
        return [run for recording in recordings for run in _beyond_doubt(recording)]
    if isinstance(runs, int) and len(recordings) == 1:
        return list(split(recordings[0], runs))
    parts = [split(recording) for recording in recordings]
    found = sum(map(len, parts))
    if isinstance(runs, int) and found != runs:
        seen = ", ".join(f"{r.source.name} {len(part)}" for r, part in zip(recordings, parts, strict=True))
        raise RecordingError(f"{runs} runs were expected, but found were {found} ({seen}); correct --runs, or {_OTHER}")
    return [run for part in parts for run in part]


def _beyond_doubt(recording: Recording) -> tuple[Recording, ...]:
    """Part what the file itself tells apart; else keep the recording, with what speaks for more than one run."""
    way = next(iter(divisions(recording)), None)
    if way is None:
        return (recording,)
    if way.why == "file":
        return _cut(recording, way)
    options = f'give --runs {way.n_runs}, --split or --one-run (in a manifest runs = {way.n_runs}, "split" or "one")'
    if way.why == "repeat":
        message = f"this looks like {way.n_runs} runs in one file: {way.words}; fitted as one it misleads; {options}"
        return (recording.with_findings(Finding("several-runs", "unusable", message)),)
    message = f"{way.words}; read as one run; if it holds {way.n_runs}, {options}"
    return (recording.with_findings(Finding("long-rests", "warning", message)),)


def _cut(recording: Recording, way: Division) -> tuple[Recording, ...]:
    """Make the recordings of a division."""
    whole = {*inspect(recording), *clock_findings(recording.time_s, recording.displacement_mm)}
    kept = tuple(finding for finding in recording.findings if finding not in whole)
    shift = recording.run_starts if way.why == "file" else {}
    parts = []
    for number, (a, b) in enumerate(way.spans, start=1):
        said = Finding("runs-split", "assumed", f"run {number} of {way.n_runs} in {recording.source.name}: {way.words}")
        part = Recording(
            recording.time_s[a:b] - shift.get(a, 0.0),
            recording.displacement_mm[a:b],
            recording.force_kN[a:b],
            np.asarray(recording.used)[a:b],
            replace(recording.source, name=f"{recording.source.name} run {number}"),
            (*kept, said),
            extras=tuple(replace(extra, values=extra.values[a:b]) for extra in recording.extras),
        )
        parts.append(part.with_findings(*clock_findings(part.time_s, part.displacement_mm), *inspect(part)))
    return tuple(parts)


Rest = tuple[float, float]
"""Begin and end of a time in which the device, or the logger, stands still between movements, s."""


class _Sketch(NamedTuple):
    """The displacement thinned out: enough to see rests and strokes."""

    # time_s, x_mm: shape (n,)
    time_s: FloatArray
    x_mm: FloatArray
    noise_mm: float  # of one sample

    def turns(self) -> list[int]:
        """Find the samples of the reversals."""
        return hysteresis(self.x_mm, least_return(self.x_mm, self.noise_mm))

    def parts(self, rests: Sequence[Rest]) -> list[_Sketch]:
        """Sketches between the middles of rests."""
        middles = [0.5 * (begin + end) for begin, end in rests]
        edges = [0, *np.searchsorted(self.time_s, middles).tolist(), self.time_s.size]
        return [_Sketch(self.time_s[a:b], self.x_mm[a:b], self.noise_mm) for a, b in pairwise(edges)]


def _sketch(recording: Recording) -> _Sketch | None:
    """Thin the displacement out; None where there is nothing to see."""
    x, step = recording.displacement_mm, max(1, recording.n_samples // limits.SKETCH_SAMPLES)
    noise = noise_of(x)
    least = max(limits.MIN_STROKE_MM, 2 * limits.REVERSAL_NOISE * noise)
    if recording.n_samples < 2 * limits.MIN_SAMPLES or np.ptp(x) < least:
        return None
    return _Sketch(recording.time_s[::step], x[::step], noise)


def _is_hold(sketch: _Sketch, rest: Rest) -> bool:
    """Whether a rest belongs to the test: at the end of a stroke as long as the next, away from the start."""
    x, span = sketch.x_mm, float(np.ptp(sketch.x_mm))
    centre = 0.5 * float(np.max(x) + np.min(x))
    level = float(np.interp(0.5 * (rest[0] + rest[1]), sketch.time_s, x))
    before, after = sketch.parts([(rest[0], rest[0])])[0], sketch.parts([(rest[1], rest[1])])[1]
    ends = [float(part.x_mm[turn]) for part, k in ((before, -1), (after, 0)) for turn in part.turns()[k:][:1]]
    full = any(abs(abs(end - centre) - abs(level - centre)) < limits.SAME_STROKE * span for end in ends)
    return full and abs(level - float(x[0])) > limits.REST_HOME * span


def _rests(recording: Recording, sketch: _Sketch, n_half: int) -> list[Rest]:
    """Rests longer than a usual half-cycle, with enough samples and half-cycles on both sides to part something."""
    t, x, turns = sketch.time_s, sketch.x_mm, sketch.turns()
    travel = float(np.sum(np.abs(np.diff(x[[0, *turns, x.size - 1]]))))
    # In a bin the device moves by far more than its noise, so that a bin without movement is a rest.
    n = int(min(limits.REST_BINS, x.size // 2, travel / max(limits.REST_NOISE * sketch.noise_mm, 1e-300)))
    if n < limits.MIN_SAMPLES:
        return []
    edges = np.linspace(t[0], t[-1], n + 1)
    # The displacement at the edges too: a bin without samples, in a gap, then shows how far the device moved in it.
    at_edges, moments = np.interp(edges, t, x), np.append(t, edges)
    order = np.argsort(moments, kind="stable")
    values, first = np.append(x, at_edges)[order], np.searchsorted(moments[order], edges)[:-1]
    high = np.maximum(np.maximum.reduceat(values, first), at_edges[1:])
    span = high - np.minimum(np.minimum.reduceat(values, first), at_edges[1:])
    still = span < max(limits.REST_SPEED * travel / n, 0.2 * limits.REST_NOISE * sketch.noise_mm)
    rests = [(float(edges[a]), float(edges[b])) for a, b in stretches(still) if a > 0 and b < n]
    rests = [rest for rest in rests if abs(np.diff(np.interp(rest, t, x))[0]) < limits.REST_RANGE * np.ptp(x)]
    usual = (float(t[-1] - t[0]) - sum(end - begin for begin, end in rests)) / (len(turns) + 1)
    kept: list[Rest] = []
    for rest in rests:
        if rest[1] - rest[0] > limits.LONG_REST * usual:
            *_, before, after = sketch.parts([*kept, rest])
            if all(part.x_mm.size > 1 and len(part.turns()) + 1 >= n_half for part in (before, after)):
                kept.append(rest)
    return kept if all(b - a >= limits.MIN_SAMPLES for a, b in _between(recording, sketch, kept)) else []


def _begins_again(first: FloatArray, other: FloatArray) -> bool:
    """Whether the strokes of a part after a rest, `other`, repeat those of the first: from the first on, or varied."""

    def alike(first: FloatArray, other: FloatArray) -> bool:
        n = min(first.size, other.size)  # as far as both go
        limit = limits.SAME_STROKE * np.maximum(first[:n], 0.2 * float(np.max(first, initial=0.0)))
        return n >= limits.FEW_HALF_CYCLES - 1 and bool(np.all(np.abs(first[:n] - other[:n]) <= limit))

    # Of a varied protocol without its first stroke, after one or two strokes back from where the part before was cut.
    full = first[1:]
    return alike(first, other) or (_varied(full) and any(alike(full, other[back:]) for back in (1, 2)))


def _varied(sizes: FloatArray) -> bool:
    """Whether amplitudes are a protocol that can be seen to begin again."""
    return sizes.size >= limits.PROTOCOL_HALF_CYCLES and bool(sizes.max() >= limits.PROTOCOL_VARIES * sizes.min())


def _repeated(recording: Recording, sketch: _Sketch) -> list[Division]:
    """Find runs without a long rest between them: the same varied sequence of amplitudes twice or more."""
    turns, x = sketch.turns(), sketch.x_mm
    n, size = len(turns), np.abs(x[turns] - 0.5 * (float(np.max(x)) + float(np.min(x))))
    for period in (k for k in range(1, n // 2 + 1) if n % k == 0):
        blocks = size.reshape(-1, period)
        if np.any(np.abs(blocks - blocks[0]) > limits.SAME_STROKE * np.maximum(blocks[0], 0.2 * float(np.max(size)))):
            continue
        if not _varied(blocks[0]):
            return []  # the same cycle again and again is one run
        starts = []
        for k in range(period, n, period):  # where the displacement passes where it began, between two reversals
            way = x[turns[k - 1] : turns[k] + 1]
            beyond = (way - x[0]) * np.sign(way[-1] - way[0]) >= 0
            starts.append(float(sketch.time_s[turns[k - 1] + int(np.argmax(beyond))]))
        words = f"the same {period} amplitudes come {n // period} times, one after the other"
        return [Division("repeat", _spans(recording, np.searchsorted(recording.time_s, starts).tolist()), words)]
    return []


def _longest_rests(recording: Recording, n_runs: int) -> Division | None:
    """Division at the longest rests, where these are clearly longer than the next."""
    sketch = _sketch(recording)
    if sketch is None:
        return None
    rests = _rests(recording, sketch, limits.MIN_HALF_CYCLES)
    rests.sort(key=lambda rest: rest[0] - rest[1])
    chosen, others = sorted(rests[: n_runs - 1]), [end - begin for begin, end in rests[n_runs - 1 :]]
    shortest = min((end - begin for begin, end in chosen), default=0.0)
    if len(chosen) < n_runs - 1 or (others and shortest < 1.5 * others[0]):
        return None
    return Division("rest", _between(recording, sketch, chosen), f"{_said(chosen)} between movements, the longest")


def _spans(recording: Recording, starts: list[int]) -> tuple[tuple[int, int], ...]:
    """Give spans that follow one another without anything between."""
    return tuple(pairwise([0, *starts, recording.n_samples]))


def _between(recording: Recording, sketch: _Sketch, rests: list[Rest]) -> tuple[tuple[int, int], ...]:
    """Leave out the rests between runs: what a rig does to the force while nothing slides is not the device's."""
    t, x = recording.time_s, recording.displacement_mm
    first, spans = 0, []
    for rest in rests:
        a, b = (int(i) for i in np.searchsorted(t, rest))
        # The rest was seen in pieces of the duration; it began with the first sample at its level.
        level = float(np.median(x[a:b])) if b > a else float(x[min(a, x.size - 1)])
        near = slice(max(first, a - limits.MIN_SAMPLES - 2 * x.size // limits.REST_BINS), a)
        moving = np.flatnonzero(np.abs(x[near] - level) > limits.REST_AT * sketch.noise_mm)
        end = near.start + int(moving[-1]) + 1 if moving.size else near.start
        spans.append((first, end))
        first = max(end, b - limits.MIN_SAMPLES)
    return (*spans, (first, recording.n_samples))


def _said(rests: list[Rest]) -> str:
    """Rests in words."""
    shown = ", ".join(f"{end - begin:.3g} s at {begin:.4g} s" for begin, end in rests[:4])
    more = f" and {len(rests) - 4} more" if len(rests) > 4 else ""
    return f"{'a rest' if len(rests) == 1 else f'{len(rests)} rests'} ({shown}{more})"


SCHEMA = "shj-bayes/check/1"
_SAME_AMPLITUDE = 0.05  # reversals within this share of one another belong to one block
_MAX_BLOCKS = 10  # an earthquake has no blocks; its list would only be long


def check_recording(path: Path, runs: Runs = None, **reading: Any) -> list[tuple[dict[str, Any], str]]:
    """Read and check one file, as `shj_bayes.recording.reader.read` and `settle` do; facts and text for each run in it.

    Facts are for machines (``usable`` says whether the run may be fitted), text is for people. A file that cannot be
    read at all gives its reason in both.
    """
    try:
        recordings = settle([read(path, **reading)], runs)
    except RecordingError as error:
        name = plain_text(path.name or str(path))
        reason = str(error).removeprefix(f"{name}: ")
        return [({"name": name, "usable": False, "error": str(error)}, f"{name}: NOT USABLE\n  {reason}")]
    return [(facts := to_dict(recording), describe(recording, facts)) for recording in recordings]


def blocks_of(motion: Motion) -> list[dict[str, float]]:
    """Consecutive reversals of like amplitude.

    ``amplitude_mm`` from the middle of the whole stroke, ``cycles`` (two reversals each) and ``peak_speed_mm_s``.
    """
    turning = motion.turning_mm[1:]
    if turning.size == 0:
        return []
    centre = 0.5 * (float(np.max(motion.turning_mm)) + float(np.min(motion.turning_mm)))
    amplitude = np.abs(turning - centre)
    slack = _SAME_AMPLITUDE * amplitude + 0.002 * float(np.max(amplitude))
    cuts = np.flatnonzero(np.abs(np.diff(amplitude)) > slack[:-1]) + 1
    return [
        {
            "amplitude_mm": float(np.mean(amplitude[a:b])),
            "cycles": (b - a) / 2,
            "peak_speed_mm_s": float(np.max(motion.peak_mm_s[a + 1 : b + 1])),
        }
        for a, b in pairwise([0, *cuts.tolist(), amplitude.size])
    ]


def to_dict(recording: Recording) -> dict[str, Any]:
    """Everything ``check --json`` prints, as plain values.

    There is no ``motion`` where the displacement does not move enough to have half-cycles.
    """
    result: dict[str, Any] = {
        "schema": SCHEMA,
        "name": recording.source.name,
        "sha256": recording.source.sha256,
        "format": recording.source.format,
        "usable": recording.usable,
        "columns": dict(recording.source.columns),
        "units": dict(recording.source.units),
        "n_samples": recording.n_samples,
        "n_used": int(np.sum(np.asarray(recording.used))),
        "rate_Hz": recording.rate_Hz,
        "duration_s": recording.duration_s,
        "displacement_mm": [float(recording.displacement_mm.min()), float(recording.displacement_mm.max())],
        "force_kN": [float(recording.force_kN.min()), float(recording.force_kN.max())],
        "force_noise_kN": noise_of(recording.force_kN[recording.used]),
        "findings": [asdict(finding) for finding in recording.findings],
    }
    with suppress(RecordingError):
        motion = motion_of(recording)
        result["motion"] = {
            "half_cycles": motion.n_half,
            "blocks": blocks_of(motion),
            "peak_speed_mm_s": float(motion.speed_mm_s.max()),
            "travel_mm": float(motion.travel_mm[-1]),
            "displacement_noise_mm": motion.noise_mm,
            "method": motion.method,
        }
    return result


def describe(recording: Recording, facts: dict[str, Any]) -> str:
    """Plain text for the ``check`` command: what was read (`to_dict`), then the findings, the gravest first."""
    unit, factor = unit_of(recording.force_kN)
    (x_low, x_high), (low, high) = facts["displacement_mm"], (value * factor for value in facts["force_kN"])
    noise, moved = facts["force_noise_kN"] * factor, facts.get("motion")
    lines = [f"{facts['name']}: {'usable' if facts['usable'] else 'NOT USABLE'}"]
    for role, column in facts["columns"].items():
        lines.append(f"  {role:<13}{column}  [{facts['units'].get(role, '?')}]")
    lines += [
        f"  {'samples':<13}{facts['n_samples']} at {facts['rate_Hz']:.5g} Hz, {facts['duration_s']:.5g} s; "
        f"{facts['n_used']} used as evidence",
        f"  {'range':<13}{x_low:.4g} to {x_high:.4g} mm, {low:.4g} to {high:.4g} {unit}",
        f"  {'noise':<13}{noise:.2g} {unit}" + (f", {moved['displacement_noise_mm']:.2g} mm" if moved else ""),
    ]
    if moved is not None:
        lines.append(
            f"  {'motion':<13}{moved['half_cycles']} half-cycles, {moved['travel_mm']:.4g} mm travel, "
            f"up to {moved['peak_speed_mm_s']:.3g} mm/s"
        )
        if 0 < len(blocks := moved["blocks"]) <= _MAX_BLOCKS:
            shown = (f"{b['amplitude_mm']:.3g} mm x {b['cycles']:g} at {b['peak_speed_mm_s']:.3g} mm/s" for b in blocks)
            lines.append(f"  {'blocks':<13}{'; '.join(shown)}")
        lines.append(f"  {'method':<13}{moved['method']}")
    order = get_args(Severity)
    found = sorted(recording.findings, key=lambda finding: -order.index(finding.severity))
    said = [f"  {finding.severity:<9} {finding.code}: {finding.message}" for finding in found]
    return "\n".join(lines + (said or ["  nothing to remark"]))
