"""Recordings from stated parameters: the law, then noise on force and on displacement."""

import math
from dataclasses import asdict, dataclass

import numpy as np

from shj_bayes.errors import ModelError
from shj_bayes.model.filter import simulate
from shj_bayes.model.law import force
from shj_bayes.model.noise import noise_model
from shj_bayes.recording.motion import Block, exact_motion, table_1
from shj_bayes.recording.recording import Finding, Recording, Source


@dataclass(frozen=True)
class Truth:
    """Parameters of a simulated device."""

    K: float = 18.0  # stiffness, kN/mm
    Fy: float = 80.0  # sliding force of the first run, kN
    beta: float = 10.0  # sharpness
    gamma: float = 0.0  # speed coefficient, s/mm
    ratio: float = 0.875  # sliding force of the second run / first
    sigma: float = 1.0  # force noise scale, kN
    phi: float = 0.8  # lag-one correlation of the force noise at the sampling rate
    # sigma_slow, tau_slow: slow noise on top of that of sigma and phi, kN, and its correlation time, s
    sigma_slow: float = 0.0
    tau_slow: float = 3.0
    displacement_noise_mm: float = 0.02  # standard deviation of independent displacement noise, mm

    def __post_init__(self) -> None:
        """Refuse values outside what the law and the noise allow."""
        for name, value in asdict(self).items():
            if not math.isfinite(value):
                raise ModelError(f"{name} = {value}: it must be a finite number")
        for name in ("K", "Fy", "ratio", "tau_slow"):
            if getattr(self, name) <= 0:
                raise ModelError(f"{name} = {getattr(self, name):g}: allowed is above 0")
        for name, unit in (("sigma", "kN"), ("sigma_slow", "kN"), ("displacement_noise_mm", "mm")):
            if getattr(self, name) < 0:
                raise ModelError(f"{name} = {getattr(self, name):g} {unit}: a noise scale must be 0 or more")
        if not -1 < self.phi < 1:
            raise ModelError(f"phi = {self.phi:g}: allowed is above -1 and below 1")


def simulate_device(
    truth: Truth,
    *,
    seed: int,
    rate_Hz: float = 20.0,
    n_runs: int = 2,
    blocks: tuple[Block, ...] | None = None,
    variant: str = "published",
) -> tuple[Recording, ...]:
    """Simulate 1 to 9 consecutive runs of one device; same seed, same recordings.

    Each run after the first slides at `ratio` times the force of the run before it. The displacement is that of the
    `blocks`, by default Table 1; `variant` is the reversal rule.
    """
    if not 1 <= n_runs <= 9:
        raise ModelError(f"{n_runs} runs asked for; simulate makes 1 to 9")
    if seed < 0:
        raise ModelError(f"seed = {seed}: allowed is 0 or more")
    time, motion = exact_motion(blocks or table_1(), rate_Hz)
    restarts = np.arange(time.size) == 0
    recordings = []
    for run, stream in enumerate(np.random.SeedSequence(seed).spawn(n_runs), start=1):
        rng = np.random.default_rng(stream)
        capacity = truth.Fy * truth.ratio ** (run - 1)
        force_kN = force(motion, K=truth.K, Fy=capacity, beta=truth.beta, gamma=truth.gamma, variant=variant)
        if truth.sigma:
            values = {"sigma": truth.sigma, "phi": truth.phi}
            force_kN = force_kN + simulate(noise_model("ar1"), values, time, restarts, rng)
        wobble = truth.displacement_noise_mm * rng.standard_normal(time.size)
        if truth.sigma_slow:
            slow = {"sigma_white": 0.0, "sigma_slow": truth.sigma_slow, "tau_slow": truth.tau_slow}
            force_kN = force_kN + simulate(noise_model("slow"), slow, time, restarts, rng)
        finding = Finding("simulated", "note", f"Simulated with seed {seed}; not a measurement.")
        recordings.append(
            Recording(
                time,
                motion.displacement_mm + wobble,
                force_kN,
                source=Source(f"simulated-run{run}", units={"time": "s", "displacement": "mm", "force": "kN"}),
                findings=(finding,),
            )
        )
    return tuple(recordings)
