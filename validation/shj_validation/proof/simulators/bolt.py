"""Bolt tension: the bolt is a spring, and whatever makes the clamped plates thinner relaxes it."""

from collections.abc import Sequence

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_validation.proof.device import Device
from shj_validation.proof.simulators.rig import Acts, Drive
from shj_validation.proof.simulators.simulator import Shape, Simulator

STRETCH_UM = 290.0  # shortening of the stack that takes all tension from an M16 bolt: 95 kN at 330 kN/mm
TESTED_RUNS = 2
CONTACT_UM = 12.0  # approach of the rough faces under full tension; they follow the two-thirds power of Hertz


def tension(thinner_um: FloatArray) -> FloatArray:
    """Bolt tension as a share of the full one, when the stack has become thinner; Newton on the rough contact.

    The bolt shortens by ``thinner`` less what the faces spring back: N = 1 - (thinner + c (N^(2/3) - 1)) / stretch.
    """
    n = np.maximum(1.0 - thinner_um / STRETCH_UM, 1e-3)
    for _ in range(8):
        wrong = n - 1.0 + (thinner_um + CONTACT_UM * (n ** (2 / 3) - 1.0)) / STRETCH_UM
        n = np.maximum(n - wrong / (1.0 + 2 / 3 * CONTACT_UM / STRETCH_UM * n ** (-1 / 3)), 1e-3)
    return n


def thinning(loss: float) -> float:
    """Find the thinning (micrometres) that takes a share from the tension."""
    n = 1.0 - loss
    return float(STRETCH_UM * loss + CONTACT_UM * (1.0 - n ** (2 / 3)))


def _wear(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Wear the shim wherever it goes: dh/ds = k N (Archard), and the tension follows the thickness."""
    out, worn = [], 0.0
    per_mm = thinning(size) / 1000.0
    for drive in drives:
        n, worn = _archard(drive.slip_mm_s * drive.dt, per_mm, worn, STRETCH_UM, CONTACT_UM)
        out.append(Acts(clamping=n))
    return out


@njit(cache=True, error_model="numpy")
def _archard(slid, per_mm, worn, stretch, contact):  # type: ignore[no-untyped-def]
    out = np.empty(slid.size)
    n = max(1.0 - worn / (stretch - contact), 1e-3)
    for i in range(slid.size):
        worn += per_mm * n * slid[i]
        for _ in range(3):
            wrong = n - 1.0 + (worn + contact * (n ** (2 / 3) - 1.0)) / stretch
            n = max(n - wrong / (1.0 + 2 / 3 * contact / stretch * n ** (-1 / 3)), 1e-3)
        out[i] = n
    return out, worn


def _track(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Slide over a track worn by earlier tests, deepest at mid-stroke; the pad under the bolts averages over it."""
    stroke = drives[0].stroke_mm
    place = np.linspace(-1.6 * stroke, 1.6 * stroke, 1601)
    depth = 1.0 / (1.0 + np.abs(place / (shape["half_width"] * stroke)) ** 3)
    half_pad = shape["pad_mm"] / 2
    pad = np.exp(-0.5 * (np.arange(-200, 201) * (place[1] - place[0]) / half_pad) ** 2)
    felt = np.convolve(depth, pad / pad.sum(), mode="same")
    felt *= thinning(size) / felt.max()
    return [Acts(clamping=tension(np.interp(d.x, place, felt))) for d in drives]


def _local(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Wear fresh coating where it is rubbed: a depth on a grid along the slot, deepest where most passes went."""
    stroke = drives[0].stroke_mm
    place = np.linspace(-1.3 * stroke, 1.3 * stroke, 521)
    depth = np.zeros(place.size)
    pad = np.exp(-0.5 * ((place[:, None] - place[None, :]) / (shape["pad_mm"] / 2)) ** 2)
    pad /= pad.sum(axis=1, keepdims=True)
    out = []
    # 40 passes over a place, as mid-stroke sees in a run, wear it to the drawn loss.
    per_mm = thinning(size) / 40.0
    for drive in drives:
        n = np.empty(drive.x.size)
        chunk = max(1, int(0.5 / drive.dt))
        for a in range(0, drive.x.size, chunk):
            x = drive.x[a : a + chunk]
            row = np.clip(np.searchsorted(place, x), 0, place.size - 1)
            felt = pad @ depth
            n[a : a + chunk] = tension(np.interp(x, place, felt))
            weight = np.bincount(row, weights=drive.slip_mm_s[a : a + chunk] * drive.dt, minlength=place.size)
            depth += per_mm * (pad.T @ weight) / (place[1] - place[0]) * n[a]
        out.append(Acts(clamping=n))
    return out


def _slip_of_nut(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Let one of two bolts slip in its nut at one moment and settle within seconds."""
    moment = shape["moment"] * TESTED_RUNS * drives[0].test_s
    out, clock = [], 0.0
    for drive in drives:
        time = clock + drive.course.time_s
        lost = thinning(abs(size)) * -np.expm1(-np.maximum(time - moment, 0.0) / shape["settles_s"])
        n = tension(lost)
        out.append(Acts(clamping=n if size < 0 else 2.0 - n))
        clock += float(drive.course.time_s[-1])
    return out


def _rocking(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Rock the clamped plate on a rounded edge as the bolts leave mid-slot: the stack under them gets thinner."""
    stroke = drives[0].stroke_mm
    radius = shape["edge"] * stroke
    lift = np.hypot(stroke, radius) - radius
    return [Acts(clamping=tension(thinning(size) * (np.hypot(d.x, radius) - radius) / lift)) for d in drives]


def _wedge(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Clamp plates that are not parallel: the stack thickens towards one end."""
    return [Acts(clamping=tension(-abs(thinning(abs(size))) * np.sign(size) * d.x / d.stroke_mm)) for d in drives]


SIMULATORS = (
    Simulator(
        "wear",
        "wear",
        (("capacity", "travel"),),
        "share per m",
        (0.001, 0.06),
        _wear,
        "Archard wear of the shim, elastic bolt, rough contact",
    ),
    Simulator(
        "centre_wear",
        "centre_wear",
        (("capacity", "distance"),),
        "share",
        (0.005, 0.2),
        _track,
        "worn track on a grid, averaged by the pad, elastic bolt",
        draw=lambda rng: {"half_width": float(rng.uniform(0.15, 0.5)), "pad_mm": float(rng.uniform(15.0, 40.0))},
    ),
    Simulator(
        "local_wear",
        "local_wear",
        (("capacity", "passes"),),
        "share",
        (0.02, 0.4),
        _local,
        "wear depth on a grid along the slot, elastic bolt",
        draw=lambda rng: {"pad_mm": float(rng.uniform(15.0, 40.0))},
        holds=("wear",),  # it is wear; only the place is more than that name says
    ),
    Simulator(
        "tension_step",
        "tension_step",
        (("capacity", "time"),),
        "share",
        (0.005, 0.2),
        _slip_of_nut,
        "one bolt slips and settles, elastic bolt",
        draw=lambda rng: {"moment": float(rng.uniform(0.15, 0.85)), "settles_s": float(rng.uniform(0.5, 5.0))},
        # A loss from a moment on, and a gain up to it with a lower Fy (or ratio), are one thing: no unique truth.
        base=("K", "beta", "gamma"),
        signed=True,
    ),
    Simulator(
        "prying",
        "prying",
        (("capacity", "distance"),),
        "share",
        (0.005, 0.25),
        _rocking,
        "plate rocking on a rounded edge, elastic bolt, rough contact",
        draw=lambda rng: {"edge": float(np.exp(rng.uniform(np.log(0.1), np.log(2.0))))},
        truth=lambda size, shape, device: {"size": size},
    ),
    Simulator(
        "taper",
        "taper",
        (("capacity", "position"),),
        "share",
        (0.005, 0.15),
        _wedge,
        "wedge-shaped stack, elastic bolt, rough contact",
        signed=True,
        truth=lambda size, shape, device: {"size": size},
    ),
)
