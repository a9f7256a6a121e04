"""Checks and safe repairs in order: the clock, the rates, the cells, the magnitudes, the sign, the loop."""

import shlex
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.clock import clock_findings, orderly_rows, step_spread
from shj_bayes.recording.columns import RawChannels
from shj_bayes.recording.motion import Motion, blind_stretches, hysteresis, least_return, motion_of
from shj_bayes.recording.readings import clipped, complete_rows, fill, held, not_readings, runs, stopped
from shj_bayes.recording.recording import Finding, Recording, noise_of, unit_of
from shj_bayes.recording.units import TARGET, Role, factor


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
    t, x, f, repeats = _at_own_rates(t, x, f, findings)
    bad_x, bad_f = _without_readings(t, x, f, findings)
    x, f = np.where(bad_x, np.nan, x), np.where(bad_f, np.nan, f)
    keep = complete_rows(x, f, findings)
    t, x, f, repeats = t[keep], x[keep], f[keep], repeats[keep]
    if t.size < 2:
        raise RecordingError(f"{name}: {t.size} rows have displacement and force; at least 2 are needed")
    x, filled_x = fill(t, x, "displacement", bad_x[keep], findings)
    f, filled_f = fill(t, f, "force", bad_f[keep], findings)
    standing = _standing(t, x, f, findings)
    findings += [*clock_findings(t, x), *_magnitudes(x, f)]
    used = ~(repeats | filled_x | filled_f | standing)
    return t, x, _signed(t, x, f, used, findings), used, tuple(findings)


def _at_own_rates(
    t: FloatArray, x: FloatArray, f: FloatArray, findings: list[Finding]
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Take a channel that is slower than the table at its own rate; the last value marks rows that repeat a force."""

    def say(label: str, period: float, then: str) -> None:
        rate = 1.0 / float(np.median(np.diff(t)))
        ordinal = {2.0: "2nd", 3.0: "3rd"}.get(round(period, 1), f"{round(period, 1):g}th")
        message = (
            f"{label} changes in every {ordinal} row only, at {rate / period:.4g} Hz of {rate:.4g} Hz: its channel is "
            f"slower than the table; it is used at its own rate, and {then}"
        )
        findings.append(Finding("held", "repaired", message))

    if of := held(x):
        say("displacement", of.period, "the rows with a new one are kept")
        t, x, f = of.at_readings(t), x[of.fresh], of.at_readings(f)
    if not (of := held(f)):
        return t, x, f, np.zeros(t.size, dtype=np.bool_)
    say("force", of.period, "the rows that repeat one are not used as evidence")
    moments, places = t.copy(), x.copy()
    moments[of.fresh], places[of.fresh] = of.at_readings(t), of.at_readings(x)
    return moments, places, f, ~of.fresh


def _without_readings(
    t: FloatArray, x: FloatArray, f: FloatArray, findings: list[Finding]
) -> tuple[BoolArray, BoolArray]:
    """Cells of displacement and force that are no readings; a displacement that goes on elsewhere is refused."""
    bad_x, bad_f, jumps = not_readings(t, x, f)
    step = np.nan_to_num(np.diff(x))
    if jumps:
        moves, known = step.copy(), np.isfinite(f)
        moves[jumps] = 0.0
        if _exchanged(np.append(0.0, np.cumsum(moves)), np.interp(t, t[known], f[known])) > limits.SWAPPED_PRODUCT:
            # A force that is taken for the displacement jumps because it is one.
            bad_x, bad_f, jumps = np.zeros_like(bad_x), np.zeros_like(bad_f), []
    for label, values, bad in (("displacement", x, bad_x), ("force", f, bad_f)):
        if bad.any():
            count, times, first = int(np.count_nonzero(bad)), len(runs(bad)), int(np.argmax(bad))
            unit, scale = _unit_of(label, values[~bad & np.isfinite(values)])
            message = (
                f"{label} jumps away and back {times} time{'s' if times > 1 else ''} ({count} rows), first to "
                f"{values[first] * scale:.4g} {unit} at {t[first]:.6g} s, as no device does; taken for no readings: "
                "bridged or left out, and not used as evidence"
            )
            findings.append(Finding("spikes", "repaired", message, count))
    if jumps:
        worst = jumps[int(np.argmax(np.abs(step[jumps])))]
        message = (
            f"displacement jumps {len(jumps)} time{'s' if len(jumps) > 1 else ''} from one row to the next, by up to "
            f"{abs(step[worst]):.3g} mm, at {t[worst]:.6g} s, which the rest of the record excludes, while the force "
            "goes on: a sensor slipped, or rows are no readings; correct the displacement behind each jump, take such "
            "rows out of the file, or give the parts between them as files of their own"
        )
        findings.append(Finding("jumps", "unusable", message, len(jumps)))
    return bad_x, bad_f


def _unit_of(label: str, values: FloatArray) -> tuple[str, float]:
    """Give the unit in which a channel is shown, and how many of it make a mm or kN."""
    return ("mm", 1.0) if label == "displacement" else unit_of(values)


def _standing(t: FloatArray, x: FloatArray, f: FloatArray, findings: list[Finding]) -> BoolArray:
    """Mark where a channel is clipped or has stopped; a displacement that is clipped no longer drives the law."""
    cut_x, cut_f, dead = clipped(x, f), clipped(f, x), stopped(f, x)
    for label, values, cut, most in (("displacement", x, cut_x, limits.BAD_CELL_SHARE), ("force", f, cut_f, 0.5)):
        if cut.any():
            count, share, (unit, scale) = int(np.count_nonzero(cut)), float(np.mean(cut)), _unit_of(label, values)
            levels = " and ".join(f"{level * scale:.4g}" for level in np.unique(values[cut]))
            where = f"{levels} {unit} in {count} samples ({share:.1%})"
            message = f"{label} is clipped at {where}, which are not used as evidence"
            findings.append(Finding("clipped", "unusable" if share > most else "warning", message, count))
    if dead.any():
        count, share, first, (unit, scale) = int(dead.sum()), float(np.mean(dead)), int(np.argmax(dead)), unit_of(f)
        since = f"{len(places)} times, first from" if len(places := runs(dead)) > 1 else "from"
        message = (
            f"force holds {f[first] * scale:.4g} {unit} in {count} rows ({share:.1%}), {since} {t[first]:.6g} s, "
            "while the device moves: its channel has stopped; these rows are not used as evidence"
        )
        findings.append(Finding("stopped", "unusable" if share > 0.5 else "warning", message, count))
    return np.asarray(cut_x | cut_f | dead)


def _magnitudes(displacement_mm: FloatArray, force_kN: FloatArray) -> list[Finding]:
    """Ranges that no device of this kind has, which means a wrong unit or column."""
    force, varies = float(np.max(np.abs(force_kN))), float(np.ptp(force_kN))
    stroke = float(np.ptp(displacement_mm))
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


def _changes(values: FloatArray) -> FloatArray:
    """Take the change over each thousandth of a record, shape (n,); from sample to sample it would be mostly noise."""
    return np.diff(values[:: max(1, values.size // 1000)])


def _shape(values: FloatArray) -> FloatArray:
    """How a channel moves, shape (2,): rms over mean of its changes; rms of second changes over that of the first."""
    change = _changes(values)
    mean, size = float(np.mean(np.abs(change))), float(np.sqrt(np.mean(change**2)))
    rough = float(np.sqrt(np.mean(np.diff(change) ** 2))) / size if change.size > 1 and size > 0 else 0.0
    return np.array([size / mean if mean > 0 else 0.0, rough])


def _half_cycles(values: FloatArray) -> int:
    """Count the half-cycles of a channel, shape (n_samples,), with the threshold that the displacement has."""
    return len(hysteresis(values, least_return(values, noise_of(values)))) + 1


def _exchanged(displacement_mm: FloatArray, force_kN: FloatArray) -> float:
    """Product of the ratios of jumps, roughness, half-cycles: at most 1.8 in 26 public recordings, 12 if exchanged."""
    alike = float(np.prod(_shape(displacement_mm) / np.maximum(_shape(force_kN), 1e-300)))
    return alike * _half_cycles(displacement_mm) / _half_cycles(force_kN)


def _signed(t: FloatArray, x: FloatArray, f: FloatArray, used: BoolArray, findings: list[Finding]) -> FloatArray:
    """Turn a force of the wrong sign round; name columns that seem swapped.

    A passive device takes up energy. A loop that gives energy back has one channel with the wrong sign, or the two
    channels swapped. Turning the force round is safe: it only exchanges the names push and pull. Swapping is not: it is
    for the user to say which column is which. Where only a part of the loop gives energy back, neither is right.
    """
    changes = list(_changed_force(t, x, f, used))
    if changes and _exchanged(x, f) <= limits.SWAPPED_PRODUCT:
        findings += changes
        return f
    # Work over that of a rigid friction loop of the same range and travel: about 0.8 for friction, 0 for elastic.
    low, high = np.percentile(f, [2, 98])
    most = 0.5 * float(high - low) * float(np.sum(np.abs(_changes(x))))
    work = float(np.sum((0.5 * (f[1:] + f[:-1]) - 0.5 * (low + high)) * np.diff(x)))
    area = work / most if most > 0 else 0.0
    if area > -limits.SIGN_SHARE:
        return f
    lost = f"(area {area:+.2f} of a friction loop; above {-limits.SIGN_SHARE:g} is allowed)"
    if _exchanged(x, f) > limits.SWAPPED_PRODUCT:
        message = (
            f"displacement and force seem swapped: the loop gives energy back {lost}, and the displacement is rougher "
            f"than the force, jumps more and turns more often ({_half_cycles(x)} half-cycles, the force "
            f"{_half_cycles(f)})"
        )
        findings.append(Finding("swapped-columns", "unusable", message))
        return f
    message = (
        f"the loop gave energy back {lost}, so one channel has the wrong sign; the force is turned round, which "
        "exchanges the names push and pull"
    )
    findings.append(Finding("force-sign", "repaired", message))
    return -f


def _changed_force(t: FloatArray, x: FloatArray, f: FloatArray, used: BoolArray) -> Iterator[Finding]:
    """Refuse a force of which the sign or the scale changes within the record: a cable turned round, a range switched.

    Compared are the levels of two half-cycles each, before and behind every half-cycle, where the device slides: work
    over travel, from which what is elastic, a mass and an offset cancel. Wear, speed or a lost bolt change no level
    threefold from one half-cycle to the next of the same stroke and duration.
    """
    turns = np.array(hysteresis(x, least_return(x, noise_of(x))), dtype=np.int64)
    if turns.size < limits.LEVEL_TURNS or not used.any():
        return
    f = np.interp(t, t[used], f[used])  # a force that is repeated or clipped does no work of its own
    work = np.append(0.0, np.cumsum(0.5 * (f[1:] + f[:-1]) * np.diff(x)))
    sums = np.array([np.diff(work[turns]), np.abs(np.diff(x[turns])), np.diff(t[turns])])
    done, travel, lasted = sums[:, 1:] + sums[:, :-1]
    level = done / travel
    high, low = (limit.reduceat(f, turns)[:-1] for limit in (np.maximum, np.minimum))
    swing = 0.5 * (np.maximum(high[1:], high[:-1]) - np.minimum(low[1:], low[:-1]))
    seen = np.add.reduceat(used.astype(np.int64), turns)[:-1] >= limits.MIN_SAMPLES_PER_HALF_CYCLE
    slides = (np.abs(level) > limits.SIGN_SHARE * swing) & seen[1:] & seen[:-1]
    found = []
    for k in range(2, level.size - 1):
        earlier, later = np.flatnonzero(slides[: k - 1])[-3:], np.flatnonzero(slides[k + 1 :])[:3] + k + 1
        if not slides[k - 2] or not slides[k + 1] or min(earlier.size, later.size) < 2:
            continue
        before, behind = level[k - 2], level[k + 1]
        same, other, ratio = level[earlier] / before, level[later] / before, behind / before
        turned = bool(np.all(same > 0) and np.all(other < 0))
        alike = all(abs(np.log(one[k + 1] / one[k - 2])) < np.log(limits.LEVEL_ALIKE) for one in (travel, lasted))
        scaled = np.all((same > 0.5) & (same < 2.0)) and (
            (ratio > limits.LEVEL_FACTOR and np.all(other > 2.0))
            or (0 < ratio * limits.LEVEL_FACTOR < 1 and np.all(other < 0.5))
        )
        if turned or (alike and scaled):
            found.append((abs(behind - before), k, turned))
    if not found:
        return
    _, k, turned = max(found)
    what, before, behind = "sign" if turned else "scale", level[k - 2], level[k + 1]
    # The moment from which the work follows the second level rather than the first.
    near = slice(int(turns[k - 1]), int(turns[k + 2]))
    gain, way = np.diff(work)[near], np.abs(np.diff(x))[near]
    moment = near.start + int(np.argmin(np.cumsum((gain - before * way) ** 2 - (gain - behind * way) ** 2))) + 1
    message = (
        f"the force changes its {what} at about {t[moment]:.6g} s: {before:.4g} kN along the motion before, "
        f"{behind:.4g} kN behind it, as no device does: a cable, a range or a unit was changed; correct the force "
        "behind it, or give the parts as files of their own"
    )
    yield Finding("force-changes", "unusable", message)


def inspect(recording: Recording) -> tuple[Finding, ...]:
    """Run the checks that need the half-cycles; the recording's own findings are not repeated."""
    try:
        motion = motion_of(recording)
    except RecordingError as error:
        return tuple(_few_points(recording, None)) or (Finding("no-motion", "unusable", str(error)),)
    findings, n, n_half = [*_few_points(recording, motion)], recording.n_samples, motion.n_half
    if n < limits.MIN_SAMPLES:
        message = f"{n} samples; at least {limits.MIN_SAMPLES} are needed; export every row, or sample faster"
        findings.append(Finding("few-samples", "unusable", message))
    if n_half < limits.FEW_HALF_CYCLES:
        message = (
            f"{n_half} half-cycles; at least {limits.MIN_HALF_CYCLES} are needed, {limits.FEW_HALF_CYCLES} to see a "
            "change from cycle to cycle; record more cycles"
        )
        findings.append(Finding("few-cycles", "unusable" if n_half < limits.MIN_HALF_CYCLES else "warning", message))
    if blind := blind_stretches(recording, motion):
        count = len({sample for first, last in blind for sample in range(first, last)})
        message = (
            f"the device may have turned unseen in {len(blind)} gap{'s' if len(blind) > 1 else ''} in time, first "
            f"before {recording.time_s[blind[0][0]]:.6g} s; {count} samples, up to the second reversal after each, are "
            "not used as evidence; export the test without the gap, or the parts as files of their own"
        )
        findings.append(Finding("gap-turns", "warning", message, count))
    if n / n_half < limits.MIN_SAMPLES_PER_HALF_CYCLE and not findings:
        message = (
            f"{n / n_half:.1f} samples in a half-cycle; at least {limits.MIN_SAMPLES_PER_HALF_CYCLE} are needed "
            f"to see the stiffness; sample faster"
        )
        findings.append(Finding("coarse-sampling", "warning", message))
    return (*findings, *_resampled(recording, n_half), *_offsets(recording, motion), *_lag(recording, motion))


def _few_points(recording: Recording, motion: Motion | None) -> Iterator[Finding]:
    """Refuse points that are too few, or too uneven in time, to show where the motion turns, and with it K and beta.

    Turning points alone, points picked off a figure, rows thinned out: the displacement from one to the next is not
    known, and what is not known of it looks like noise. The force tells: it turns round where no reversal is found.
    """
    x, f, n = recording.displacement_mm, recording.force_kN, recording.n_samples
    turns = hysteresis(x, limits.FEW_RETURN * float(np.ptp(x)))
    apart = float(np.median(np.diff(turns))) if len(turns) > limits.FEW_HALF_CYCLES else np.inf
    low, high = (float(level) for level in np.percentile(f, [5, 95]))
    push = (f - 0.5 * (low + high)) / max(0.5 * (high - low), 1e-300)  # over the plateau
    if apart < limits.FEW_APART and float(np.median(np.sign(x[turns] - np.median(x)) * push[turns])) > 0.5:
        few = f"{apart:.3g} points from one reversal to the next"
    elif motion is None:
        return
    else:
        per_half, spread = n / motion.n_half, step_spread(recording.time_s)
        gaps = (np.count_nonzero(recording.restarts) - 1) / motion.n_half
        along = motion.direction[motion.half_cycle] * push
        with_it = np.concatenate([np.maximum.accumulate(part) for part in np.split(along, motion.start[1:-1])])
        against = float(np.mean((along < -0.5) & (with_it > 0.5)))  # share after the force was with the motion
        if per_half < limits.FEW_UNSEEN and against > limits.FEW_AGAINST:
            few = f"{per_half:.3g} points in a half-cycle, and the force turns round where no reversal is found"
        elif per_half < limits.FEW_UNEVEN and spread > 1.0:
            few = f"{per_half:.3g} points in a half-cycle, at times whose steps vary by {spread:.0%}"
        elif per_half < limits.FEW_GAPS and gaps > 0.5:
            few = f"{per_half:.3g} points in a half-cycle, with {gaps:.2g} gaps in time"
        else:
            return
    message = (
        f"{few}: too few to tell K and beta; give the rows as they were recorded, or of a figure at least "
        f"{limits.FEW_UNEVEN} points in each half-cycle, at even steps of time"
    )
    yield Finding("few-points", "unusable", message, n)


def _offsets(recording: Recording, motion: Motion) -> Iterator[Finding]:
    """Displacement off the middle of the stroke, force off the middle of its plateaus or not zero in a rest before."""
    x, f = motion.displacement_mm, recording.force_kN
    low, high = float(np.min(motion.turning_mm)), float(np.max(motion.turning_mm))
    centre, half_stroke = 0.5 * (high + low), 0.5 * (high - low)
    if half_stroke <= 0:
        return
    if limits.CENTRE_SHARE * half_stroke < abs(centre) < 0.5 * half_stroke:  # strokes from one end are no offset
        share = abs(centre) / half_stroke
        message = f"the middle of the stroke is at {centre:+.3g} mm, {share:.0%} of the amplitude; kept as it is"
        yield Finding("displacement-offset", "note", message)
    # The second half of each stroke: the first may be slack or elastic.
    from_turn = np.abs(x - x[motion.start[:-1]][motion.half_cycle])
    ranges = [float(np.ptp(part)) for part in np.split(x, motion.start[1:-1])]
    late = from_turn > 0.5 * np.array(ranges)[motion.half_cycle]
    sides = [f[late & (motion.direction[motion.half_cycle] == way)] for way in (1, -1)]
    if not all(side.size for side in sides):
        return
    push, pull = (float(np.median(side)) for side in sides)
    offset, half, (unit, scale) = 0.5 * (push + pull), 0.5 * abs(push - pull), unit_of(f)
    if abs(offset) > limits.OFFSET_SHARE * half:
        message = (
            f"the force is {push * scale:.4g} {unit} pushing and {pull * scale:.4g} {unit} pulling, "
            f"{offset * scale:+.3g} {unit} off centre; kept as it is: a load cell that was not zeroed, or a device "
            "that differs in push and pull"
        )
        yield Finding("force-offset", "note", message)
    extent = float(np.ptp(x))
    still = np.abs(x - x[0]) < max(5 * motion.noise_mm, 1e-3 * extent)
    n = int(np.argmin(still)) if not still.all() else 0
    # Coarse sampling makes motion look like noise, and then everything seems to be at rest.
    if n < limits.REST_SAMPLES or motion.noise_mm > 0.01 * extent:
        return
    if abs(force := float(np.median(f[:n]))) > limits.OFFSET_SHARE * half:
        at_rest = f"{force * scale:+.3g} {unit} ({n} samples)"
        message = f"force at rest before the first movement is {at_rest}, not zero; kept as it is"
        yield Finding("rest-offset", "note", message, n)


def _lag(recording: Recording, motion: Motion) -> Iterator[Finding]:
    """Delay for which the force drop after reversals is proportional to the travel, where these tell one."""
    time_s, step = recording.time_s, 1.0 / recording.rate_Hz
    pieces = _unloading(recording, motion)
    if len(pieces) < 4:
        return
    shortest = float(np.min(np.diff(time_s[np.minimum(motion.start, recording.n_samples - 1)])[1:-1]))
    lags = np.linspace(-0.1, 0.3, 81) * shortest
    wrong, last = np.zeros(lags.size), motion.n_half - 1
    for k, times, drop in pieces:
        # The lags are shorter than a half-cycle; np.interp takes its time over a whole long recording.
        near = slice(int(motion.start[k - 1]), int(motion.start[min(k + 1, last) + 1]))
        for i, lag in enumerate(lags):
            place = np.interp(times - lag, time_s[near], motion.displacement_mm[near])
            travel = np.maximum(motion.direction[k] * (place - motion.turning_mm[k]), 0.0)
            slope = float(travel @ drop) / max(float(travel @ travel), 1e-300)  # one stiffness for each reversal
            wrong[i] += float(np.sum((drop - slope * travel) ** 2))
    misfit = wrong / sum(float(np.sum(drop**2)) for *_, drop in pieces)
    best, none = int(np.argmin(misfit)), int(np.argmin(np.abs(lags)))
    lag = float(lags[best])
    # Where the force falls before the turn there are other reasons than a late sensor, so more is asked for.
    better = 0.5 if lag > 0 else 0.15
    told = 0 < best < lags.size - 1 and misfit[best] <= 0.02 and misfit[best] <= better * misfit[none]
    if not told or abs(lag) < limits.LAG_STEPS * step:
        return
    size = f"by about {1e3 * abs(lag):.3g} ms ({abs(lag) / step:.1f} samples)"
    if lag > 0:
        message = f"the force lags the displacement {size}, judged from the unloading; nothing is shifted"
    else:
        message = (
            f"the force falls {size} before the displacement turns, as with a filtered displacement or a viscous "
            "device; nothing is shifted"
        )
    yield Finding("lag", "warning" if lag > 0 else "note", message)


def _unloading(recording: Recording, motion: Motion) -> list[tuple[int, FloatArray, FloatArray]]:
    """Half-cycle, times and relative force drops between 5 and 60 % of the plateau, after each reversal."""
    # Of evidence alone: a plateau at which the load cell is clipped, or a reading that is repeated, would seem late.
    used, force, pieces = np.asarray(recording.used), recording.force_kN, []
    for k in range(1, motion.n_half):
        before, a, b = motion.start[k - 1 : k + 2].tolist()
        first = max(before, a - max(3, (a - before) // 20))
        tail = np.flatnonzero(used[first:a]) + first
        top = float(np.median(force[tail])) * -motion.direction[k] if tail.size else 0.0
        if top <= 0:
            continue
        rows = np.flatnonzero(used[a:b]) + a
        drop = 1.0 - force[rows] * -motion.direction[k] / top
        end = int(np.argmax(drop > 0.6)) if np.any(drop > 0.6) else 0
        within = np.flatnonzero(drop[:end] > 0.05)
        within = within[:: max(1, within.size // 100)]
        if within.size >= 3:
            pieces.append((k, recording.time_s[rows[within]], drop[within]))
    return pieces


def _resampled(recording: Recording, n_half: int) -> Iterator[Finding]:
    """Say which channels of a recording of so many half-cycles were interpolated, from what, and what to do."""
    fewest, rate = max(limits.BENDS, limits.BENDS_PER_HALF_CYCLE * n_half), recording.rate_Hz
    channels = {"displacement": recording.displacement_mm, "force": recording.force_kN}
    found = {name: one for name, values in channels.items() if (one := resampled(recording, values, fewest))}
    if not found:
        return
    period, share = list(found.values())[-1]
    message = (
        f"{' and '.join(found)}: {share:.0%} of the samples lie on straight lines, which bend at every "
        f"{period:.3g}th sample: recorded at about {rate / period:.3g} Hz and interpolated to {rate:.4g} Hz, "
        f"{period:.3g} times as many. Interpolated samples are no evidence, and intervals would come out too "
        f"narrow; give the file as it was recorded, or every {round(period)}th row of this one"
    )
    yield Finding("resampled", "warning", message)


def resampled(recording: Recording, values: FloatArray, fewest: int) -> tuple[float, float] | None:
    """Find a channel, shape (n_samples,), that was interpolated linearly, and bends `fewest` times at least.

    Samples from one bend to the next, and the share of those on a line between their neighbours; None where it was not.
    What was interpolated bends at the recorded samples alone (one, or two in one direction), always so many apart.
    Noise bends everywhere; counts of a converter to and fro, by no more than a count or two, which is straight here.
    """
    # Twice the distance from the line between the neighbours; 0 at the ends and beside gaps. Clocks that are printed
    # with few digits misplace samples, so that of lines over time and over the row counts the one that is nearer.
    t, bend = recording.time_s, np.zeros(values.size)
    before, after = values[1:-1] - values[:-2], values[2:] - values[1:-1]
    weight = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    by_row, by_time = after - before, 2.0 * (weight * after - (1.0 - weight) * before)
    bend[1:-1] = np.where(np.abs(by_row) < np.abs(by_time), by_row, by_time)
    late = np.flatnonzero(recording.restarts[1:]) + 1
    bend[late] = bend[late - 1] = 0.0
    # What rounding can explain is straight: the smallest distance of two of the larger values, since numbers printed
    # with so many digits are rounded by ten times as much on one side of a power of ten.
    size = np.abs(values[:: max(1, values.size // limits.SKETCH_SAMPLES)])
    steps, fuzz = np.diff(np.unique(size[size >= np.median(size)])), 1e-9 * float(np.ptp(values))
    straight = limits.BEND_COUNTS * (float(np.min(steps[steps > fuzz])) if np.any(steps > fuzz) else fuzz)
    bent = np.abs(bend) > straight
    first = np.flatnonzero(bent & ~np.append(False, bent[:-1]))
    last = np.flatnonzero(bent & ~np.append(bent[1:], False))
    if first.size < fewest:
        return None
    sharp = (last - first <= 1) & (bend[first] * bend[last] > 0)
    place = first + (last - first) * np.abs(bend[last]) / (np.abs(bend[first]) + np.abs(bend[last]))
    gaps = np.diff(place)[sharp[:-1] & sharp[1:]]
    if gaps.size < limits.BENDS_AGREE * (first.size - 1):
        return None
    middle = float(np.quantile(gaps, 0.5, method="lower"))
    period = float(np.mean(gaps[np.abs(gaps - middle) <= limits.BEND_WITHIN * middle]))
    steps = np.round(gaps / period)
    agree = (steps > 0) & (np.abs(gaps / period - steps) < limits.BEND_WITHIN)
    enough = np.count_nonzero(agree) >= limits.BENDS_AGREE * (first.size - 1)
    most = float(np.sum(gaps[agree])) > 0.5 * values.size
    return (period, float(np.mean(~bent[1:-1]))) if enough and most and period > limits.BEND_PERIOD else None


_OTHERS: dict[Role, tuple[str, ...]] = {"displacement": ("m", "cm", "in"), "force": ("N", "MN"), "time": ("ms", "min")}


def plausibility_findings(
    channels: RawChannels, time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray
) -> Iterator[Finding]:
    """Sizes that are unusual in a unit that was assumed, and columns that look like one another's.

    No check can find a wrong unit that gives a usual size: refused is only what nobody said, warned of what the file
    alone says, and an option that says it settles the matter. The channels say which units were assumed and which
    columns were named; the arrays, of shape (n_samples,), are those after the repairs.
    """
    stroke, force = float(np.ptp(displacement_mm)), float(np.max(np.abs(force_kN)))
    duration = float(time_s[-1] - time_s[0])
    speed = float(np.sum(np.abs(_changes(displacement_mm)))) / max(duration, 1e-300)
    measures: tuple[tuple[Role, float, str, tuple[float, float], str], ...] = (
        ("displacement", stroke, "a stroke of {:.3g} mm", limits.ASSUMED_STROKE_MM, "mm"),
        ("force", force, "a force of up to {:.3g} kN", limits.ASSUMED_FORCE_KN, "kN"),
        ("time", speed, "a mean speed of {:.3g} mm/s", limits.ASSUMED_SPEED_MM_S, "mm/s"),
    )
    for role, value, words, (low, high), unit in measures:
        read, power = channels.units[role], -1 if role == "time" else 1  # a speed is the smaller, the longer its time
        own = value / factor(read, role) ** power
        fit = [name for name in (TARGET[role], *_OTHERS[role]) if low <= own * factor(name, role) ** power <= high]
        usual = f" (it would be usual in {' or '.join(fit)})" if fit else ""
        more = (
            f"(usual is {low:g} to {high:g} {unit}); state it: --units {role}={read} if it is right, else the unit "
            f"that is{usual}"
        )
        if role in channels.assumed and not low <= value <= high:
            message = f"nobody stated the unit of the {role}, and {words.format(value)} is unusual in {read} {more}"
            yield Finding("unit-unlikely", "unusable", message)
        elif role in channels.told and (value > high or (role != "time" and value < low)):
            message = f"the file says {read} for the {role}, and {words.format(value)} is unusual {more}"
            yield Finding("unit-unusual", "warning", message)
    if "time" not in channels.assumed and speed < limits.ASSUMED_SPEED_MM_S[0] and duration > limits.LONG_TEST_S:
        message = (
            f"the test lasts {duration / 3600:.3g} h at a mean speed of {speed:.2g} mm/s; if the times are "
            "milliseconds, give --units time=ms"
        )
        yield Finding("time-long", "warning", message)
    # Of 26 public recordings of friction and yielding devices none comes near both limits, nor does white noise on the
    # force, which is rough, or a displacement applied in steps, of which the force has the steps as well.
    of_force = _shape(force_kN)
    bursts, rough = (_shape(displacement_mm) / np.maximum(of_force, 1e-300)).tolist()
    if of_force[1] <= limits.SWAPPED_ROUGHNESS and (bursts >= limits.SWAPPED_BURSTS or rough >= limits.SWAPPED_SMOOTH):
        message = (
            f"displacement and force seem swapped: the displacement jumps like a friction force ({bursts:.1f} times as "
            f"bursty and {rough:.1f} times as rough as the force; below {limits.SWAPPED_BURSTS:g} and "
            f"{limits.SWAPPED_SMOOTH:g} is usual) and the force runs as smoothly as a driven displacement"
        )
        told = {"displacement", "force"} <= channels.named
        yield Finding("swapped-columns", "warning" if told else "unusable", message)


def with_exchange(finding: Finding, channels: RawChannels) -> Finding:
    """Add to a finding of swapped columns the options that exchange them."""
    if finding.code != "swapped-columns":
        return finding
    columns, units = channels.columns, channels.units
    option = shlex.quote(f"displacement={columns['force']},force={columns['displacement']}")
    exchange = f"--columns {option} --units displacement={units['displacement']},force={units['force']}"
    return replace(finding, message=f"{finding.message}; if they are, exchange them: {exchange}")
