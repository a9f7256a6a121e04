"""Mechanisms around the contact: clearance, tilting bolts, slot ends, springs, levers, mass, load cell."""

from collections.abc import Sequence

import numpy as np
from numba import njit

from shj_validation.proof.device import Device
from shj_validation.proof.simulators.rig import Acts, Drive
from shj_validation.proof.simulators.simulator import Shape, Simulator

LOST = 0.35  # share of the Hertz force that comes back when the bolt leaves the slot end


def _clearance(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Put a gap in series with the contact: no force until it has closed."""
    return [Acts(clearance_mm=size) for _ in drives]


def _tilt(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Hang a second contact on bolts that lean over within their holes, then bend as beams."""
    act = Acts(second_share=size, bolt_kN_mm=shape["bolt_kN_mm"], bolt_clearance_mm=shape["clearance_mm"])
    return [act for _ in drives]


def _slot_end(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Press the bolt against the slot end (Hertz), with loss: less comes back than went in."""
    out = []
    for drive in drives:
        total = np.zeros(drive.x.size)
        for end, share in ((1.0, (1 + shape["side"]) / 2), (-1.0, (1 - shape["side"]) / 2)):
            deep = np.maximum(end * drive.x - shape["contact"] * drive.stroke_mm, 0.0)
            reach = drive.stroke_mm * (1 - shape["contact"])
            out_going = drive.sense * end > 0
            total += end * share * (deep / reach) ** 1.5 * np.where(out_going, 1.0, LOST)
        out.append(Acts(added_kN=2.0 / (1.0 + abs(shape["side"])) * size * device.Fy * total))
    return out


def _column(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Bend a column beside the friction: stiffer as it goes."""
    out = []
    for drive in drives:
        y, s = drive.x / drive.stroke_mm, shape["stiffening"]
        # Shortening of its span puts a column into tension: stiffness 1/(1 - s y^2), without bound as s y^2 nears 1.
        out.append(Acts(added_kN=size * device.Fy * y * (1 - s) / (1 - s * y**2)))
    return out


def _lever(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Tighten a lever by friction in one direction and loosen it in the other: F = mu (N + l F)."""
    return [Acts(lever=size) for _ in drives]


def _mass(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Move a mass between device and load cell by Newton's law."""
    return [Acts(mass_t=size / 1000.0, spring_kN_mm=600.0) for _ in drives]


def _stick_slip(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Drive a mass by a soft spring, friction weakening with slip speed."""
    spring = 1.2 * device.K
    mass = spring / (2 * np.pi * shape["natural_Hz"]) ** 2 * 1000.0
    return [Acts(mass_t=mass, spring_kN_mm=spring, weakening=size, weakening_mm_s=shape["fades_mm_s"]) for _ in drives]


def _filter(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Put an anti-alias filter into the force channel only, and multiplexing before it."""
    return [Acts(delay_s=size * (1 - shape["filtered"]), filter_s=size * shape["filtered"]) for _ in drives]


def _offset(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Leave the load cell as it was found, not zeroed."""
    return [Acts(sensor_kN=size * device.Fy) for _ in drives]


def _warm_up(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Warm an amplifier up through all runs, slower and slower; ``size`` is per run of the test."""
    out, clock = [], 0.0
    tau = shape["warms_in_tests"] * drives[0].test_s
    for drive in drives:
        time = clock + drive.course.time_s
        out.append(Acts(sensor_kN=-size * device.Fy * np.expm1(-time / tau) * tau / drives[0].test_s))
        clock = float(time[-1])
    return out


def _pure_delay(size: float, shape: Shape, device: Device) -> dict[str, float]:
    """Give the catalogue's delay; a filter also rounds corners, and has no exact counterpart there."""
    return {} if shape["filtered"] else {"size": size}


@njit(cache=True, error_model="numpy")
def two_poles(force, dt, tau):  # type: ignore[no-untyped-def]
    """Critically damped two-pole filter whose delay at low frequency is `tau`; exact where the force is straight."""
    out = np.empty(force.size)
    pole = 0.5 * tau
    keep = np.exp(-dt / pole)
    a, b, last, earlier = force[0], force[0], force[0], force[0]
    for i in range(force.size):
        behind = (force[i] - last) / dt * pole
        a = force[i] - behind + (a - last + behind) * keep
        behind = (a - earlier) / dt * pole
        b = a - behind + (b - earlier + behind) * keep
        last, earlier = force[i], a
        out[i] = b
    return out


SIMULATORS = (
    Simulator(
        "slack",
        "slack",
        (("motion", "slack"),),
        "mm",
        (0.05, 2.5),
        _clearance,
        "gap element in series with the contact",
        truth=lambda size, shape, device: {"size": size},
    ),
    Simulator(
        "two_stage",
        "two_stage",
        (("motion", "second surface"),),
        "share",
        (0.03, 0.5),
        _tilt,
        "two contacts, bolt with hole clearance and bending stiffness",
        draw=lambda rng: {"clearance_mm": float(rng.uniform(1.0, 4.0)), "bolt_kN_mm": float(rng.uniform(15.0, 80.0))},
        truth=lambda size, shape, device: {"size": size, "delay": shape["clearance_mm"]},
        base=("Fy", "gamma", "ratio"),
        rules=("continuous",),
    ),
    Simulator(
        "end_bearing",
        "end_bearing",
        (("added", "position"),),
        "share at full stroke",
        (0.01, 0.5),
        _slot_end,
        "lossy Hertz contact",
        draw=lambda rng: {"contact": float(rng.uniform(0.75, 0.93)), "side": float(rng.uniform(-1.0, 1.0))},
    ),
    Simulator(
        "restoring",
        "restoring",
        (("added", "position"),),
        "share",
        (0.005, 0.15),
        _column,
        "column that stiffens as it bends",
        draw=lambda rng: {"stiffening": float(rng.uniform(0.0, 0.3))},
        signed=True,
    ),
    Simulator(
        "asymmetry",
        "asymmetry",
        (("capacity", "direction"),),
        "share",
        (0.005, 0.15),
        _lever,
        "self-tightening lever",
        signed=True,
        truth=lambda size, shape, device: {"size": size},
        base=("K", "beta", "gamma", "ratio"),
    ),
    Simulator(
        "inertia",
        "inertia",
        (("added", "acceleration"),),
        "kg",
        (200.0, 20000.0),
        _mass,
        "Newton's law for a mass on a stiff spring",
        truth=lambda size, shape, device: {"size": size},
        fast=True,
        rules=("continuous",),
        protocols=("improved",),
    ),
    Simulator(
        "stick_slip",
        "stick_slip",
        (("motion", "stick-slip"), ("capacity", "speed"), ("noise", "speed")),
        "share",
        (0.03, 0.3),
        _stick_slip,
        "mass on a soft spring, friction weakening with slip speed",
        draw=lambda rng: {"natural_Hz": float(rng.uniform(3.0, 8.0)), "fades_mm_s": float(rng.uniform(3.0, 12.0))},
        base=("ratio",),
        fast=True,
        rules=("continuous",),
        # Friction that falls with speed is its cause, and all that is left where the teeth are too fast to sample.
        holds=("stribeck",),
    ),
    Simulator(
        "sensor_lag",
        "sensor_lag",
        (("motion", "delay"),),
        "s",
        (0.01, 0.3),
        _filter,
        "two-pole filter and multiplexing delay in the force channel",
        draw=lambda rng: {"filtered": float(rng.choice([0.0, rng.uniform(0.2, 0.8)]))},
        truth=_pure_delay,
    ),
    Simulator(
        "load_offset",
        "load_offset",
        (("added", "constant"),),
        "share",
        (0.005, 0.15),
        _offset,
        "load cell that was not zeroed",
        truth=lambda size, shape, device: {"size": size},
        signed=True,
    ),
    Simulator(
        "drift",
        "drift",
        (("added", "time"),),
        "share per run",
        (0.005, 0.15),
        _warm_up,
        "amplifier that warms up",
        draw=lambda rng: {"warms_in_tests": float(np.exp(rng.uniform(np.log(1.0), np.log(20.0))))},
        signed=True,
    ),
)
