"""The displacement regime of the paper's Table 1, sampled exactly."""

from dataclasses import dataclass

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.motion import Motion, alternating
from shj_bayes.recording.recording import FloatArray


@dataclass(frozen=True)
class Block:
    """Consecutive sine cycles of one amplitude and frequency."""

    amplitude_mm: float  # half of the peak-to-peak stroke, mm
    frequency_Hz: float  # frequency, Hz
    n_cycles: int  # full cycles, at least one

    def __post_init__(self) -> None:
        """Refuse blocks that hold no motion."""
        if not (self.amplitude_mm > 0 and self.frequency_Hz > 0 and self.n_cycles >= 1):
            raise RecordingError(f"a block needs amplitude, frequency and cycles above zero; got {self}")

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return self.n_cycles / self.frequency_Hz


def table_1(last_block_cycles: int = 5) -> tuple[Block, ...]:
    """Blocks of the paper's Table 1.

    It prints 6 cycles for the last block, the text says 5 and a total of 20; 5 is the default.
    """
    if last_block_cycles not in (5, 6):
        raise RecordingError(
            f"the last block of Table 1 has 5 cycles (text) or 6 (table), not {last_block_cycles}; choose 5 or 6"
        )
    amplitudes = (6.0, 12.0, 24.0, 48.0, 72.0, 95.0)
    frequencies = (0.27, 0.13, 0.067, 0.034, 0.022, 0.017)
    cycles = (3, 3, 3, 3, 3, last_block_cycles)
    return tuple(Block(a, f, n) for a, f, n in zip(amplitudes, frequencies, cycles, strict=True))


def exact_motion(blocks: tuple[Block, ...], rate_Hz: float) -> tuple[FloatArray, Motion]:
    """Sample sine blocks, one after the other, with exact turning points and speed: times, s, and the motion.

    Each block starts and ends at zero displacement going up; the rate gives 8 samples in the shortest cycle at least.
    """
    fastest = max(block.frequency_Hz for block in blocks)
    if not 8 * fastest <= rate_Hz <= 1e5:
        raise RecordingError(
            f"rate {rate_Hz} Hz: allowed is {8 * fastest:.3g} Hz (8 samples in the shortest cycle) to 100000 Hz"
        )
    begin = np.concatenate([[0.0], np.cumsum([block.duration_s for block in blocks])])
    time = np.arange(int(np.floor(begin[-1] * rate_Hz)) + 1) / rate_Hz
    index = np.clip(np.searchsorted(begin, time, side="right") - 1, 0, len(blocks) - 1)
    amplitude = np.array([block.amplitude_mm for block in blocks])[index]
    omega = 2 * np.pi * np.array([block.frequency_Hz for block in blocks])[index]
    phase = omega * (time - begin[index])

    turn_time, turn_mm = [], []
    for t0, block in zip(begin, blocks, strict=False):
        quarters = np.arange(1, 4 * block.n_cycles, 2)
        turn_time.append(t0 + quarters / (4 * block.frequency_Hz))
        turn_mm.append(block.amplitude_mm * alternating(quarters.size))
    turning = np.concatenate(turn_mm)
    start = np.concatenate([[0], np.searchsorted(time, np.concatenate(turn_time), side="left"), [time.size]])
    motion = Motion(
        displacement_mm=amplitude * np.sin(phase),
        speed_mm_s=np.abs(amplitude * omega * np.cos(phase)),
        start=start,
        turning_mm=np.concatenate([[0.0], turning]),
        direction=alternating(turning.size + 1),
    )
    return time, motion
