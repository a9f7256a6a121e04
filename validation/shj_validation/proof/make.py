"""From a key to recordings: the simulators drive the rig, the recorder samples it, noise is added."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.recording.recording import Recording, Source
from shj_validation.proof.cases import Concealed, Key
from shj_validation.proof.device import Device
from shj_validation.proof.noise import force_noise
from shj_validation.proof.protocols import EARLIER, Course, course, peak_speed
from shj_validation.proof.simulators.mechanism import two_poles
from shj_validation.proof.simulators.rig import Acts, Drive, drives, join, rate_free
from shj_validation.proof.simulators.simulator import simulators_by_id

FINE_HZ, FAST_HZ = 100.0, 1000.0  # steps a second, or one for each sample if that is more: quasi-static, with a mass
STROKE_MM = 95.0  # half of a slot; a test may use less of it
N_RUNS = 2
EARTHQUAKE_SPEED = 0.9  # of the protocol's peak speed: the law is not asked beyond what was tested
EARTHQUAKE_REACH = 0.95  # of the tested displacements, for the same reason


@dataclass(frozen=True, eq=False)
class Made:
    """One run: what was recorded, and what a perfect recorder would have shown.

    Parameters
    ----------
    recording : Recording
        With noise, as the diagnosis sees it.
    clean_kN : array, shape (n,)
        Force without noise and rounding, kN.
    noise_kN : array, shape (n,)
        Recorded less clean force, kN.
    x_mm : array, shape (n,)
        Displacement without noise, mm, where it is measured.
    """

    recording: Recording
    clean_kN: FloatArray
    noise_kN: FloatArray
    x_mm: FloatArray


def make(
    key: Key,
    *,
    heldout: bool = False,
    effects: Sequence[Concealed] | None = None,
    then: Sequence[Course] = (),
    speed_share: float = 1.0,
) -> list[Made]:
    """Make the recordings of a trial.

    Parameters
    ----------
    key : Key
        What is concealed.
    heldout : bool
        Whether to add the slowed earthquake that follows the two runs; the diagnosis never sees it.
    effects : sequence of Concealed, optional
        In place of the key's own: none gives the same rig without what is concealed.
    then : sequence of Course
        Runs that follow the first in the place of the second one, at its sliding force.
    speed_share : float
        Share of the speed that the device feels: 0 for the same strokes next to standstill.

    Returns
    -------
    list of Made
    """
    chosen = key.effects if effects is None else effects
    known = simulators_by_id()
    stepped = FAST_HZ if any(known[one.id].fast for one in key.effects) else FINE_HZ
    fine = max(1, round(stepped / key.rate_Hz))
    noise, shake, own = (np.random.SeedSequence(key.entropy, spawn_key=(i,)) for i in range(3))
    first = course(key.protocol, key.rate_Hz, fine, np.random.default_rng(own), peak_speed(key.protocol))
    courses = [first] * (1 if then else N_RUNS)
    if heldout:
        speed = EARTHQUAKE_SPEED * peak_speed(key.protocol)
        within = {} if key.protocol in EARLIER else {"within_mm": _tested(first)}
        courses.append(course("earthquake", key.rate_Hz, fine, np.random.default_rng(shake), speed, **within))
    courses += then
    if key.machine_kN_mm:
        courses = [_across_the_slip(one, key, run) for run, one in enumerate(courses, start=1)]
    rigs = drives(courses, key.device, STROKE_MM, float(courses[0].time_s[-1]), key.nuisance.frame_kN_mm, key.reversal)
    parts = [known[one.id].act(rigs, one.size, one.shape, key.device) for one in chosen]
    out = []
    for run, (drive, stream) in enumerate(zip(rigs, noise.spawn(max(N_RUNS + 1, len(courses))), strict=False)):
        acts = join([part[run] for part in parts])
        force = _at_the_device(drive, key, acts, speed_share)
        stretch = force / key.machine_kN_mm if key.machine_kN_mm else 0.0
        shown = replace(drive.course, x_mm=drive.course.x_mm + stretch)
        cell = _at_the_cell(force, drive, key, acts)
        out.append(_record(shown, cell, key, np.random.default_rng(stream), f"run{run + 1}.csv"))
    return out


def _tested(path: Course) -> tuple[float, float]:
    """Give where an earthquake stays that goes nowhere else than a test went, mm."""
    low, high = float(path.x_mm.min()), float(path.x_mm.max())
    spare = 0.5 * (1.0 - EARTHQUAKE_REACH) * (high - low)
    return low + spare, high - spare


def _across_the_slip(path: Course, key: Key, run: int) -> Course:
    """Motion of a device that is driven through a machine which deforms: what the machine moves, less its stretch.

    The stretch is that of the device without anything concealed; what is concealed stretches the machine a little
    more, which stands in the displacement that is recorded.
    """
    machine, device = key.machine_kN_mm, key.device
    both = replace(device, K=1.0 / (1.0 / device.K + 1.0 / machine))
    capacity = device.Fy * (device.ratio if run > 1 else 1.0)
    drive = Drive(path, capacity, np.zeros(path.x_mm.size), STROKE_MM, float(path.time_s[-1]), machine)
    force = rate_free(drive, both, Acts()) * (1.0 + device.gamma * drive.speed)
    return replace(path, x_mm=path.x_mm - force / machine)


def _at_the_device(drive: Drive, key: Key, acts: Acts, speed_share: float) -> FloatArray:
    """Force on the fine grid, kN."""
    device: Device = key.device
    force = rate_free(drive, device, acts)
    return np.asarray(force * (1.0 + (device.gamma + acts.speed_per_mm_s) * speed_share * drive.speed) + acts.added_kN)


def _at_the_cell(force: FloatArray, drive: Drive, key: Key, acts: Acts) -> FloatArray:
    """Force channel on the fine grid, without noise, kN."""
    if acts.filter_s > 0:
        force = two_poles(force, drive.dt, acts.filter_s)
    late = acts.delay_s + key.nuisance.lag_s
    time = drive.course.time_s
    return np.asarray(np.interp(time - late, time, force) + acts.sensor_kN + key.nuisance.offset_kN)


def _record(path: Course, force: FloatArray, key: Key, rng: np.random.Generator, name: str) -> Made:
    """Sample, add noise, round."""
    every = slice(None, None, path.every)
    time, x, clean = path.time_s[every], path.x_mm[every], force[every]
    n = key.nuisance
    speed, dt = np.abs(path.v_mm_s[every]), path.dt_s * path.every
    noise = force_noise(n.noise, speed, dt, n.noise_kN, n.noise_memory_s, rng, clean)
    noise[0] += key.first_sd * n.noise_kN
    measured = np.round((clean + noise) / n.force_step_kN) * n.force_step_kN
    wobble = n.displacement_noise_mm * rng.standard_normal(x.size)
    moved = np.round((x + wobble) / n.displacement_step_mm) * n.displacement_step_mm
    recording = Recording(np.round(time, 6), moved, measured, source=Source(name))
    return Made(recording, clean, measured - clean, x)
