"""Checks on the whole loop: magnitude, sign, swapped columns, offset, lag, number of cycles."""

import numpy as np

from shj_bayes.recording import limits
from shj_bayes.recording.clock import step_spread
from shj_bayes.recording.force_unit import unit_of
from shj_bayes.recording.kinematics import blind_stretches
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.noise import noise_of
from shj_bayes.recording.recording import Finding, FloatArray, Recording
from shj_bayes.recording.resampled import resampled_findings
from shj_bayes.recording.reversals import hysteresis, least_return


def magnitude_findings(displacement_mm: FloatArray, force_kN: FloatArray) -> list[Finding]:
    """Ranges, of arrays of shape (n_samples,), that no device of this kind has, which means a wrong unit or column."""
    force, stroke = float(np.max(np.abs(force_kN))), float(np.ptp(displacement_mm))
    varies = float(np.ptp(force_kN))
    checks = (
        (force > limits.MAX_FORCE_KN, "force-unit", f"force up to {force:.6g} kN; the largest machines reach "
         f"{limits.MAX_FORCE_KN:g} kN; if it is in N, use --units force=N"),
        (varies < limits.MIN_FORCE_KN, "force-flat", f"force varies by {varies:.3g} kN only; at least "
         f"{limits.MIN_FORCE_KN:g} kN is needed; check its column and unit"),
        (stroke > limits.MAX_STROKE_MM, "displacement-unit", f"displacement spans {stroke:.6g} mm; at most "
         f"{limits.MAX_STROKE_MM:g} mm is plausible; check its column, or state the unit, such as "
         "--units displacement=mm"),
        (stroke < limits.MIN_STROKE_MM, "displacement-flat", f"displacement spans {stroke:.3g} mm; at least "
         f"{limits.MIN_STROKE_MM:g} mm is needed; is it in m or in? Use --units displacement=m"),
    )  # fmt: skip
    return [Finding(code, "unusable", message) for found, code, message in checks if found]


def dissipation(displacement_mm: FloatArray, force_kN: FloatArray) -> float:
    """Work done on the device over the work of a rigid friction loop with the same force range and travel.

    About 0.8 for friction, 0 for elastic, negative when one of the signs is wrong; arrays have shape (n_samples,).
    """
    step = np.diff(displacement_mm)
    mean = 0.5 * (force_kN[1:] + force_kN[:-1])
    centre = 0.5 * (np.percentile(force_kN, 2) + np.percentile(force_kN, 98))
    half = 0.5 * (np.percentile(force_kN, 98) - np.percentile(force_kN, 2))
    travel = float(np.sum(np.abs(changes(displacement_mm))))
    return float(np.sum((mean - centre) * step) / (half * travel)) if half > 0 and travel > 0 else 0.0


def changes(values: FloatArray) -> FloatArray:
    """Take the change over each thousandth of a record, shape (n,); from sample to sample it would be mostly noise."""
    return np.diff(values[:: max(1, values.size // 1000)])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def burstiness(values: FloatArray) -> float:
    """Root mean square over mean of the changes of a channel, shape (n_samples,).

    Near 1.1 for a driven displacement, more for a force that reverses.
    """
    change = changes(values)
    mean = float(np.mean(np.abs(change)))
    return _rms(change) / mean if mean > 0 else 0.0


def roughness(values: FloatArray) -> float:
    """Root mean square of the second differences over that of the first, at a thousandth of the record.

    Below 0.4 for a driven displacement, 1.7 for white noise.
    """
    change = changes(values)
    if change.size < 2:
        return 0.0
    size = _rms(change)
    return _rms(np.diff(change)) / size if size > 0 else 0.0


def half_cycles(values: FloatArray) -> int:
    """Count the half-cycles of a channel, shape (n_samples,), with the threshold that the displacement has."""
    return len(hysteresis(values, least_return(values, noise_of(values)))) + 1


def exchanged(displacement_mm: FloatArray, force_kN: FloatArray) -> float:
    """How much more the displacement looks like a force, and the force like a driven displacement.

    Product of three ratios: of the jumps, of the roughness and of the half-cycles of displacement and force, shape
    (n_samples,). At most 1.8 in 26 public recordings; 12 and more with their columns exchanged, but for two that were
    digitised.
    """
    measures = (burstiness, roughness, half_cycles)
    return float(np.prod([measure(displacement_mm) / max(measure(force_kN), 1e-300) for measure in measures]))


def sign_findings(displacement_mm: FloatArray, force_kN: FloatArray) -> tuple[FloatArray, list[Finding]]:
    """Turn a force of the wrong sign round; name columns that seem swapped; arrays have shape (n_samples,).

    A passive device takes up energy. A loop that gives energy back has one channel with the wrong sign, or the two
    channels swapped. Turning the force round is safe: it only exchanges the names push and pull. Swapping is not: it is
    for the user to say which column is which.
    """
    area = dissipation(displacement_mm, force_kN)
    if area > -limits.SIGN_SHARE:
        return force_kN, []
    if exchanged(displacement_mm, force_kN) > limits.SWAPPED_PRODUCT:
        message = (
            f"displacement and force seem swapped: the loop gives energy back (area {area:+.2f} of a friction loop; "
            f"above {-limits.SIGN_SHARE:g} is allowed), and the displacement is rougher than the force, jumps more and "
            f"turns more often ({half_cycles(displacement_mm)} half-cycles, the force {half_cycles(force_kN)})"
        )
        return force_kN, [Finding("swapped-columns", "unusable", message)]
    message = (
        f"the loop gave energy back (area {area:+.2f} of a friction loop; above {-limits.SIGN_SHARE:g} is allowed), so "
        "one channel has the wrong sign; the force is turned round, which exchanges the names push and pull"
    )
    return -force_kN, [Finding("force-sign", "repaired", message)]


def cycle_findings(recording: Recording, motion: Motion) -> list[Finding]:
    """Too few samples or half-cycles, offsets and lag."""
    findings = [*few_points(recording, motion)]
    if recording.n_samples < limits.MIN_SAMPLES:
        message = f"{recording.n_samples} samples; at least {limits.MIN_SAMPLES} are needed; export every row"
        message += ", or sample faster"
        findings.append(Finding("few-samples", "unusable", message))
    if motion.n_half < limits.FEW_HALF_CYCLES:
        severe = motion.n_half < limits.MIN_HALF_CYCLES
        message = (
            f"{motion.n_half} half-cycles; at least {limits.MIN_HALF_CYCLES} are needed, "
            f"{limits.FEW_HALF_CYCLES} to see a change from cycle to cycle; record more cycles"
        )
        findings.append(Finding("few-cycles", "unusable" if severe else "warning", message))
    blind = blind_stretches(recording, motion)
    if blind:
        count = len({sample for first, last in blind for sample in range(first, last)})
        message = (
            f"the device may have turned unseen in {len(blind)} gap{'s' if len(blind) > 1 else ''} in time, first "
            f"before {recording.time_s[blind[0][0]]:.6g} s; {count} samples, up to the second reversal after each, are "
            "not used as evidence; export the test without the gap, or the parts as files of their own"
        )
        findings.append(Finding("gap-turns", "warning", message, count))
    per_half = recording.n_samples / motion.n_half
    if per_half < limits.MIN_SAMPLES_PER_HALF_CYCLE and not findings:
        message = (
            f"{per_half:.1f} samples in a half-cycle; at least {limits.MIN_SAMPLES_PER_HALF_CYCLE} are needed "
            f"to see the stiffness; sample faster"
        )
        findings.append(Finding("coarse-sampling", "warning", message))
    findings += resampled_findings(recording, motion.n_half)
    return [*findings, *_offsets(recording, motion), *_lag(recording, motion)]


def few_points(recording: Recording, motion: Motion | None) -> list[Finding]:
    """Refuse points that are too few, or too uneven in time, to show where the motion turns, and with it K and beta.

    Turning points alone, points picked off a figure, rows thinned out: the displacement from one to the next is not
    known, and what is not known of it looks like noise. The force tells: it turns round where no reversal is found.
    Without a `motion` the points alone are judged.
    """
    x, f, n = recording.displacement_mm, recording.force_kN, recording.n_samples
    turns = hysteresis(x, limits.FEW_RETURN * float(np.ptp(x)))
    apart = float(np.median(np.diff(turns))) if len(turns) > limits.FEW_HALF_CYCLES else np.inf
    middle, half = (0.5 * float(s @ np.percentile(f, [5, 95])) for s in (np.array([1, 1]), np.array([-1, 1])))
    push = (f - middle) / max(half, 1e-300)
    few = None
    follows = bool(turns) and float(np.median(np.sign(x[turns] - np.median(x)) * push[turns])) > 0.5
    if apart < limits.FEW_APART and follows:
        few = f"{apart:.3g} points from one reversal to the next"
    elif motion is not None:
        per_half = n / motion.n_half
        spread = step_spread(recording.time_s)
        gaps = (np.count_nonzero(recording.restarts) - 1) / motion.n_half
        if per_half < limits.FEW_UNSEEN and _unseen(motion, push) > limits.FEW_AGAINST:
            few = f"{per_half:.3g} points in a half-cycle, and the force turns round where no reversal is found"
        elif per_half < limits.FEW_UNEVEN and spread > 1.0:
            few = f"{per_half:.3g} points in a half-cycle, at times whose steps vary by {spread:.0%}"
        elif per_half < limits.FEW_GAPS and gaps > 0.5:
            few = f"{per_half:.3g} points in a half-cycle, with {gaps:.2g} gaps in time"
    if few is None:
        return []
    message = (
        f"{few}: too few to tell K and beta; give the rows as they were recorded, or of a figure at least "
        f"{limits.FEW_UNEVEN} points in each half-cycle, at even steps of time"
    )
    return [Finding("few-points", "unusable", message, n)]


def _unseen(motion: Motion, push: FloatArray) -> float:
    """Share of the samples at which the force, over its plateau, is against the motion after it was with it."""
    along = motion.direction[motion.half_cycle] * push
    with_it = np.concatenate([np.maximum.accumulate(part) for part in np.split(along, motion.start[1:-1])])
    return float(np.mean((along < -0.5) & (with_it > 0.5)))


def _offsets(recording: Recording, motion: Motion) -> list[Finding]:
    """Force offset between the two plateaus, and displacement offset of the middle of the stroke."""
    findings = []
    low, high = float(np.min(motion.turning_mm)), float(np.max(motion.turning_mm))
    centre, half_stroke = 0.5 * (high + low), 0.5 * (high - low)
    if half_stroke <= 0:
        return []
    # Strokes that start from one end are no offset.
    if limits.CENTRE_SHARE * half_stroke < abs(centre) < 0.5 * half_stroke:
        message = (
            f"the middle of the stroke is at {centre:+.3g} mm, {abs(centre) / half_stroke:.0%} of the amplitude; "
            f"kept as it is"
        )
        findings.append(Finding("displacement-offset", "note", message))
    push, pull = _plateau(recording, motion, 1), _plateau(recording, motion, -1)
    if push is None or pull is None:
        return findings
    offset, half = 0.5 * (push + pull), 0.5 * abs(push - pull)
    if abs(offset) > limits.OFFSET_SHARE * half:
        unit, n = unit_of(recording.force_kN)
        message = (
            f"the force is {push * n:.4g} {unit} pushing and {pull * n:.4g} {unit} pulling, {offset * n:+.3g} {unit} "
            f"off centre; kept as it is: a load cell that was not zeroed, or a device that differs in push and pull"
        )
        findings.append(Finding("force-offset", "note", message))
    return findings + _rest(recording, motion, half)


def _plateau(recording: Recording, motion: Motion, direction: int) -> float | None:
    """Median force over the second half of the strokes in one direction; the first half may be slack or elastic."""
    late = []
    for k in np.flatnonzero(motion.direction == direction):
        rows = slice(int(motion.start[k]), int(motion.start[k + 1]))
        x = motion.displacement_mm[rows]
        late.append(recording.force_kN[rows][np.abs(x - x[0]) > 0.5 * float(np.ptp(x))])
    values = np.concatenate(late) if late else np.zeros(0)
    return float(np.median(values)) if values.size else None


def _rest(recording: Recording, motion: Motion, half: float) -> list[Finding]:
    """Force before the first movement, when the recording begins at rest."""
    x = motion.displacement_mm
    still = np.abs(x - x[0]) < max(5 * motion.noise_mm, 1e-3 * float(np.ptp(x)))
    n = int(np.argmin(still)) if not still.all() else 0
    # Coarse sampling makes motion look like noise, and then everything seems to be at rest.
    if n < limits.REST_SAMPLES or motion.noise_mm > 0.01 * float(np.ptp(x)):
        return []
    force = float(np.median(recording.force_kN[:n]))
    if abs(force) <= limits.OFFSET_SHARE * half:
        return []
    unit, factor = unit_of(recording.force_kN)
    at_rest = f"{force * factor:+.3g} {unit} ({n} samples)"
    message = f"force at rest before the first movement is {at_rest}, not zero; kept as it is"
    return [Finding("rest-offset", "note", message, n)]


def _lag(recording: Recording, motion: Motion) -> list[Finding]:
    """Delay of the force after the displacement, where the unloading branches show one."""
    lag = lag_of(recording, motion)
    step = 1.0 / recording.rate_Hz
    if lag is None or abs(lag) < limits.LAG_STEPS * step:
        return []
    size = f"by about {1e3 * abs(lag):.3g} ms ({abs(lag) / step:.1f} samples)"
    if lag > 0:
        message = f"the force lags the displacement {size}, judged from the unloading; nothing is shifted"
        return [Finding("lag", "warning", message)]
    message = (
        f"the force falls {size} before the displacement turns, as with a filtered displacement or a viscous device; "
        f"nothing is shifted"
    )
    return [Finding("lag", "note", message)]


def lag_of(recording: Recording, motion: Motion) -> float | None:
    """Delay, s, for which the force drop after reversals is proportional to the travel; None where it cannot be told.

    Positive when the force is late.
    """
    pieces = _unloading(recording, motion)
    if len(pieces) < 4:
        return None
    shortest = float(np.min(np.diff(recording.time_s[np.minimum(motion.start, recording.n_samples - 1)])[1:-1]))
    lags = np.linspace(-0.1, 0.3, 81) * shortest
    misfit = np.array([_misfit(pieces, recording.time_s, motion, lag) for lag in lags])
    best = int(np.argmin(misfit))
    none = int(np.argmin(np.abs(lags)))
    # Where the force falls before the turn there are other reasons than a late sensor, so more is asked for.
    better = 0.5 if lags[best] > 0 else 0.15
    if best in (0, lags.size - 1) or misfit[best] > 0.02 or misfit[best] > better * misfit[none]:
        return None
    return float(lags[best])


def _unloading(recording: Recording, motion: Motion) -> list[tuple[int, FloatArray, FloatArray]]:
    """For each reversal: its half-cycle, and times and relative force drops between 5 and 60 % of the plateau.

    Of samples that are evidence: a plateau at which the load cell is clipped, or a reading that is repeated, would seem
    to be late.
    """
    used, pieces = np.asarray(recording.used), []
    for k in range(1, motion.n_half):
        a, b, before = int(motion.start[k]), int(motion.start[k + 1]), int(motion.start[k - 1])
        first = max(before, a - max(3, (a - before) // 20))
        tail = np.flatnonzero(used[first:a]) + first
        top = float(np.median(recording.force_kN[tail])) * -motion.direction[k] if tail.size else 0.0
        if top <= 0:
            continue
        rows = np.flatnonzero(used[a:b]) + a
        drop = 1.0 - recording.force_kN[rows] * -motion.direction[k] / top
        end = int(np.argmax(drop > 0.6)) if np.any(drop > 0.6) else 0
        within = np.flatnonzero(drop[:end] > 0.05)
        within = within[:: max(1, within.size // 100)]
        if within.size >= 3:
            pieces.append((k, recording.time_s[rows[within]], drop[within]))
    return pieces


def _misfit(pieces: list[tuple[int, FloatArray, FloatArray]], time_s: FloatArray, motion: Motion, lag: float) -> float:
    """Share of the drops that is not proportional to the travel a lag earlier, with one stiffness per reversal."""
    wrong = total = 0.0
    last = motion.n_half - 1
    for k, times, drop in pieces:
        # The lags are shorter than a half-cycle; np.interp takes its time over a whole long recording.
        near = slice(int(motion.start[k - 1]), int(motion.start[min(k + 1, last) + 1]))
        place = np.interp(times - lag, time_s[near], motion.displacement_mm[near])
        travel = motion.direction[k] * (place - motion.turning_mm[k])
        travel = np.maximum(travel, 0.0)
        slope = float(travel @ drop) / max(float(travel @ travel), 1e-300)
        wrong += float(np.sum((drop - slope * travel) ** 2))
        total += float(np.sum(drop**2))
    return wrong / total if total > 0 else 1.0
