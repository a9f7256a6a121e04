"""A fit in a process of its own, slowed down so that a test can kill it: ``worker.py CHECKPOINT SEED DELAY_S``."""

import runpy
import sys
import time
from pathlib import Path

import numpy as np

from shj_bayes.inference.sampler import SamplingPlan, run_ensembles
from shj_bayes.inference.start import find_start

PLAN = {"round_steps": 12, "max_steps": 60}


def main(path: Path, seed: int, delay_s: float) -> None:
    """Sample the small device of conftest.py, resting before each evaluation."""
    small = runpy.run_path(str(Path(__file__).resolve().parents[1] / "conftest.py"))["small_posterior"]()
    posterior, start = find_start(small)

    class Slow:
        """The same density, later."""

        def log_posterior_free(self, z: np.ndarray) -> np.ndarray:
            """Rest, then evaluate."""
            time.sleep(delay_s)
            return posterior.log_posterior_free(z)

    names, identity = posterior.model.names, posterior.fingerprint
    run_ensembles(Slow(), names, start, SamplingPlan(seed=seed, **PLAN), fingerprint=identity, path=path)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]))
