"""The friction coefficient as a state of the contact: ageing, memory, speed, coating, powder."""

from collections.abc import Sequence

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_validation.proof.device import Device
from shj_validation.proof.simulators.rig import Acts, Drive
from shj_validation.proof.simulators.simulator import Shape, Simulator, along

REFERENCE_MM_S = 10.0  # peak speed of the paper's protocol
CREEP_MM_S = 1e-4  # a contact at rest still creeps; keeps logarithms finite


@njit(cache=True, error_model="numpy")
def follow(goal, slid, length, start):  # type: ignore[no-untyped-def]
    """State that follows a goal over a slip length: dm/ds = (goal - m)/length, exact for a goal held over a step."""
    out = np.empty(goal.size)
    m = start
    for i in range(goal.size):
        m = goal[i] + (m - goal[i]) * np.exp(-slid[i] / length)
        out[i] = m
    return out


@njit(cache=True, error_model="numpy")
def _ageing(slip, dt, length, theta):  # type: ignore[no-untyped-def]
    """Dieterich's ageing law, theta' = 1 - v theta/D, exact for a slip speed held over a step."""
    out = np.empty(slip.size)
    for i in range(slip.size):
        rate = slip[i] / length
        keep = np.exp(-rate * dt)
        theta = theta * keep + ((1.0 - keep) / rate if rate > 1e-12 else dt)
        out[i] = theta
    return out


def _breakaway(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Integrate rate and state with a = b: contact time matters, speed does not once steady; ln(theta v/D)."""
    out, theta = [], shape["rest_s"]
    for drive in drives:
        age = _ageing(drive.slip_mm_s, drive.dt, shape["length_mm"], theta)
        theta = float(age[-1]) + shape["rest_s"]
        state = np.log(np.maximum(age * np.maximum(drive.slip_mm_s, CREEP_MM_S) / shape["length_mm"], 1e-3))
        # In units of the state of a contact that slips 0.5 mm/s fifty times its length after a rest.
        scale = np.log(50.0)
        out.append(Acts(clamping=np.maximum(1.0 + size * np.maximum(state, 0.0) / scale, 0.2)))
    return out


def _stribeck(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Bend LuGre bristles: more friction at low speed (Gaussian in speed), reached over a bristle's length.

    A contact that has come to rest sticks up to its static friction.
    """
    out = []
    for drive in drives:
        goal = 1.0 + size * np.exp(-((drive.speed / shape["fades_mm_s"]) ** 2))
        slid = drive.sliding_from(device, 1.0 + size) * drive.dt
        out.append(Acts(clamping=follow(goal, slid, shape["bristle_mm"], 1.0 + size)))
    return out


def _eyring(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Thermally activated sliding: asinh(v/v0), the regular form of the logarithm (Eyring; Rice)."""
    own = np.arcsinh(REFERENCE_MM_S / shape["creep_mm_s"])
    # The size is the largest departure from the straight line between standstill and 10 mm/s.
    grid = np.linspace(0.0, REFERENCE_MM_S, 2001)
    bend = np.max(np.arcsinh(grid / shape["creep_mm_s"]) / own - grid / REFERENCE_MM_S)
    out = []
    for drive in drives:
        out.append(Acts(clamping=1.0 + size / bend * (np.arcsinh(drive.speed / shape["creep_mm_s"]) / own - 1.0)))
    return out


@njit(cache=True, error_model="numpy")
def _film(goal, slid, builds, thins, start):  # type: ignore[no-untyped-def]
    """State that follows a goal over one slip length upwards and over another downwards."""
    out = np.empty(goal.size)
    m = start
    for i in range(goal.size):
        m = goal[i] + (m - goal[i]) * np.exp(-slid[i] / (builds if goal[i] > m else thins))
        out[i] = m
    return out


def _memory(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Let friction follow the speed with a delay in slip: a film that builds up and thins over different distances."""
    out, state = [], 0.0
    for drive in drives:
        lengths = (shape["length_mm"], shape["thins"] * shape["length_mm"])
        film = _film(drive.speed / REFERENCE_MM_S, drive.slip_mm_s * drive.dt, *lengths, state)
        state = float(film[-1])
        out.append(Acts(clamping=1.0 + size * (film - 0.6)))
    return out


def _coating(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Break a coating through: bare surface spreads from what is broken (logistic)."""
    out, bare = [], 0.05
    for drive in drives:
        b = _spread(drive.slip_mm_s * drive.dt, shape["length_mm"], bare)
        bare = float(b[-1])
        out.append(Acts(clamping=1.0 + size * (b - 0.05) / 0.95))
    return out


@njit(cache=True, error_model="numpy")
def _spread(slid, length, bare):  # type: ignore[no-untyped-def]
    out = np.empty(slid.size)
    for i in range(slid.size):
        middle = bare + 0.5 * slid[i] / length * (0.3 + bare) * (1.0 - bare)
        bare += slid[i] / length * (0.3 + middle) * (1.0 - middle)
        out[i] = bare
    return out


def _reach(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Sweep debris out by long strokes: friction follows the reach of the stroke over some slip."""
    out, state = [], None
    for drive in drives:
        reach = _last_reach(drive.x)
        goal = 1.0 + size * np.log2(np.maximum(reach / drive.stroke_mm, 0.02))
        state = float(goal[0]) if state is None else state
        m = follow(goal, drive.slip_mm_s * drive.dt, shape["length_mm"], state)
        state = float(m[-1])
        out.append(Acts(clamping=m))
    return out


def _last_reach(x: FloatArray) -> FloatArray:
    """Half of the distance between the last two turning points, or of the stroke that is under way if longer."""
    turn = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1
    places = np.concatenate([[0], turn, [x.size - 1]])
    values = x[places]
    legs = np.abs(np.diff(values)) / 2
    # The first quarter, and the rest before it, belong to the cycle after it, the last one to the cycle before it.
    moving = np.flatnonzero(legs)
    legs[: moving[0] + 1] = legs[moving[:2]].max()
    legs[moving[-1] :] = legs[moving[-2:]].max()
    return np.repeat(legs, np.diff(np.concatenate([places[:-1], [x.size]])))


def _powder(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Grow a powder film with travel that makes the friction depend on speed more and more."""
    travel = along(drives, [d.slip_mm_s for d in drives])
    return [Acts(speed_per_mm_s=size / REFERENCE_MM_S * (1.0 - 2.0 * np.exp(-s / 2000.0))) for s in travel]


SIMULATORS = (
    Simulator(
        "breakaway",
        "breakaway",
        (("capacity", "slip"), ("capacity", "rest")),
        "share",
        (0.005, 0.3),
        _breakaway,
        "rate and state friction with Dieterich's ageing law",
        draw=lambda rng: {
            "length_mm": float(np.exp(rng.uniform(np.log(0.3), np.log(4.0)))),
            "rest_s": float(np.exp(rng.uniform(np.log(60.0), np.log(3600.0)))),
        },
        base=("K", "beta", "gamma", "ratio"),
    ),
    Simulator(
        "stribeck",
        "stribeck",
        (("capacity", "speed"),),
        "share",
        (0.005, 0.3),
        _stribeck,
        "LuGre friction, bristle state over slip",
        draw=lambda rng: {"fades_mm_s": float(rng.uniform(1.0, 4.0)), "bristle_mm": float(rng.uniform(0.05, 0.5))},
        base=("K", "gamma", "ratio"),
    ),
    Simulator(
        "velocity_law",
        "velocity_law",
        (("capacity", "speed"),),
        "share",
        (0.005, 0.2),
        _eyring,
        "thermally activated sliding, asinh of speed",
        draw=lambda rng: {"creep_mm_s": float(np.exp(rng.uniform(np.log(0.02), np.log(0.6))))},
        base=("K", "ratio"),
        fast=True,  # at 0.01 s the force at a turning point is up to 6 % of Fy off
        signed=True,
    ),
    Simulator(
        "friction_memory",
        "friction_memory",
        (("capacity", "speed"), ("capacity", "acceleration")),
        "share",
        (0.01, 0.3),
        _memory,
        "film that builds up and thins over different slip lengths",
        draw=lambda rng: {
            "length_mm": float(np.exp(rng.uniform(np.log(4.0), np.log(25.0)))),
            "thins": float(rng.uniform(0.7, 1.4)),
        },
        base=("K", "ratio"),
        signed=True,
    ),
    Simulator(
        "bedding_in",
        "bedding_in",
        (("capacity", "travel"),),
        "share",
        (0.005, 0.3),
        _coating,
        "coated and bare surface, breakthrough spreads",
        draw=lambda rng: {"length_mm": float(np.exp(rng.uniform(np.log(100.0), np.log(1500.0))))},
    ),
    Simulator(
        "amplitude",
        "amplitude",
        (("capacity", "amplitude"),),
        "share per doubling",
        (0.003, 0.06),
        _reach,
        "debris swept out by long strokes",
        draw=lambda rng: {"length_mm": float(rng.uniform(1.0, 6.0))},
        signed=True,
        truth=lambda size, shape, device: {"size": size},
    ),
    Simulator(
        "powder",
        None,
        (("capacity", "speed"), ("capacity", "travel"), ("capacity", "speed_by_travel")),
        "share at 10 mm/s",
        (0.01, 0.25),
        _powder,
        "speed coefficient that changes with travel",
        base=("K", "beta"),
        signed=True,
    ),
)
