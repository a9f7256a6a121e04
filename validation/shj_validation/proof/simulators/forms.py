"""Further laws of physics that the catalogue holds in another form: same coordinate, another curve over it."""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from shj_bayes._util.arrays import FloatArray
from shj_validation.proof.device import Device
from shj_validation.proof.simulators.bolt import tension, thinning
from shj_validation.proof.simulators.friction import REFERENCE_MM_S, follow
from shj_validation.proof.simulators.rig import Acts, Drive
from shj_validation.proof.simulators.simulator import Shape, Simulator, along

TESTED_M = 7.0  # slid in two runs by a device of middle size; powers of travel are anchored there
LEAST = 0.3  # of the clamping that a wandering actuator leaves, and that a law of speed leaves at rest


def _over_travel(law: Callable[[FloatArray, float, Shape], FloatArray]) -> Callable[..., list[Acts]]:
    """Multiply the capacity by a law of the distance slid (m), size and shape."""

    def act(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
        travel = along(drives, [drive.slip_mm_s for drive in drives])
        return [Acts(clamping=law(slid / 1000.0, size, shape)) for slid in travel]

    return act


def _over_distance(law: Callable[[FloatArray, Shape], FloatArray]) -> Callable[..., list[Acts]]:
    """Thin the stack by a law of the distance from mid-stroke, a share of the stroke; `size` is lost where it is 1."""

    def act(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
        return [Acts(clamping=tension(thinning(size) * law(np.abs(d.x) / d.stroke_mm, shape))) for d in drives]

    return act


def _over_speed(law: Callable[[FloatArray, float, Shape], FloatArray]) -> Callable[..., list[Acts]]:
    """Multiply the capacity by a law of the speed (mm/s), reached over a tenth of a millimetre of slip.

    A contact that has come to rest sticks up to the capacity that it has there.
    """

    def act(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
        rest = max(float(law(np.zeros(1), size, shape)[0]), LEAST)
        slides = [d.sliding_from(device, rest) * d.dt for d in drives]
        return [
            Acts(clamping=follow(law(d.speed, size, shape), slid, 0.1, rest))
            for d, slid in zip(drives, slides, strict=True)
        ]

    return act


def _over_time(law: Callable[[FloatArray, float, Shape, float], FloatArray]) -> Callable[..., list[Acts]]:
    """Multiply the capacity by a law of the time since the first run began (s), size, shape and duration of a test."""

    def act(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
        out, clock = [], 0.0
        for drive in drives:
            out.append(Acts(clamping=law(clock + drive.course.time_s, size, shape, drive.test_s)))
            clock += float(drive.course.time_s[-1])
        return out

    return act


def _power_of_speed(speed: FloatArray, size: float, shape: Shape) -> FloatArray:
    """Shear a lubricant film: a power of speed; the size is the largest departure from a straight line to 10 mm/s."""
    power = shape["power"]
    steepest = power ** (1.0 / (1.0 - power))  # share of the reference speed at which the two are furthest apart
    bend = steepest**power - steepest
    return np.asarray(1.0 + size / bend * ((speed / REFERENCE_MM_S) ** power - 1.0))


def _wander(time: FloatArray, size: float, shape: Shape, test_s: float) -> FloatArray:
    """Let an actuator creep: a random walk, smooth between steps; the size is its standard deviation after one test."""
    pace = shape["pace_s"]
    n = int(4 * test_s / pace) + 4  # two runs and what follows them
    rng = np.random.default_rng(int(shape["seed"]))
    steps = rng.standard_normal(n) * size * np.sqrt(pace / test_s)
    return np.asarray(np.maximum(1.0 + CubicSpline(pace * np.arange(n), np.cumsum(steps) - steps[0])(time), LEAST))


def _torn(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Tear junctions of finite length anew behind every reversal: all hold at first, none beyond their length."""
    out = []
    for drive in drives:
        slid = np.cumsum(drive.slip_mm_s * drive.dt)
        turned = np.flatnonzero(np.diff(drive.sense, prepend=drive.sense[0]))
        last = np.maximum.accumulate(np.where(np.isin(np.arange(slid.size), turned), slid, 0.0))
        out.append(Acts(clamping=1.0 + size * np.maximum(1.0 - ((slid - last) / shape["length_mm"]) ** 2, 0.0)))
    return out


def _zeroed(drives: Sequence[Drive], size: float, shape: Shape, device: Device) -> list[Acts]:
    """Warm an amplifier up through each run; it is zeroed and cooled down before the next; ``size`` is per run."""
    tau = shape["warms_in_tests"] * drives[0].test_s
    whole = -np.expm1(-drives[0].test_s / tau)
    return [Acts(sensor_kN=-size * device.Fy * np.expm1(-d.course.time_s / tau) / whole) for d in drives]


TRAVEL, DISTANCE, SPEED = (("capacity", "travel"),), (("capacity", "distance"),), (("capacity", "speed"),)
TIME = (("capacity", "time"),)
SIMULATORS = (
    Simulator(
        "wear_saturating",
        "wear",
        TRAVEL,
        "share",
        (0.005, 0.25),
        _over_travel(lambda s, size, shape: 1.0 + size * np.expm1(-s / shape["length_m"])),
        "coating that wears down to the steel: Fy (1 - p (1 - exp(-s/s0)))",
        draw=lambda rng: {"length_m": float(np.exp(rng.uniform(np.log(0.7), np.log(4.0))))},
    ),
    Simulator(
        "wear_power",
        "wear",
        TRAVEL,
        "share in two runs",
        (0.005, 0.25),
        _over_travel(lambda s, size, shape: np.maximum(1.0 - size * (s / TESTED_M) ** shape["power"], 0.2)),
        "wear that slows down or speeds up: a power of travel",
        draw=lambda rng: {"power": float(rng.choice([rng.uniform(0.4, 0.75), rng.uniform(1.4, 2.0)]))},
    ),
    Simulator(
        "prying_gap",
        "prying",
        DISTANCE,
        "share",
        (0.005, 0.25),
        _over_distance(lambda y, shape: np.maximum(y - shape["gap"], 0.0) / (1.0 - shape["gap"])),
        "plate that rocks once a gap has closed: linear beyond it, elastic bolt",
        truth=lambda size, shape, device: {"size": size},
        draw=lambda rng: {"gap": float(rng.uniform(0.0, 0.4))},
    ),
    Simulator(
        "prying_quadratic",
        "prying",
        DISTANCE,
        "share",
        (0.005, 0.25),
        _over_distance(lambda y, shape: y**2),
        "plate that bends under an eccentric force: square of the distance, elastic bolt",
        truth=lambda size, shape, device: {"size": size},
    ),
    Simulator(
        "centre_wear_trough",
        "centre_wear",
        DISTANCE,
        "share",
        (0.005, 0.2),
        _over_distance(lambda y, shape: 1.0 / (1.0 + np.exp((y - shape["half_width"]) / shape["ramp"]))),
        "trough of even depth with rounded ends, elastic bolt",
        draw=lambda rng: {"half_width": float(rng.uniform(0.25, 0.6)), "ramp": float(rng.uniform(0.03, 0.1))},
    ),
    Simulator(
        "velocity_law_power",
        "velocity_law",
        SPEED,
        "share",
        (0.005, 0.1),
        _over_speed(_power_of_speed),
        "lubricant film: a power of speed",
        draw=lambda rng: {"power": float(rng.uniform(0.3, 0.6))},
        base=("K", "ratio"),
        signed=True,
    ),
    Simulator(
        "stribeck_flash",
        "stribeck",
        SPEED,
        "share",
        (0.005, 0.3),
        _over_speed(lambda v, size, shape: 1.0 + size / (1.0 + v / shape["fades_mm_s"])),
        "asperities weakened by flash heat: 1/(1 + v/v0)",
        draw=lambda rng: {"fades_mm_s": float(rng.uniform(0.5, 2.5))},
        base=("K", "ratio"),
    ),
    Simulator(
        "breakaway_junctions",
        "breakaway",
        (("capacity", "slip"),),
        "share",
        (0.005, 0.3),
        _torn,
        "junctions of finite length torn behind every reversal: 1 - (d/D)^2",
        draw=lambda rng: {"length_mm": float(np.exp(rng.uniform(np.log(3.0), np.log(25.0))))},
        base=("K", "gamma", "ratio"),
    ),
    Simulator(
        "bedding_in_exponential",
        "bedding_in",
        TRAVEL,
        "share",
        (0.005, 0.3),
        _over_travel(lambda s, size, shape: 1.0 - size * np.expm1(-s / shape["length_m"])),
        "contact area that grows to its end value: 1 - exp(-s/s0)",
        draw=lambda rng: {"length_m": float(np.exp(rng.uniform(np.log(0.1), np.log(1.5))))},
    ),
    Simulator(
        "bedding_in_hyperbolic",
        "bedding_in",
        TRAVEL,
        "share",
        (0.005, 0.3),
        _over_travel(lambda s, size, shape: 1.0 + size * s / (s + shape["length_m"])),
        "asperities flattened one after another: s/(s + s0)",
        draw=lambda rng: {"length_m": float(np.exp(rng.uniform(np.log(0.1), np.log(1.5))))},
    ),
    Simulator(
        "drift_zeroed",
        "drift",
        (("added", "time"),),
        "share per run",
        (0.005, 0.15),
        _zeroed,
        "amplifier that warms up, zeroed before each run",
        draw=lambda rng: {"warms_in_tests": float(np.exp(rng.uniform(np.log(0.3), np.log(20.0))))},
        signed=True,
    ),
    Simulator(
        "clamping_swing",
        "tension_step",
        TIME,
        "share",
        (0.005, 0.15),
        _over_time(lambda t, size, shape, _: 1.0 + size * np.sin(2 * np.pi * t / shape["period_s"] + shape["phase"])),
        "pressure of a clamping actuator that swings in time",
        draw=lambda rng: {
            "period_s": float(np.exp(rng.uniform(np.log(80.0), np.log(400.0)))),
            "phase": float(rng.uniform(0.0, 2 * np.pi)),
        },
        base=("K", "beta", "gamma"),
        may_be_unknown=True,
    ),
    Simulator(
        "clamping_wander",
        "tension_step",
        TIME,
        "share after one test",
        (0.005, 0.15),
        _over_time(_wander),
        "clamping actuator that creeps: a smooth random walk in time",
        draw=lambda rng: {"pace_s": float(rng.uniform(30.0, 90.0)), "seed": float(rng.integers(2**31))},
        base=("K", "beta", "gamma"),
        may_be_unknown=True,
    ),
)
