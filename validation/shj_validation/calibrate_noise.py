"""Devices under noises that the fit may or may not know, at several sampling rates: the part `noise` of `calibrate.py`.

Every draw is a device with parameters from the priors `afc`; kind of noise, rate, reversal rule and number of runs go
round, so that any first n draws are balanced. The displacement has noise of 0.02 mm. With ``--effects`` the law has
slack, wear or asymmetry in turn, drawn from its priors, and the fit is told of it.
"""

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ShjError
from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.filter import simulate
from shj_bayes.model.history import histories
from shj_bayes.model.noise import noise_model
from shj_bayes.model.parameters import LAW_PARAMETERS, base_and_run
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import Block, exact_motion, table_1
from shj_bayes.recording.recording import Recording
from shj_bayes.results.fit import Trust

# Those that the default noise model holds exactly come first.
KNOWN = ("white", "slow 1 s", "slow 3 s", "slow 30 s")
NOISES = (*KNOWN, "ar1", "uneven", "drift", "rounded")
RATES_HZ = (5.0, 20.0, 200.0, 1000.0)
RULES = ("published", "continuous")
EFFECTS = ("slack", "wear", "asymmetry")
WOBBLE_MM = 0.02
# Above 20 Hz one cycle of each amplitude instead of three: the time goes into smoothing a million readings.
SHORT = tuple(Block(block.amplitude_mm, block.frequency_Hz, 1) for block in table_1())
SLOW_SHARE = 0.75  # of the white noise: slow part
UNEVEN = 2.5  # times more noise at low speed
LEAST_SLIDING = 0.15  # of the stroke must be sliding: a device that hardly slides says nothing of Fy


def cell(number: int, effects: bool) -> dict[str, Any]:
    """Kind of noise, rate, reversal rule, runs and effect of a draw."""
    which, rest = number % len(NOISES), number // len(NOISES)
    rate, rest = RATES_HZ[rest % len(RATES_HZ)], rest // len(RATES_HZ)
    if effects:
        rate = 5.0  # an effect is evaluated set by set: a thousand readings in the time of a million
    own = EFFECTS[number % len(EFFECTS)] if effects else ""
    return {
        "noise": NOISES[which],
        "rate_Hz": rate,
        "rule": RULES[rest % len(RULES)],
        "runs": 2 if effects else 1 + number % 3,
        "effect": own,
    }


def draw_noise(number: int, seed: int, *, effects: bool, max_steps: int) -> dict[str, Any]:
    """Make and fit one device.

    Parameters
    ----------
    number, seed : int
        Same number and seed, same draw.
    effects : bool
        Whether the law has an effect.
    max_steps : int
        Steps after which to stop.

    Returns
    -------
    dict
        What was drawn, the truth, and for each parameter the share of draws below it and its distance from their mean
        in standard deviations of the unbounded parameter.
    """
    begin = time.perf_counter()
    chosen = cell(number, effects)
    rng = np.random.default_rng([seed, number, 5])
    priors = read_priors("afc")
    model = DeviceModel(
        chosen["runs"], priors, effects=effects_named([chosen["effect"]] if effects else []), variant=chosen["rule"]
    )
    values = _truth(model, rng)
    record = {"number": number, **chosen, "truth": values}
    try:
        runs = runs_of(list(_recordings(model, values, chosen, rng)))
        result = fit(runs, model, plan=SamplingPlan(seed=int(rng.integers(2**31)), max_steps=max_steps, threads=1))
    except ShjError as error:
        return record | {"error": str(error), "seconds": time.perf_counter() - begin}
    z, below = {}, {}
    for name, prior in zip(model.law_names, model.laws, strict=False):
        draws = np.asarray(result.data["posterior"][name]).ravel()
        free, true = prior.to_free(draws), float(prior.to_free(np.asarray(values[name])))
        z[name], below[name] = float((free.mean() - true) / free.std()), float(np.mean(draws < values[name]))
    record |= {"verdict": result.verdict.word, "widened": list(result.widening.widened), "z": z, "below": below}
    return record | {"seconds": time.perf_counter() - begin}


def _truth(model: DeviceModel, rng: np.random.Generator) -> dict[str, float]:
    """Draw from the priors until the device slides over a part of its stroke."""
    while True:
        z = rng.standard_normal(len(model.names))
        values = dict(zip(model.names, model.laws.natural(z[None])[0].tolist(), strict=True))
        stroke = 2 * max(block.amplitude_mm for block in SHORT)
        loads = [values["Fy"] * values[n] for n in model.names if n.startswith("ratio")] + [values["Fy"]]
        if 2 * max(loads) / values["K"] < (1 - LEAST_SLIDING) * stroke:
            return values


def _recordings(
    model: DeviceModel, values: dict[str, float], chosen: dict[str, Any], rng: np.random.Generator
) -> Iterator[Recording]:
    """Simulate the runs of a device."""
    time_s, motion = exact_motion(table_1() if chosen["rate_Hz"] <= 20 else SHORT, chosen["rate_Hz"])
    theta = np.array([[values[name] for name in model.names]])
    for history in histories([time_s] * model.n_runs, [motion] * model.n_runs):
        force = model.force(theta, history, 0.0)[0]
        noisy = _with_noise(force, chosen["noise"], values["sigma_white"], time_s, motion.speed_mm_s, rng)
        wobble = WOBBLE_MM * rng.standard_normal(time_s.size)
        yield Recording(time_s, motion.displacement_mm + wobble, noisy)


def _with_noise(
    force: FloatArray, kind: str, sigma: float, time_s: FloatArray, speed: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Force as a load cell of this kind would record it; `sigma` is its scatter from sample to sample."""
    restarts = np.arange(time_s.size) == 0
    if kind == "ar1":
        return force + simulate(noise_model("ar1"), {"sigma": sigma, "phi": 0.8}, time_s, restarts, rng)
    white = sigma * rng.standard_normal(time_s.size)
    if kind == "uneven":
        return np.asarray(force + white * np.where(speed < 0.4 * np.percentile(speed, 95), UNEVEN, 1.0))
    if kind == "rounded":
        step = 2.0 * sigma
        return np.asarray(step * np.rint((force + white) / step))
    if kind == "drift":
        way = np.cumsum(rng.standard_normal(time_s.size)) * np.sqrt(np.median(np.diff(time_s)) / 100.0)
        return np.asarray(force + white + SLOW_SHARE * sigma * way)
    if kind.startswith("slow"):
        slow = {"sigma_white": 0.0, "sigma_slow": SLOW_SHARE * sigma, "tau_slow": float(kind.split()[1])}
        return np.asarray(force + white + simulate(noise_model("slow"), slow, time_s, restarts, rng))
    return np.asarray(force + white)


def tables(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Coverage and size of the errors by noise, by rate, by reversal rule and by number of runs, as Markdown."""
    good = [row for row in rows if "z" in row]
    lines = _table("noise", good, sorted({r["noise"] for r in good}, key=NOISES.index))
    lines += ["", "In the model:", "", *_table("noise", [r for r in good if r["noise"] in KNOWN], ["*"])]
    for key in ("rate_Hz", "rule", "runs", "effect"):
        own = sorted({row[key] for row in good})
        lines += ["", *_table(key, good, own)] if len(own) > 1 else []
    return lines


def _table(key: str, rows: Sequence[dict[str, Any]], values: Sequence[Any]) -> list[str]:
    """Share of 90 % intervals that hold the truth, and rms of the error over the standard deviation."""
    names = [n for n in LAW_PARAMETERS if any(n in r["z"] for r in rows)]
    more = sorted({name for r in rows for name in r["z"] if "." in name})
    head = [key.replace("_", " "), "devices", *names, *more]
    lines = ["| " + " | ".join(head) + " | not reliable |", "|---" * (len(head) + 1) + "|"]
    for value in values:
        own = [row for row in rows if value == "*" or row[key] == value]
        cells = [_cell(own, name) for name in (*names, *more)]
        share = np.mean([row["verdict"] != Trust.RELIABLE for row in own])
        label = "all" if value == "*" else f"{value:g}" if isinstance(value, float) else value
        lines.append(f"| {label} | {len(own)} | " + " | ".join(cells) + f" | {100 * share:.0f} % |")
    return lines


def _cell(rows: Sequence[dict[str, Any]], name: str) -> str:
    """Coverage and rms z of a parameter, ratios of all later runs together."""
    pairs = [
        (row["below"][n], row["z"][n])
        for row in rows
        for n in row["z"]
        if n == name or ("." not in n and "." not in name and base_and_run(n)[0] == name)
    ]
    if not pairs:
        return ""
    below, z = np.array(pairs).T
    return f"{100 * np.mean(np.abs(below - 0.5) <= 0.45):.0f} % ({np.sqrt(np.mean(z**2)):.2f})"
