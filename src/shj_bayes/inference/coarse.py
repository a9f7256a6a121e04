"""A first idea of the law: a grid and least squares on a few thousand samples."""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.optimize import least_squares

from shj_bayes.errors import InferenceError
from shj_bayes.inference.problem import Problem
from shj_bayes.model.law import force_of_laws
from shj_bayes.model.parameters import NOISE_PARAMETERS, FloatArray
from shj_bayes.recording.motion import Motion

N_SAMPLES = 2000  # of each run; the law needs few, as its half-cycles and turning points are those of the whole run
CHUNK = 16  # parameter sets evaluated in one call
STEP = 1e-5


class Coarse:
    """A problem seen through some of its samples."""

    def __init__(self, problem: Problem) -> None:
        """Choose the samples: evenly, and the first one of each half-cycle."""
        self.problem = problem
        self.names = problem.layout.names
        noise = NOISE_PARAMETERS[problem.layout.noise]
        self.law = [i for i, name in enumerate(self.names) if name not in noise]
        self.parts = []
        for run in problem.runs:
            motion = run.motion
            n = motion.displacement_mm.size
            even = np.arange(0, n, max(1, n // N_SAMPLES))
            index = np.unique(np.concatenate([motion.start[:-1], even]))
            thin = Motion(
                motion.displacement_mm[index],
                motion.speed_mm_s[index],
                np.searchsorted(index, motion.start),
                motion.turning_mm,
                motion.direction,
            )
            used = (run.stretches.kind[index] > 0).astype(np.float64)
            self.parts.append((thin, run.recording.force_kN[index], used, run.start_force_kN))

    def residuals(self, theta: FloatArray) -> FloatArray:
        """Measured minus modelled force at the samples that count, 0 elsewhere, shape (m, n), kN."""
        rows = []
        for number, (motion, force, used, start_force) in enumerate(self.parts, start=1):
            laws = self.problem.layout.laws(theta, number)
            modelled = force_of_laws(motion, laws, variant=self.problem.variant, start_force_kN=start_force)
            rows.append((force - modelled) * used)
        return np.concatenate(rows, axis=1)

    def best_laws(self, n: int, *, descend: bool = True) -> list[FloatArray]:
        """Take the n best laws of the grid, to where the squares are least; the noise parameters are left as they are.

        Raises
        ------
        InferenceError
            If there is no force or no motion.
        """
        grid = self._grid()
        chunks = [grid[i : i + CHUNK] for i in range(0, len(grid), CHUNK)]
        scores = np.concatenate([np.sum(self.residuals(theta) ** 2, axis=1) for theta in chunks])
        best = [grid[i] for i in np.argsort(scores, kind="stable")[:n]]
        return [self._descend(theta) for theta in best] if descend else best

    def _grid(self) -> FloatArray:
        """List laws on a coarse grid, shape (n, d)."""
        run = self.problem.runs[0]
        peak = [float(np.percentile(np.abs(r.recording.force_kN), 97)) for r in self.problem.runs]
        stroke = float(np.ptp(run.motion.displacement_mm))
        speed = float(np.percentile(run.motion.speed_mm_s, 95))
        if not (peak[0] > 0 and stroke > 0 and speed > 0):
            raise InferenceError(
                f"nothing to fit: largest force {peak[0]:.3g} kN, stroke {stroke:.3g} mm, speed "
                f"{speed:.3g} mm/s; all must be above 0"
            )
        fixed = {name: peak[run_of(name) - 1] / peak[0] for name in self.names if name.startswith("ratio")}
        rows = []
        for share, knee, beta, effect in product(
            (0.5, 0.7, 0.85, 1.0), (3, 8, 20, 60, 200), (3.0, 12.0, 80.0), (-0.2, 0.0, 0.25)
        ):
            values = {"K": knee * peak[0] / stroke, "Fy": share * peak[0], "beta": beta, "gamma": effect / speed}
            values |= {"sigma": 1.0, "phi": 0.0, "nu": 10.0} | fixed
            rows.append([values.get(name, values.get(name.partition("_")[0], 0.0)) for name in self.names])
        return np.array(rows)

    def _descend(self, theta: FloatArray) -> FloatArray:
        """Least squares in the unbounded parameters of the law, held by their priors."""
        free = np.clip(self.problem.free(theta[None])[0], -8.0, 8.0)
        scale = max(float(np.std(self.residuals(theta[None]))), 1e-9)

        def natural(z: FloatArray) -> FloatArray:
            """Parameter sets, shape (m, d), for rows of the law's unbounded ones."""
            rows = np.tile(free, (z.shape[0], 1))
            rows[:, self.law] = np.clip(z, -12.0, 12.0)
            return self.problem.natural(rows)

        def misfit(z: FloatArray) -> FloatArray:
            return np.concatenate([self.residuals(natural(z[None]))[0] / scale, z])

        def slope(z: FloatArray) -> FloatArray:
            moved = self.residuals(natural(z + STEP * np.vstack([np.eye(z.size), -np.eye(z.size)]))) / scale
            return np.vstack([(moved[: z.size] - moved[z.size :]).T / (2 * STEP), np.eye(z.size)])

        with np.errstate(over="ignore", invalid="ignore"):
            if not np.isfinite(misfit(free[self.law])).all():
                return theta
            found = least_squares(misfit, free[self.law], jac=slope, method="lm", ftol=1e-6, xtol=1e-6, max_nfev=40)
        return np.asarray(natural(found.x[None])[0] if np.isfinite(found.cost) else theta)


def run_of(name: str) -> int:
    """Run number that a per-run parameter belongs to."""
    return 2 if name == "ratio" else int(name.partition("_")[2] or 1)
