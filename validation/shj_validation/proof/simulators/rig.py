"""The testing rig: two contacts, bolts, grip, mass and what is added, stepped through time on a fine grid."""

from dataclasses import dataclass, fields, replace
from math import prod
from typing import Any

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError
from shj_validation.proof.device import Device
from shj_validation.proof.protocols import Course
from shj_validation.proof.simulators.branch import STILL_MM, branches
from shj_validation.proof.simulators.iwan import elements, in_series, move, try_move

RULES = ("published", "continuous")  # at a reversal: jump as Eq. (1) does, or unload from the force there is
DAMPING = 0.05  # of critical, of the spring that drives a mass: bolted steel (Newmark and Hall 1982)
SLIP_MEMORY_S = 0.004  # contacts notice a change of the slip speed after some micrometres, not at once


@dataclass(frozen=True, eq=False)
class Acts:
    """What physics does to the rig in one run; the defaults do nothing, and several combine.

    Parameters
    ----------
    clamping : array or float
        Multiplies the sliding force: bolt tension and friction coefficient.
    added_kN : array or float
        Force beside the friction, on the device's side of the load cell, kN.
    lever : float
        Share of the friction force that tightens the contact, by its sign.
    clearance_mm : float
        Free travel in the grip, mm.
    second_share, bolt_kN_mm, bolt_clearance_mm : float
        Share of capacity and stiffness on a second contact, and the tilting bolt that drives it.
    mass_t : float
        Mass between spring and device, t; with any, the rig is integrated with Newton's law.
    spring_kN_mm : float
        Spring that drives the mass; stiff by default.
    weakening, weakening_mm_s : float
        Friction above its moving value at standstill (share), and the slip speed over which it is lost.
    delay_s, filter_s : float
        Pure delay and time constant of a two-pole filter of the force channel, s.
    sensor_kN : array or float
        Added by the load cell and its amplifier, kN.
    speed_per_mm_s : array or float
        Added to the speed coefficient of the device, s/mm.
    """

    clamping: FloatArray | float = 1.0
    added_kN: FloatArray | float = 0.0
    clearance_mm: float = 0.0
    lever: float = 0.0
    second_share: float = 0.0
    bolt_kN_mm: float = 50.0
    bolt_clearance_mm: float = 0.0
    mass_t: float = 0.0
    spring_kN_mm: float = 400.0
    weakening: float = 0.0
    weakening_mm_s: float = 1.0
    delay_s: float = 0.0
    filter_s: float = 0.0
    sensor_kN: FloatArray | float = 0.0
    speed_per_mm_s: FloatArray | float = 0.0


def join(parts: list[Acts]) -> Acts:
    """Join several physics: factors multiply, forces and delays add, the rest is taken from whoever sets it."""
    out: dict[str, Any] = {}
    for field in fields(Acts):
        values = [getattr(part, field.name) for part in parts]
        if field.name == "clamping":
            out[field.name] = prod(values, start=1.0)
        elif field.name in ("added_kN", "sensor_kN", "delay_s", "filter_s", "speed_per_mm_s"):
            out[field.name] = sum(values, start=0.0)
        else:
            out[field.name] = next((value for value in values if value != field.default), field.default)
    return Acts(**out)


@dataclass(frozen=True, eq=False)
class Drive:
    """One run as the physics sees it.

    Parameters
    ----------
    course : Course
        Displacement on the fine grid.
    capacity_kN : float
        Sliding force of this run without any effect, kN.
    slip_mm_s : array, shape (n,)
        Speed of sliding of the device without any effect (not of the grip), never negative, mm/s.
    stroke_mm : float
        Largest displacement of the tests, mm.
    test_s : float
        Duration of one test run, s.
    frame_kN_mm : float
        Stiffness of the frame, kN/mm.
    rule : {"published", "continuous"}
        What happens at a reversal; see `RULES`.
    """

    course: Course
    capacity_kN: float
    slip_mm_s: FloatArray
    stroke_mm: float
    test_s: float
    frame_kN_mm: float
    rule: str = "continuous"

    @property
    def x(self) -> FloatArray:
        """Displacement, mm."""
        return self.course.x_mm

    @property
    def speed(self) -> FloatArray:
        """Speed, mm/s."""
        return np.asarray(np.abs(self.course.v_mm_s))

    @property
    def sense(self) -> FloatArray:
        """+1 or -1 with the step from the sample before, in which a contact turns; while resting, that before."""
        step = np.diff(self.course.x_mm, prepend=self.course.x_mm[0])
        sign = np.where(np.abs(step) > STILL_MM, np.sign(step), 0.0)
        last = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))
        return np.asarray(np.where(sign[last] == 0, 1.0, sign[last]))

    @property
    def dt(self) -> float:
        """Step, s."""
        return self.course.dt_s

    def sliding_from(self, device: Device, clamping: float) -> FloatArray:
        """Speed of sliding of a contact that sticks up to a clamping, shape (n,), mm/s; as for `slip_mm_s`."""
        course = self.course
        force = rate_free(self, device, Acts(clamping=clamping))
        sliding = np.abs(course.v_mm_s - np.gradient(force, course.dt_s) / device.K)
        slides = np.abs(force) > 0.5 * clamping * self.capacity_kN
        return np.where(slides, np.minimum(sliding, np.abs(course.v_mm_s)), 0.0)


def drives(
    courses: list[Course],
    device: Device,
    stroke_mm: float,
    test_s: float,
    frame_kN_mm: float,
    rule: str = "continuous",
) -> list[Drive]:
    """Drive the bare rig through all runs, to know when and how fast it slides."""
    out = []
    for run, course in enumerate(courses, start=1):
        capacity = device.Fy * (device.ratio if run > 1 else 1.0)
        rests = np.zeros(course.x_mm.size)
        bare = Drive(course, capacity, rests, stroke_mm, test_s, frame_kN_mm, rule)
        out.append(replace(bare, slip_mm_s=bare.sliding_from(device, 1.0)))
    return out


def rate_free(drive: Drive, device: Device, acts: Acts) -> FloatArray:
    """Force before Eq. (2) and the sensors, kN; a mass and a second contact want the continuous rule."""
    x = drive.course.x_mm
    clamping = np.ascontiguousarray(np.broadcast_to(acts.clamping, x.shape), dtype=np.float64)
    out = np.empty(x.size)
    if drive.rule == "published":
        if acts.mass_t or acts.second_share:
            raise ModelError("a mass or a second contact cannot follow the published reversal rule; take continuous")
        branches(out, x, clamping, device.K, drive.capacity_kN, device.beta, acts.lever, acts.clearance_mm)
        return out
    spring = acts.spring_kN_mm if acts.mass_t else drive.frame_kN_mm
    own = 1.0 / (1.0 / device.K - 1.0 / spring)  # so that K is what the gauges see
    if acts.mass_t:
        stiffness, limits = elements(own, drive.capacity_kN, device.beta)
        damping = 2.0 * DAMPING * np.sqrt(spring * acts.mass_t * 1e-3)
        _with_mass(
            out,
            x,
            drive.dt,
            clamping,
            stiffness,
            limits,
            np.array([acts.mass_t * 1e-3, spring, damping, acts.weakening, acts.weakening_mm_s, acts.lever]),
        )
        return out
    first, limits = elements(
        own * (1.0 - acts.second_share), drive.capacity_kN * (1.0 - acts.second_share), device.beta
    )
    share = acts.second_share
    second, limits_2 = elements(own * share, drive.capacity_kN * share, device.beta) if share else (0.0, np.zeros(1))
    _quasi_static(
        out,
        x,
        clamping,
        first,
        limits,
        second,
        limits_2,
        np.array([spring, acts.clearance_mm, acts.bolt_kN_mm, acts.bolt_clearance_mm, acts.lever]),
    )
    return out


@njit(cache=True, error_model="numpy")
def _quasi_static(out, x, clamping, first, limits, second, limits_2, parts):  # type: ignore[no-untyped-def]
    """Equilibrium at every step: grip with clearance against one contact, or two of which a bolt drives the second."""
    spring, clearance, bolt, bolt_clearance, lever = parts[0], parts[1], parts[2], parts[3], parts[4]
    held = np.zeros(limits.size)
    held_2 = np.zeros(limits_2.size)
    u, w = 0.0, 0.0
    for i in range(x.size):
        c = clamping[i]
        if second == 0.0:
            new = in_series(x[i], held, limits, c, lever, first, spring, clearance, u)
            move(held, limits, c, lever, first, new - u)
            u = new
            out[i] = held.sum()
        else:  # the frame is stiff against both contacts: one correction of its stretch is enough on a fine grid
            total = held.sum() + held_2.sum()
            new = x[i] - total / spring
            move(held, limits, c, lever, first, new - u)
            u = new
            moved = in_series(u, held_2, limits_2, c, lever, second, bolt, bolt_clearance, w)
            move(held_2, limits_2, c, lever, second, moved - w)
            w = moved
            out[i] = held.sum() + held_2.sum()


@njit(cache=True, error_model="numpy")
def _with_mass(out, x, dt, clamping, stiffness, limits, parts):  # type: ignore[no-untyped-def]
    """Newton's law for a mass on a spring (semi-implicit Euler), friction weakening with the speed of the mass."""
    mass, spring, damping, weakening, fades, lever = parts[0], parts[1], parts[2], parts[3], parts[4], parts[5]
    held = np.zeros(limits.size)
    y, v, before = x[0], 0.0, x[0]
    slip = 0.0
    for i in range(x.size):
        factor = clamping[i] * (1.0 + weakening * np.exp(-slip / fades))
        step = v * dt
        friction, tangent = try_move(held, limits, factor, lever, stiffness, 0.0)
        if abs(step) > 1e-12:  # slope along the step that is coming: a slider at its limit adds none
            tangent = (try_move(held, limits, factor, lever, stiffness, step)[0] - friction) / step
        pull = spring * (x[i] - y)
        rate = (x[i] - before) / dt
        before = x[i]
        v = (v + dt / mass * (pull + damping * rate - friction)) / (
            1.0 + dt / mass * (damping + dt * (tangent + spring))
        )
        was = held.sum()
        move(held, limits, factor, lever, stiffness, v * dt)
        elastic = (held.sum() - was) / (stiffness * held.size * dt)
        slip += (abs(v - elastic) - slip) * min(1.0, dt / SLIP_MEMORY_S)
        y += v * dt
        out[i] = spring * (x[i] - y) + damping * (rate - v)
