"""Checks and safe repairs in order: the clock, the cells, the magnitudes, the sign, the loop."""

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.cells import clipped, complete_rows, fill, spikes
from shj_bayes.recording.clock import clock_findings, orderly_rows
from shj_bayes.recording.force_unit import unit_of
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.limits import BAD_CELL_SHARE
from shj_bayes.recording.loops import cycle_findings, magnitude_findings, sign_findings
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray, Recording


def repair(
    time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray, name: str
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray, tuple[Finding, ...]]:
    """Make three raw channels, NaN where the file has no number, into channels that can be used, and say what was done.

    Times (strictly increasing), displacement and force, finite; which samples are evidence, those filled in or clipped
    being none; findings. `RecordingError` if too little is left to be a recording, or the clock is broken.
    """
    keep, findings = orderly_rows(time_s, name)
    t, x, f = time_s[keep], displacement_mm[keep], force_kN[keep]
    for label, values in (("displacement", x), ("force", f)):
        if not np.any(np.isfinite(values)):
            raise RecordingError(
                f"{name}: the {label} column holds no number; choose another with --columns {label}=..."
            )
    keep, more = complete_rows((x, f))
    t, x, f, findings = t[keep], x[keep], f[keep], findings + more
    if t.size < 2:
        raise RecordingError(f"{name}: {t.size} rows have displacement and force; at least 2 are needed")
    x, used, more = _filled_displacement(t, x)
    findings += more
    f, filled, more = fill(t, f, "force")
    findings += more
    used &= ~filled
    for label, values, other in (("displacement", x, f), ("force", f, x)):
        cut = clipped(values, other)
        used &= ~cut
        findings += _clip_findings(label, values, cut)
    findings += clock_findings(t, x) + magnitude_findings(x, f)
    f, more = sign_findings(x, f)
    return t, x, f, used, (*findings, *more)


def inspect(recording: Recording) -> tuple[Finding, ...]:
    """Run the checks that need the half-cycles; the recording's own findings are not repeated."""
    try:
        motion = motion_of(recording)
    except RecordingError as error:
        return (Finding("no-motion", "unusable", str(error)),)
    return tuple(cycle_findings(recording, motion))


def _filled_displacement(t: FloatArray, x: FloatArray) -> tuple[FloatArray, BoolArray, list[Finding]]:
    """Fill empty cells and dropouts of the displacement."""
    x, filled, findings = fill(t, x, "displacement")
    jumps = spikes(x)
    count = int(np.count_nonzero(jumps))
    if count:
        worst = int(np.flatnonzero(jumps)[0])
        message = (
            f"displacement jumps and returns within one sample {count} times, first to {x[worst]:.4g} mm "
            f"at {t[worst]:.6g} s; bridged and not used as evidence"
        )
        findings.append(Finding("spikes", "repaired", message, count))
        x = np.where(jumps, np.interp(t, t[~jumps], x[~jumps]), x)
    return x, ~(filled | jumps), findings


def _clip_findings(label: str, values: FloatArray, cut: BoolArray) -> list[Finding]:
    """Name a clipped channel; displacement that is clipped can no longer drive the law."""
    count = int(np.count_nonzero(cut))
    if count == 0:
        return []
    share = count / values.size
    unit, factor = ("mm", 1.0) if label == "displacement" else unit_of(values)
    levels = " and ".join(f"{level * factor:.4g}" for level in np.unique(values[cut]))
    message = f"{label} is clipped at {levels} {unit} in {count} samples ({share:.1%}), which are not used as evidence"
    severe = share > (BAD_CELL_SHARE if label == "displacement" else 0.5)
    return [Finding("clipped", "unusable" if severe else "warning", message, count)]
