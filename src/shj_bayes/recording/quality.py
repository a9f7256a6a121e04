"""Checks and safe repairs in order: the clock, the rates, the cells, the magnitudes, the sign, the loop."""

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.cells import clipped, complete_rows, fill, runs, stopped
from shj_bayes.recording.clock import clock_findings, orderly_rows
from shj_bayes.recording.excursions import NoReadings, held, not_readings
from shj_bayes.recording.force_unit import unit_of
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.limits import BAD_CELL_SHARE
from shj_bayes.recording.loops import cycle_findings, exchanged, few_points, magnitude_findings, sign_findings
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray, Recording


def repair(
    time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray, name: str
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray, tuple[Finding, ...]]:
    """Make three raw channels, NaN where the file has no number, into channels that can be used, and say what was done.

    Times (strictly increasing), displacement and force, finite; which samples are evidence, those filled in, repeated
    or clipped being none; findings. `RecordingError` if too little is left to be a recording, or the clock is broken.
    """
    keep, findings = orderly_rows(time_s, name)
    t, x, f = time_s[keep], displacement_mm[keep], force_kN[keep]
    for label, values in (("displacement", x), ("force", f)):
        if not np.any(np.isfinite(values)):
            raise RecordingError(
                f"{name}: the {label} column holds no number; choose another with --columns {label}=..."
            )
    t, x, f, repeats, more = _at_own_rates(t, x, f)
    findings += more
    wrong = not_readings(t, x, f)
    if wrong.jumps and exchanged(_without(x, wrong.jumps), np.interp(t, t[np.isfinite(f)], f[np.isfinite(f)])) > (
        limits.SWAPPED_PRODUCT
    ):  # a force that is taken for the displacement jumps because it is one
        wrong = NoReadings(np.zeros(t.size, dtype=np.bool_), np.zeros(t.size, dtype=np.bool_))
    for label, values, bad in (("displacement", x, wrong.displacement), ("force", f, wrong.force)):
        findings += _spike_findings(label, t, values, bad)
    findings += _jump_findings(t, x, wrong.jumps)
    x, f = np.where(wrong.displacement, np.nan, x), np.where(wrong.force, np.nan, f)
    keep, more = complete_rows((x, f))
    t, x, f, repeats, findings = t[keep], x[keep], f[keep], repeats[keep], findings + more
    if t.size < 2:
        raise RecordingError(f"{name}: {t.size} rows have displacement and force; at least 2 are needed")
    x, filled, more = fill(t, x, "displacement", wrong.displacement[keep])
    findings += more
    used = ~(filled | repeats)
    f, filled, more = fill(t, f, "force", wrong.force[keep])
    findings += more
    used &= ~filled
    for label, values, other in (("displacement", x, f), ("force", f, x)):
        cut = clipped(values, other)
        used &= ~cut
        findings += _clip_findings(label, values, cut)
    dead = stopped(f, x)
    used &= ~dead
    findings += _stop_findings(t, f, dead)
    findings += clock_findings(t, x) + magnitude_findings(x, f)
    f, more = sign_findings(x, f)
    return t, x, f, used, (*findings, *more)


def inspect(recording: Recording) -> tuple[Finding, ...]:
    """Run the checks that need the half-cycles; the recording's own findings are not repeated."""
    try:
        motion = motion_of(recording)
    except RecordingError as error:
        return tuple(few_points(recording, None)) or (Finding("no-motion", "unusable", str(error)),)
    return tuple(cycle_findings(recording, motion))


def _at_own_rates(
    t: FloatArray, x: FloatArray, f: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray, list[Finding]]:
    """Take a channel that is slower than the table at its own rate.

    A displacement that repeats drives nothing: the rows with a new one are kept, at the moments at which it was read. A
    force that repeats is no evidence, and the displacement of these rows is. Times, displacement, force, rows that
    repeat a force, findings.
    """
    findings = []
    if of := held(x):
        findings.append(_held_finding("displacement", of.period, t, "the rows with a new one are kept"))
        t, x, f = of.at_readings(t), x[of.fresh], of.at_readings(f)
    repeats = np.zeros(t.size, dtype=np.bool_)
    if of := held(f):
        findings.append(_held_finding("force", of.period, t, "the rows that repeat one are not used as evidence"))
        moments, places = of.at_readings(t), of.at_readings(x)
        t, x, repeats = t.copy(), x.copy(), ~of.fresh
        t[of.fresh], x[of.fresh] = moments, places
    return t, x, f, repeats, findings


def _held_finding(label: str, period: float, t: FloatArray, then: str) -> Finding:
    """Say at which rate a channel was read."""
    rate = 1.0 / float(np.median(np.diff(t)))
    ordinal = {2.0: "2nd", 3.0: "3rd"}.get(round(period, 1), f"{round(period, 1):g}th")
    message = (
        f"{label} changes in every {ordinal} row only, at {rate / period:.4g} Hz of {rate:.4g} Hz: its channel is "
        f"slower than the table; it is used at its own rate, and {then}"
    )
    return Finding("held", "repaired", message)


def _spike_findings(label: str, t: FloatArray, values: FloatArray, bad: BoolArray) -> list[Finding]:
    """Name rows that are no readings."""
    count = int(np.count_nonzero(bad))
    if count == 0:
        return []
    unit, factor = ("mm", 1.0) if label == "displacement" else unit_of(values[~bad & np.isfinite(values)])
    times, first = len(runs(bad)), int(np.argmax(bad))
    message = (
        f"{label} jumps away and back {times} time{'s' if times > 1 else ''} ({count} rows), first to "
        f"{values[first] * factor:.4g} {unit} at {t[first]:.6g} s, as no device does; taken for no readings: bridged "
        "or left out, and not used as evidence"
    )
    return [Finding("spikes", "repaired", message, count)]


def _without(x: FloatArray, jumps: tuple[int, ...]) -> FloatArray:
    """Give a channel, shape (n,), without some of its changes."""
    step = np.diff(x)
    step[list(jumps)] = 0.0
    return np.append(0.0, np.cumsum(np.nan_to_num(step)))


def _jump_findings(t: FloatArray, x: FloatArray, jumps: tuple[int, ...]) -> list[Finding]:
    """Refuse a displacement that goes on elsewhere."""
    if not jumps:
        return []
    sizes = np.abs(np.diff(x))[list(jumps)]
    worst = jumps[int(np.nanargmax(sizes))]
    message = (
        f"displacement jumps {len(jumps)} time{'s' if len(jumps) > 1 else ''} from one row to the next, by up to "
        f"{np.nanmax(sizes):.3g} mm, at {t[worst]:.6g} s, which the rest of the record excludes, while the force goes "
        "on: a sensor slipped, or rows are no readings; correct the displacement behind each jump, take such rows out "
        "of the file, or give the parts between them as files of their own"
    )
    return [Finding("jumps", "unusable", message, len(jumps))]


def _stop_findings(t: FloatArray, f: FloatArray, dead: BoolArray) -> list[Finding]:
    """Name a force channel that has stopped."""
    count = int(np.count_nonzero(dead))
    if count == 0:
        return []
    share, first = count / f.size, int(np.argmax(dead))
    unit, factor = unit_of(f)
    message = (
        f"force holds {f[first] * factor:.4g} {unit} in {count} rows ({share:.1%}), from {t[first]:.6g} s, while the "
        "device moves: its channel has stopped; these rows are not used as evidence"
    )
    return [Finding("stopped", "unusable" if share > 0.5 else "warning", message, count)]


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
