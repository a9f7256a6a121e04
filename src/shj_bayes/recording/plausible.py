"""Is it plausible: units that nobody stated, and which of two columns is the displacement.

No check can find a wrong unit that gives a usual size, so these refuse only where nobody said what the file holds, warn
where the file alone says it, and an option that says it settles the matter.
"""

import shlex
from dataclasses import replace

import numpy as np

from shj_bayes.recording import limits
from shj_bayes.recording.columns import RawChannels
from shj_bayes.recording.loops import burstiness, changes, roughness
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.units import TARGET, Role, factor

_OTHERS: dict[Role, tuple[str, ...]] = {"displacement": ("m", "cm", "in"), "force": ("N", "MN"), "time": ("ms", "min")}


def plausibility_findings(
    channels: RawChannels, time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray
) -> list[Finding]:
    """Sizes that are unusual in a unit that was assumed, and columns that look like one another's.

    The channels say which units were assumed and which columns were named; the arrays, of shape (n_samples,), are those
    after the repairs.
    """
    stroke, force = float(np.ptp(displacement_mm)), float(np.max(np.abs(force_kN)))
    duration = float(time_s[-1] - time_s[0])
    speed = float(np.sum(np.abs(changes(displacement_mm)))) / max(duration, 1e-300)
    measures: tuple[tuple[Role, float, str, tuple[float, float], str], ...] = (
        ("displacement", stroke, "a stroke of {:.3g} mm", limits.ASSUMED_STROKE_MM, "mm"),
        ("force", force, "a force of up to {:.3g} kN", limits.ASSUMED_FORCE_KN, "kN"),
        ("time", speed, "a mean speed of {:.3g} mm/s", limits.ASSUMED_SPEED_MM_S, "mm/s"),
    )
    findings = []
    for role, value, words, (low, high), unit in measures:
        read = channels.units[role]
        more = (
            f"(usual is {low:g} to {high:g} {unit}); state it: --units {role}={read} if it is right, else the unit "
            f"that is{_usual(role, value, low, high, read)}"
        )
        if role in channels.assumed and not low <= value <= high:
            message = f"nobody stated the unit of the {role}, and {words.format(value)} is unusual in {read} {more}"
            findings.append(Finding("unit-unlikely", "unusable", message))
        elif role in channels.told and (value > high or (role != "time" and value < low)):
            message = f"the file says {read} for the {role}, and {words.format(value)} is unusual {more}"
            findings.append(Finding("unit-unusual", "warning", message))
    if "time" not in channels.assumed and speed < limits.ASSUMED_SPEED_MM_S[0] and duration > limits.LONG_TEST_S:
        message = (
            f"the test lasts {duration / 3600:.3g} h at a mean speed of {speed:.2g} mm/s; if the times are "
            "milliseconds, give --units time=ms"
        )
        findings.append(Finding("time-long", "warning", message))
    return findings + _swapped(channels, displacement_mm, force_kN)


def _usual(role: Role, value: float, low: float, high: float, read: str) -> str:
    """Name the units in which a size `read` in one would be usual; a speed is the smaller, the longer that of time."""
    power = -1 if role == "time" else 1
    own = value / factor(read, role) ** power
    fit = [name for name in (TARGET[role], *_OTHERS[role]) if low <= own * factor(name, role) ** power <= high]
    return f" (it would be usual in {' or '.join(fit)})" if fit else ""


def _swapped(channels: RawChannels, displacement_mm: FloatArray, force_kN: FloatArray) -> list[Finding]:
    """Say so when the displacement jumps, or is as rough, as a friction force and the force is smooth as a driven one.

    Of 26 public recordings of friction and yielding devices none comes near both limits, nor does white noise on
    the force, which is rough, or a displacement applied in steps, of which the force has the steps as well.
    """
    ratio = burstiness(displacement_mm) / max(burstiness(force_kN), 1e-300)
    smooth = roughness(force_kN)
    rough = roughness(displacement_mm) / max(smooth, 1e-300)
    if smooth > limits.SWAPPED_ROUGHNESS or (ratio < limits.SWAPPED_BURSTS and rough < limits.SWAPPED_SMOOTH):
        return []
    message = (
        f"displacement and force seem swapped: the displacement jumps like a friction force ({ratio:.1f} times as "
        f"bursty and {rough:.1f} times as rough as the force; below {limits.SWAPPED_BURSTS:g} and "
        f"{limits.SWAPPED_SMOOTH:g} is usual) and the force runs as smoothly as a driven displacement"
    )
    told = {"displacement", "force"} <= channels.named
    return [Finding("swapped-columns", "warning" if told else "unusable", message)]


def with_exchange(finding: Finding, channels: RawChannels) -> Finding:
    """Add to a finding of swapped columns the options that exchange them."""
    if finding.code != "swapped-columns":
        return finding
    columns, units = channels.columns, channels.units
    option = shlex.quote(f"displacement={columns['force']},force={columns['displacement']}")
    exchange = f"--columns {option} --units displacement={units['displacement']},force={units['force']}"
    return replace(finding, message=f"{finding.message}; if they are, exchange them: {exchange}")
