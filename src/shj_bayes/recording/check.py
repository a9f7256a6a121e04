"""What ``shj-bayes check`` says about a recording, as text and as a dictionary."""

from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args

import numpy as np

from shj_bayes.errors import RecordingError, plain_text
from shj_bayes.recording.force_unit import unit_of
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.noise import noise_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording, Severity
from shj_bayes.recording.runs import Runs, settle

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
    return [_checked(recording) for recording in recordings]


def _checked(recording: Recording) -> tuple[dict[str, Any], str]:
    """Facts and text of one run."""
    try:
        motion = motion_of(recording)
    except RecordingError:
        motion = None
    return to_dict(recording, motion), describe(recording, motion)


def blocks_of(motion: Motion) -> list[dict[str, float]]:
    """Consecutive reversals of like amplitude.

    ``amplitude_mm`` from the middle of the whole stroke, ``cycles`` (two reversals each) and ``peak_speed_mm_s``.
    """
    turning = motion.turning_mm[1:]
    if turning.size == 0:
        return []
    centre = 0.5 * (float(np.max(motion.turning_mm)) + float(np.min(motion.turning_mm)))
    amplitude = np.abs(turning - centre)
    peaks = np.maximum.reduceat(motion.speed_mm_s, motion.start[:-1])
    slack = _SAME_AMPLITUDE * amplitude + 0.002 * float(np.max(amplitude))
    cuts = np.flatnonzero(np.abs(np.diff(amplitude)) > slack[:-1]) + 1
    return [
        {
            "amplitude_mm": float(np.mean(amplitude[a:b])),
            "cycles": (b - a) / 2,
            "peak_speed_mm_s": float(np.max(peaks[a + 1 : b + 1])),
        }
        for a, b in pairwise([0, *cuts.tolist(), amplitude.size])
    ]


def to_dict(recording: Recording, motion: Motion | None) -> dict[str, Any]:
    """Everything ``check --json`` prints, as plain values.

    `motion` is None when the displacement does not move enough to have half-cycles.
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
    if motion is not None:
        result["motion"] = {
            "half_cycles": motion.n_half,
            "blocks": blocks_of(motion),
            "peak_speed_mm_s": float(motion.speed_mm_s.max()),
            "travel_mm": float(motion.travel_mm[-1]),
            "displacement_noise_mm": motion.noise_mm,
            "method": motion.method,
        }
    return result


def describe(recording: Recording, motion: Motion | None) -> str:
    """Plain text for the ``check`` command: what was read, then the findings, the gravest first.

    `motion` is None when the displacement does not move enough to have half-cycles.
    """
    facts = to_dict(recording, motion)
    unit, factor = unit_of(recording.force_kN)
    force, noise = [value * factor for value in facts["force_kN"]], facts["force_noise_kN"] * factor
    lines = [f"{facts['name']}: {'usable' if facts['usable'] else 'NOT USABLE'}"]
    for role, column in facts["columns"].items():
        lines.append(f"  {role:<13}{column}  [{facts['units'].get(role, '?')}]")
    lines += [
        f"  {'samples':<13}{facts['n_samples']} at {facts['rate_Hz']:.5g} Hz, {facts['duration_s']:.5g} s; "
        f"{facts['n_used']} used as evidence",
        f"  {'range':<13}{_range(facts['displacement_mm'])} mm, {_range(force)} {unit}",
        f"  {'noise':<13}{noise:.2g} {unit}" + (f", {motion.noise_mm:.2g} mm" if motion else ""),
    ]
    if motion is not None:
        lines += _motion_lines(facts["motion"])
    order = get_args(Severity)
    found = sorted(recording.findings, key=lambda finding: -order.index(finding.severity))
    said = [f"  {finding.severity:<9} {finding.code}: {finding.message}" for finding in found]
    return "\n".join(lines + (said or ["  nothing to remark"]))


def _range(pair: list[float]) -> str:
    return f"{pair[0]:.4g} to {pair[1]:.4g}"


def _motion_lines(motion: dict[str, Any]) -> list[str]:
    """Half-cycles, blocks, speed and how they were found."""
    lines = [
        f"  {'motion':<13}{motion['half_cycles']} half-cycles, {motion['travel_mm']:.4g} mm travel, "
        f"up to {motion['peak_speed_mm_s']:.3g} mm/s"
    ]
    blocks = motion["blocks"]
    if 0 < len(blocks) <= _MAX_BLOCKS:
        shown = (f"{b['amplitude_mm']:.3g} mm x {b['cycles']:g} at {b['peak_speed_mm_s']:.3g} mm/s" for b in blocks)
        lines.append(f"  {'blocks':<13}{'; '.join(shown)}")
    lines.append(f"  {'method':<13}{motion['method']}")
    return lines
