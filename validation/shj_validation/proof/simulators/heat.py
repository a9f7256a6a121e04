"""Heat through the plates: the heat equation in the thickness of shim and plate, friction falling with temperature."""

from collections.abc import Sequence

import numpy as np
from numba import njit

from shj_validation.proof.device import Device
from shj_validation.proof.simulators.rig import Acts, Drive
from shj_validation.proof.simulators.simulator import Shape, Simulator

DIFFUSIVITY = 14.0  # of steel, mm^2/s
CELLS = 24


def _thermal(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Heat one face by friction and let the other give it off; each run starts cold.

    ``size`` is the share of friction lost at the hottest moment of the first run.
    """
    out, per_kelvin = [], 0.0
    for drive in drives:
        power = np.abs(drive.slip_mm_s) * drive.capacity_kN / device.Fy
        warmth = _faces(power, drive.dt, shape["thickness_mm"], DIFFUSIVITY, shape["biot"])
        if not per_kelvin:
            per_kelvin = size / max(float(warmth.max()), 1e-12)
        # Hot plates make less heat: one correction with the friction of the first pass.
        cooler = _faces(
            power * (1.0 - per_kelvin * warmth), drive.dt, shape["thickness_mm"], DIFFUSIVITY, shape["biot"]
        )
        out.append(Acts(clamping=1.0 - per_kelvin * cooler))
    return out


@njit(cache=True, error_model="numpy")
def _faces(power, dt, thickness, diffusivity, biot):  # type: ignore[no-untyped-def]
    """Temperature of the rubbed face, arbitrary unit: finite volumes, explicit with as many sub-steps as are stable."""
    n = CELLS
    width = thickness / n
    t = np.zeros(n)
    flow = np.zeros(n + 1)
    out = np.empty(power.size)
    sub = int(np.ceil(dt * diffusivity / (0.4 * width * width)))
    h = dt / sub
    for i in range(power.size):
        for _ in range(sub):
            flow[0] = power[i]
            for j in range(1, n):
                flow[j] = diffusivity * (t[j - 1] - t[j]) / width
            flow[n] = biot * diffusivity / thickness * t[n - 1]
            for j in range(n):
                t[j] += h * (flow[j] - flow[j + 1]) / width
        out[i] = t[0]
    return out


SIMULATORS = (
    Simulator(
        "thermal",
        "thermal",
        (("capacity", "heat"),),
        "share",
        (0.005, 0.25),
        _thermal,
        "heat equation through the plate, heat from friction",
        draw=lambda rng: {
            "thickness_mm": float(rng.uniform(6.0, 30.0)),
            "biot": float(np.exp(rng.uniform(np.log(0.05), np.log(2.0)))),
        },
    ),
)
