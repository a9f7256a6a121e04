"""Motion recovered from noisy displacement, against the exact motion of Table 1: ``python benchmarks/kinematics.py``.

Prints the tables of docs/decisions/0002: ten recordings a line (two at 1 kHz), white noise or a 10-bit encoder; then
when a device that rested at the end of a stroke leaves it; then the turning points of triangles
and of ramps with rests.
"""

from __future__ import annotations

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.recording.motion import exact_motion, motion_of, table_1
from shj_bayes.recording.recording import Recording, Source
from shj_validation.proof.protocols import course

COUNT_MM = 0.195  # 10 bits over 200 mm
ROWS = [(rate, noise) for rate in (20.0, 100.0) for noise in (0.02, 0.1, None)] + [(1000.0, 0.1), (1000.0, None)]


def errors(rate_Hz: float, noise_mm: float | None, seed: int) -> tuple[int, FloatArray, FloatArray, FloatArray, float]:
    """Half-cycles found; errors of turning points, of speed and of displacement; speed at mid-stroke over the exact."""
    time, exact = exact_motion(table_1(), rate_Hz)
    rng = np.random.default_rng([seed, int(rate_Hz)])
    if noise_mm is None:
        shift = COUNT_MM * rng.uniform()
        x = np.round((exact.displacement_mm + shift) / COUNT_MM) * COUNT_MM - shift
    else:
        x = exact.displacement_mm + noise_mm * rng.standard_normal(time.size)
    source = Source("simulated", "", "csv", {}, {})
    found = motion_of(Recording(time, x, np.zeros(time.size), source=source))
    if found.n_half != exact.n_half:
        return found.n_half, *(np.array([np.nan]),) * 3, np.nan
    outward = (found.turning_mm - exact.turning_mm)[1:] * np.sign(exact.turning_mm[1:])
    middle = np.abs(exact.displacement_mm) < 0.3 * np.abs(exact.turning_mm[exact.half_cycle])
    return (
        found.n_half,
        outward,
        found.speed_mm_s - exact.speed_mm_s,
        found.displacement_mm - exact.displacement_mm,
        float(np.mean(found.speed_mm_s[middle] / exact.speed_mm_s[middle]) - 1),
    )


def left_late_s(rate_Hz: float, noise_mm: float, seed: int) -> float:
    """Error of the moment at which a device leaves a rest of 20 s, as a sine of 95 mm at 10 mm/s does, s."""
    time = np.arange(0.0, 75.0, 1.0 / rate_Hz)
    x = 95.0 * np.where(time < 15.0, np.sin(np.pi / 30.0 * time), np.cos(10.0 / 95.0 * np.maximum(time - 35.0, 0.0)))
    x += noise_mm * np.random.default_rng([seed, int(rate_Hz)]).standard_normal(time.size)
    found = motion_of(Recording(time, x, np.zeros(time.size)))
    return float(time[found.start[1]] - 35.0)


def turning_errors(protocol: str, rate_Hz: float, noise_mm: float) -> FloatArray:
    """Errors of the turning points of straight strokes whose corners an actuator rounds, outward, mm."""
    fine = 40
    exact = course(protocol, rate_Hz, fine).x_mm
    x = exact[::fine]
    x = x + noise_mm * np.random.default_rng(int(rate_Hz)).standard_normal(x.size)
    found = motion_of(Recording(np.arange(x.size) / rate_Hz, x, np.zeros(x.size))).turning_mm[1:]
    moving = np.diff(exact)[np.flatnonzero(np.diff(exact))]
    turns = exact[np.flatnonzero(np.diff(exact))[1:]][np.diff(np.sign(moving)) != 0]
    return np.asarray((found - turns) * np.sign(turns))


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def main() -> None:
    """Print the table."""
    print(
        "| rate | noise | half-cycles | turning points outward: bias, rms (mm) | speed at mid-stroke: bias (%) | ",
        end="",
    )
    print("speed: rms (mm/s) | displacement: rms (mm) |\n|---|---|---|---|---|---|---|")
    for rate, noise in ROWS:
        tries = [errors(rate, noise, seed) for seed in range(10 if rate < 1000 else 2)]
        counts = sorted({one[0] for one in tries})
        turning, speed, displacement = (np.concatenate([one[k] for one in tries]) for k in (1, 2, 3))
        middle = [one[4] for one in tries]
        print(
            f"| {rate:g} Hz | {'encoder' if noise is None else f'{noise:g} mm'} | {', '.join(map(str, counts))} | "
            f"{turning.mean():+.4f} ± {turning.std() / np.sqrt(turning.size):.4f}, {rms(turning):.3f} | "
            f"{100 * np.mean(middle):+.3f} | {rms(speed):.3f} | {rms(displacement):.4f} |",
            flush=True,
        )
    print("\n| rate | noise | a rest is left too late: mean, rms (s) |\n|---|---|---|")
    for rate in (5.0, 20.0, 200.0):
        for noise in (0.005, 0.02):
            late = np.array([left_late_s(rate, noise, seed) for seed in range(20)])
            print(f"| {rate:g} Hz | {noise:g} mm | {late.mean():+.3f}, {rms(late):.3f} |", flush=True)
    for protocol in ("triangles", "ramps with rests"):
        print(f"\n| {protocol}: rate | noise | turning points outward: bias, rms (mm) |\n|---|---|---|")
        for rate in (5.0, 10.0, 20.0, 100.0):
            for noise in (0.005, 0.02):
                wrong = turning_errors(protocol, rate, noise)
                print(f"| {rate:g} Hz | {noise:g} mm | {wrong.mean():+.4f}, {rms(wrong):.4f} |", flush=True)


if __name__ == "__main__":
    main()
