"""What is drawn for a trial besides its effects: the device, and the nuisances that every real test has."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Device:
    """A friction connection, in the words of Eq. (1) and (2).

    Parameters
    ----------
    K : float
        Stiffness between the gauge points, grip included, kN/mm.
    Fy : float
        Sliding force of the first run, kN.
    beta : float
        Sharpness of the knee.
    gamma : float
        Speed coefficient, s/mm.
    ratio : float
        Sliding force of the second run / first.
    """

    K: float
    Fy: float
    beta: float
    gamma: float
    ratio: float


@dataclass(frozen=True)
class Nuisance:
    """Imperfections that are always on, each below the practical size of 1 % of Fy.

    Parameters
    ----------
    frame_kN_mm : float
        Stiffness of the loading frame in series, kN/mm.
    lag_s : float
        Force channel behind the displacement channel, s.
    offset_kN : float
        Constant of the load cell, kN.
    force_step_kN, displacement_step_mm : float
        Resolution of the two channels.
    noise : str
        Kind of force noise, see `shj_validation.proof.noise`.
    noise_kN : float
        Its standard deviation, kN.
    displacement_noise_mm : float
        Standard deviation of the displacement noise, mm.
    noise_memory_s : float
        Memory of the slow part of the force noise, s, for the kind that has one to be drawn.
    """

    frame_kN_mm: float
    lag_s: float
    offset_kN: float
    force_step_kN: float
    displacement_step_mm: float
    noise: str
    noise_kN: float
    displacement_noise_mm: float
    noise_memory_s: float = 0.0
