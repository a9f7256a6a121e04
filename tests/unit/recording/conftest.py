"""A clean friction loop to break on purpose, and the public recordings where they exist."""

from pathlib import Path

import numpy as np
import pytest

from shj_bayes.recording.motion import Block, Motion, exact_motion, table_1
from shj_bayes.recording.recording import Recording


def friction_force(motion: Motion, stiffness: float = 18.0, capacity: float = 80.0) -> np.ndarray:
    """Force that unloads from the plateau and rounds into the opposite one."""
    slip = np.abs(motion.displacement_mm - motion.turning_mm[motion.half_cycle])
    loaded = motion.half_cycle > 0
    rise = np.where(loaded, 2.0, 1.0) * (1.0 - np.exp(-stiffness * slip / capacity))
    return motion.direction[motion.half_cycle] * capacity * (rise - loaded)


class Clean:
    """Table 1 at 20 Hz with 0.02 mm and 0.5 kN noise, as plain arrays."""

    def __init__(self) -> None:
        rng = np.random.default_rng(7)
        self.time, self.motion = exact_motion(table_1(), 20.0)
        self.displacement = self.motion.displacement_mm + 0.02 * rng.standard_normal(self.time.size)
        self.force = friction_force(self.motion) + 0.5 * rng.standard_normal(self.time.size)


@pytest.fixture(scope="session")
def clean() -> Clean:
    """Arrays of a clean recording; tests copy before they change."""
    return Clean()


@pytest.fixture(scope="session")
def small() -> Recording:
    """Two blocks, 700 samples: enough to write to files."""
    time, motion = exact_motion((Block(6.0, 0.25, 3), Block(24.0, 0.1, 3)), 20.0)
    rng = np.random.default_rng(3)
    x = motion.displacement_mm + 0.02 * rng.standard_normal(time.size)
    return Recording(time, x, friction_force(motion) + 0.5 * rng.standard_normal(time.size))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder of the public recordings; they are not part of the project."""
    folder = Path(__file__).resolve().parents[3].parent / "shared" / "recordings"
    if not folder.is_dir():
        pytest.skip("the public recordings (../shared/recordings) are not on this machine")
    return folder
