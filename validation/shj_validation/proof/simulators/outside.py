"""Physics that the catalogue does not hold; the right answer is that it is unknown, and where it shows."""

from collections.abc import Sequence

import numpy as np

from shj_validation.proof.device import Device
from shj_validation.proof.simulators.rig import Acts, Drive
from shj_validation.proof.simulators.simulator import Shape, Simulator


def _thread(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Drive by a screw or rack: resistance rises and falls with position, with a second harmonic."""
    out = []
    for drive in drives:
        turn = 2 * np.pi * drive.x / shape["pitch_mm"] + shape["phase"]
        out.append(Acts(clamping=1.0 + size * (np.sin(turn) + 0.3 * np.sin(2 * turn + 1.0)) / 1.2))
    return out


def _spatter(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Climb over weld spatter and drop into pits at a few places."""
    out = []
    for drive in drives:
        bumps = np.zeros(drive.x.size)
        for key, sign in (("first", 1.0), ("second", -1.0), ("third", 1.0)):
            bumps += sign / np.cosh((drive.x - shape[key] * drive.stroke_mm) / shape["width_mm"]) ** 2
        out.append(Acts(clamping=1.0 + size * bumps))
    return out


def _pump(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Cut oil pressure in and out by the clock: a rounded saw in the force channel."""
    out, clock = [], 0.0
    for drive in drives:
        time = clock + drive.course.time_s
        turn = 2 * np.pi * time / shape["period_s"] + shape["phase"]
        out.append(Acts(sensor_kN=size * device.Fy * (np.sin(turn) + 0.4 * np.sin(2 * turn)) / 1.2))
        clock = float(time[-1])
    return out


def _patch(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Cross a patch of another finish: one level of friction on it, another off it, with short ramps."""
    out = []
    for drive in drives:
        edge = drive.x / drive.stroke_mm
        inside = 1 / (1 + np.exp(-(edge - shape["from"]) / 0.01)) - 1 / (1 + np.exp(-(edge - shape["to"]) / 0.01))
        out.append(Acts(clamping=1.0 + size * inside))
    return out


def _seam(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Slide across a seam between two plates: one level of friction on either side of a place."""
    out = []
    for drive in drives:
        beyond = 0.5 * (1.0 + np.tanh((drive.x - shape["place"] * drive.stroke_mm) / shape["pad_mm"]))
        out.append(Acts(clamping=1.0 + size * beyond))
    return out


def _guide(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Run along a wavy guide: a force of position that pushes one way on one slope and back on the other."""
    wave = [np.sin(2 * np.pi * drive.x / shape["pitch_mm"] + shape["phase"]) for drive in drives]
    return [Acts(added_kN=size * device.Fy * one) for one in wave]


SIMULATORS = (
    Simulator(
        "thread_ripple",
        None,
        (("capacity", "position"),),
        "share",
        (0.01, 0.15),
        _thread,
        "rise and fall with position, two harmonics",
        draw=lambda rng: {
            "pitch_mm": float(np.exp(rng.uniform(np.log(8.0), np.log(40.0)))),
            "phase": float(rng.uniform(0, 6.283)),
        },
    ),
    Simulator(
        "spatter",
        None,
        (("capacity", "position"),),
        "share",
        (0.01, 0.25),
        _spatter,
        "bumps and a pit along the slot",
        draw=lambda rng: {
            "first": float(rng.uniform(-0.8, -0.2)),
            "second": float(rng.uniform(-0.1, 0.4)),
            "third": float(rng.uniform(0.5, 0.9)),
            "width_mm": float(rng.uniform(3.0, 8.0)),
        },
    ),
    Simulator(
        "pump",
        None,
        (("added", "time"),),
        "share",
        (0.01, 0.12),
        _pump,
        "wave of the clock in the force channel",
        draw=lambda rng: {
            "period_s": float(np.exp(rng.uniform(np.log(12.0), np.log(90.0)))),
            "phase": float(rng.uniform(0, 6.283)),
        },
    ),
    Simulator(
        "patch",
        None,
        (("capacity", "position"),),
        "share",
        (0.01, 0.2),
        _patch,
        "a patch of other friction along the slot",
        draw=lambda rng: {"from": float(rng.uniform(-0.5, 0.0)), "to": float(rng.uniform(0.15, 0.6))},
        signed=True,
    ),
    Simulator(
        "seam",
        None,
        (("capacity", "position"),),
        "share",
        (0.01, 0.2),
        _seam,
        "capacity that steps at a place",
        draw=lambda rng: {"place": float(rng.uniform(-0.5, 0.5)), "pad_mm": float(rng.uniform(1.0, 6.0))},
        signed=True,
    ),
    Simulator(
        "wavy_guide",
        None,
        (("added", "position"),),
        "share",
        (0.01, 0.12),
        _guide,
        "force that swings with position",
        draw=lambda rng: {
            "pitch_mm": float(np.exp(rng.uniform(np.log(8.0), np.log(40.0)))),
            "phase": float(rng.uniform(0.0, 2 * np.pi)),
        },
    ),
)
