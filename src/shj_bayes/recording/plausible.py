"""Is it plausible: units that nobody stated, and which of two columns is the displacement.

No check can find a wrong unit that gives a usual size, so these refuse only where nobody said what the file holds, and
saying it settles the matter.
"""

from __future__ import annotations

import numpy as np

from shj_bayes.recording.columns import Channels
from shj_bayes.recording.limits import (
    ASSUMED_FORCE_KN,
    ASSUMED_SPEED_MM_S,
    ASSUMED_STROKE_MM,
    LONG_TEST_S,
    SWAPPED_BURSTS,
    SWAPPED_ROUGHNESS,
    SWAPPED_SMOOTH,
)
from shj_bayes.recording.loops import burstiness, changes, roughness
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.units import TARGET, Role


def plausibility_findings(
    channels: Channels, time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray
) -> list[Finding]:
    """Sizes that are unusual in a unit that was assumed, and columns that look like one another's.

    The channels say which units were assumed and which columns were named; the arrays, of shape (n_samples,), are those
    after the repairs.
    """
    stroke, force = float(np.ptp(displacement_mm)), float(np.max(np.abs(force_kN)))
    duration = float(time_s[-1] - time_s[0])
    speed = float(np.sum(np.abs(changes(displacement_mm)))) / max(duration, 1e-300)
    measures: tuple[tuple[Role, float, str, tuple[float, float], str], ...] = (
        ("displacement", stroke, "a stroke of {:.3g} mm", ASSUMED_STROKE_MM, "mm"),
        ("force", force, "a force of up to {:.3g} kN", ASSUMED_FORCE_KN, "kN"),
        ("time", speed, "a mean speed of {:.3g} mm/s", ASSUMED_SPEED_MM_S, "mm/s"),
    )
    findings = []
    for role, value, words, (low, high), unit in measures:
        if role in channels.assumed and not low <= value <= high:
            message = (
                f"nobody stated the unit of the {role}, and {words.format(value)} is unusual in {TARGET[role]} (usual "
                f"is {low:g} to {high:g} {unit}); state it: --units {role}={TARGET[role]} if it is right, else the "
                "unit that is"
            )
            findings.append(Finding("unit-unlikely", "unusable", message))
    if "time" not in channels.assumed and speed < ASSUMED_SPEED_MM_S[0] and duration > LONG_TEST_S:
        message = (
            f"the test lasts {duration / 3600:.3g} h at a mean speed of {speed:.2g} mm/s; if the times are "
            "milliseconds, give --units time=ms"
        )
        findings.append(Finding("time-long", "warning", message))
    return findings + _swapped(channels, displacement_mm, force_kN)


def _swapped(channels: Channels, displacement_mm: FloatArray, force_kN: FloatArray) -> list[Finding]:
    """Say so when the displacement jumps, or is as rough, as a friction force and the force is smooth as a driven one.

    Of 26 public recordings of friction and yielding devices none comes near both limits, nor does white noise on
    the force, which is rough, or a displacement applied in steps, of which the force has the steps as well.
    """
    ratio = burstiness(displacement_mm) / max(burstiness(force_kN), 1e-300)
    smooth = roughness(force_kN)
    rough = roughness(displacement_mm) / max(smooth, 1e-300)
    if smooth > SWAPPED_ROUGHNESS or (ratio < SWAPPED_BURSTS and rough < SWAPPED_SMOOTH):
        return []
    message = (
        f"displacement and force seem swapped: the displacement jumps like a friction force ({ratio:.1f} times as "
        f"bursty and {rough:.1f} times as rough as the force; below {SWAPPED_BURSTS:g} and {SWAPPED_SMOOTH:g} is "
        "usual) and the force runs as smoothly as a driven displacement; name both with "
        "--columns displacement=...,force=... and their --units"
    )
    told = {"displacement", "force"} <= channels.named
    return [Finding("swapped-columns", "warning" if told else "unusable", message)]
