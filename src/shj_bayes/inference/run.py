"""One run as evidence: the recording, its motion, and which of its samples count."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from shj_bayes.errors import InferenceError
from shj_bayes.model.augmented import UNLOADED
from shj_bayes.model.history import History, Measured, histories, measured_in
from shj_bayes.recording.motion import Motion, motion_of
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.smoothing import Channel, Refusal, channel_of

MOVED = 2e-3  # of the largest stroke: more than noise
LOADED = 0.3  # likewise: how far a first loading is followed as a straight line


@dataclass(frozen=True, eq=False)
class Run:
    """One run as evidence."""

    recording: Recording  # the measured channels
    motion: Motion  # half-cycles, turning points and speed of its displacement
    begins_kN: float | None = None  # force with which the law starts, where a fit has found it; else it is read

    def __post_init__(self) -> None:
        """Refuse a motion that belongs to another recording."""
        if self.motion.displacement_mm.size != self.recording.n_samples:
            raise InferenceError(
                f"{self.recording.source.name}: motion has {self.motion.displacement_mm.size} samples, "
                f"the recording {self.recording.n_samples}"
            )

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Samples that are evidence: neither repaired nor so near a reversal that their side of it is not known."""
        used, unsure = self.recording.used, self.motion.unsure
        assert used is not None
        assert unsure is not None
        return np.asarray(used & ~unsure)

    @cached_property
    def start_force_kN(self) -> float:
        """Force with which the law starts: 0 for an unloaded device, else what was measured before it moves.

        A device at rest counts as unloaded when that is within the noise. A recording that begins in motion
        has the force of its first displacement, on a straight line through its first loading, until a fit has found it.
        """
        if self.begins_kN is not None:
            return self.begins_kN
        force, x = self.recording.force_kN, self.motion.displacement_mm
        if self._in_motion and self._n_loading > 2:
            some = slice(self._n_loading)
            line = np.polynomial.Polynomial.fit(x[some], force[some], 1)
            return float(line(self.motion.turning_mm[0]))
        first = float(np.median(force[: self._n_rest]))
        noise = 1.4826 * float(np.median(np.abs(np.diff(force))))
        return first if abs(first) > 6 * noise else 0.0

    @cached_property
    def start_noise_mm(self) -> float:
        """Standard deviation of the displacement at which the first half-cycle begins, mm.

        For a device that rests unloaded that of a single reading. Of a recording that begins loaded or in motion the
        force without the part that comes from the speed is not known: by `start_noise_kN`, at the stiffness of its
        first loading.
        """
        force, x, i = self.recording.force_kN, self.motion.displacement_mm, self._n_loading
        if not self.start_noise_kN or i == force.size:
            return self.motion.noise_mm
        return self.start_noise_kN * abs(float(x[i] - x[0])) / abs(float(force[i] - force[0]))

    @cached_property
    def start_noise_kN(self) -> float:
        """Standard deviation of the force with which the law starts, where it does not rest unloaded; else 0.

        The force that is read holds that of the speed, and a constant that is none of the device.
        """
        return UNLOADED * self._largest_kN if self._in_motion or self.start_force_kN else 0.0

    @cached_property
    def _largest_kN(self) -> float:
        """Largest measured force, kN."""
        return float(np.abs(self.recording.force_kN[self.used]).max())

    @cached_property
    def _n_loading(self) -> int:
        """Samples before the force has changed by `LOADED`; all where it never does."""
        force = self.recording.force_kN
        loaded = np.abs(force - force[0]) > LOADED * self._largest_kN
        return int(np.argmax(loaded)) if loaded.any() else int(force.size)

    @cached_property
    def _n_rest(self) -> int:
        """Samples before the device has moved by more than noise, at least one."""
        x = self.motion.displacement_mm
        return max(1, int(np.argmax(np.abs(x - x[0]) > MOVED * np.ptp(x))))

    @cached_property
    def _in_motion(self) -> bool:
        """Whether the recording begins in motion: in half the time it has gone half the way, not a quarter of it."""
        x, n_rest = self.motion.displacement_mm, self._n_rest
        return n_rest <= 2 or bool(abs(x[n_rest // 2] - x[0]) > 0.375 * MOVED * np.ptp(x))

    @cached_property
    def further(self) -> tuple[Channel, ...]:
        """Further channels without their noise."""
        r = self.recording
        return tuple(channel_of(extra, r.time_s, r.force_kN) for extra in r.extras)


def runs_of(recordings: Sequence[Recording]) -> tuple[Run, ...]:
    """Consecutive runs of a device, with their motion."""
    return tuple(Run(recording, motion_of(recording)) for recording in recordings)


def histories_of(runs: Sequence[Run]) -> tuple[History, ...]:
    """Histories of the runs of one device, at all samples."""
    times = [run.recording.time_s for run in runs]
    return histories(times, [run.motion for run in runs], measured_of(runs))


def measured_of(runs: Sequence[Run]) -> tuple[Mapping[str, Measured], ...]:
    """Further channels of each run that a force may depend on, by their coordinates."""
    serves = {one.name for one in further_of(runs) if one.refused is None}
    return measured_in([[one for one in run.further if one.name in serves] for run in runs])


def further_of(runs: Sequence[Run]) -> tuple[Channel, ...]:
    """Give every further channel once, with what keeps it from serving in any of the runs.

    That it is constant in some of them does not: it may differ from run to run.
    """
    out = []
    for name in dict.fromkeys(one.name for run in runs for one in run.further):
        own = [one for run in runs for one in run.further if one.name == name]
        refused = [one for one in own if one.refused not in (None, Refusal.CONSTANT)]
        steady = all(one.refused is Refusal.CONSTANT for one in own)
        if len(own) < len(runs):
            out.append(replace(own[0], refused=Refusal.MISSING, share=1.0 - len(own) / len(runs)))
        else:
            out.append(refused[0] if refused else own[0] if steady else replace(own[0], refused=None, share=0.0))
    return tuple(out)
