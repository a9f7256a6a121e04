"""Simulation-based calibration: ``python -m shj_validation.calibrate [noise|device|margins] -n 300``.

noise
    Fits of devices under noises that the model may or may not know, at four sampling rates: see `calibrate_noise`.
    With ``--effects`` the law has slack, wear or asymmetry.
device
    The posterior of a device.
margins
    The prediction of a new device, which all margins are quantiles of, with two tested devices in each of five sets.

Each draw of `device` takes parameters from the priors, simulates two runs with white and slow force noise and with
displacement noise, and samples their posterior as `shj-bayes fit` does. If prior, simulator, law, smoothing of the
displacement, likelihood and sampler belong together, the rank of the true value among the posterior draws is uniform,
and a 90 % interval holds it in 90 % of the draws. Finished draws are kept in ``calibration*.jsonl``; the same command
goes on where it stopped.

``--broken white`` (noise taken for white), ``--broken jacobian`` (the Jacobian of the sampler's parameters counted
in the likelihood too) and ``--broken signed`` (speed with its sign) break one thing on purpose: the test must fail.

Sources: Talts et al. 2018, arXiv 1804.06788 (ranks); Saeilynoja, Buerkner, Vehtari 2022, Stat. Comput. 32 (envelopes).
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from tqdm import tqdm

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import write_text
from shj_bayes.errors import ShjError
from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.convergence import judge
from shj_bayes.inference.likelihood import Density, Likelihood, make_likelihood
from shj_bayes.inference.sampler import SamplingPlan, run_ensembles
from shj_bayes.inference.start import find_start
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.law import force
from shj_bayes.model.noise import DEFAULT, noise_model
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block, exact_motion, table_1
from shj_bayes.recording.recording import Recording
from shj_bayes.results.fit import Trust
from shj_validation.calibrate_noise import draw_noise, tables
from shj_validation.calibrate_parts import N_RANKS, draw_margins, ranks_of

ROOT = Path(__file__).resolve().parents[2]
BROKEN = ("white", "jacobian", "signed")
SHORT = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))  # for the tests of the test: half a minute of motion
LEVELS = (0.50, 0.80, 0.90, 0.95)
DEFAULTS: dict[str, dict[str, Any]] = {
    "noise": {"effects": False, "max_steps": 10_000},
    "device": {"rate_Hz": 5.0, "short": False, "broken": "", "max_steps": 10_000, "wobble_mm": 0.02},
    "margins": {"n_sets": 5, "n_devices": 2, "sd": 0.02},
}
LAW = ("K", "Fy", "beta", "gamma", "ratio")  # the others, of the noise, describe all that is left over


class WithJacobian:
    """A posterior with the Jacobian counted once more, in the likelihood, where it does not belong."""

    def __init__(self, posterior: Likelihood) -> None:
        self.posterior = posterior

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log posterior density plus the logarithm of d(natural)/d(free)."""
        step = 1e-5
        slopes = [
            (prior.from_free(z[:, i] + step) - prior.from_free(z[:, i] - step)) / (2 * step)
            for i, prior in enumerate(self.posterior.model.laws)
        ]
        with np.errstate(divide="ignore", invalid="ignore"):
            extra = np.log(np.abs(slopes)).sum(axis=0)
        return np.asarray(self.posterior.log_posterior_free(z) + np.nan_to_num(extra, nan=-np.inf))


def draw(
    number: int, seed: int, *, rate_Hz: float, short: bool, broken: str, max_steps: int, wobble_mm: float
) -> dict[str, Any]:
    """Make and fit one draw.

    Parameters
    ----------
    number, seed : int
        Same number and seed, same draw.
    rate_Hz : float
        Sampling rate, Hz.
    short : bool
        Four cycles instead of Table 1.
    broken : str
        What to break, or "".
    max_steps : int
        Steps after which to stop.
    wobble_mm : float
        Displacement noise, mm.

    Returns
    -------
    dict
        Truth, rank, and position of the truth in the posterior (share of draws below it) for each parameter.
    """
    begin = time.perf_counter()
    priors = read_priors("afc")
    model = DeviceModel(2, priors, noise=noise_model("independent" if broken == "white" else DEFAULT))
    names = DeviceModel(2, priors).names
    rng = np.random.default_rng([seed, number])
    values = {name: float(priors.of(name).distribution.rvs(random_state=rng)) for name in names}
    known = {"sigma" if name == "sigma_white" else name: value for name, value in values.items()}
    truth = Truth(**known, phi=0.0, displacement_noise_mm=wobble_mm)
    blocks = SHORT if short else table_1()
    record: dict[str, Any] = {"number": number, "truth": values}
    try:
        recordings = simulate_device(truth, seed=int(rng.integers(2**31)), rate_Hz=rate_Hz, blocks=blocks)
        if broken == "signed":
            recordings = _with_signed_speed(recordings, truth, blocks, rate_Hz)
        posterior, start = find_start(make_likelihood(runs_of(recordings), model))
        density: Density = WithJacobian(posterior) if broken == "jacobian" else posterior
        plan = SamplingPlan(seed=int(rng.integers(2**31)), max_steps=max_steps, threads=1)
        states, figures = run_ensembles(density, posterior.model.names, start, plan)
        chains = np.stack([state.chain[figures.n_burn :] for state in states])
        theta = posterior.model.laws.natural(chains.reshape(-1, len(posterior.model.names)))
        draws = {name: row for name, row in zip(posterior.model.names, theta.T, strict=True) if name in values}
    except ShjError as error:
        return record | {"error": str(error), "seconds": time.perf_counter() - begin}
    ranked = ranks_of(draws, values)
    return record | {"verdict": judge(figures).word, **ranked, "seconds": time.perf_counter() - begin}


def _with_signed_speed(
    recordings: Sequence[Recording], truth: Truth, blocks: tuple[Block, ...], rate_Hz: float
) -> tuple[Recording, ...]:
    """Change recordings to those of a law that takes the speed with its sign, as Eq. (2) is literally printed."""
    _, motion = exact_motion(blocks, rate_Hz)
    changed = []
    for run, recording in enumerate(recordings, start=1):
        given: dict[str, Any] = {
            "K": truth.K,
            "Fy": truth.Fy * (truth.ratio if run == 2 else 1.0),
            "beta": truth.beta,
        }
        still = force(motion, gamma=0.0, **given)
        direction = motion.direction[motion.half_cycle]
        wrong = still * truth.gamma * motion.speed_mm_s * (direction - 1.0)
        changed.append(replace(recording, force_kN=recording.force_kN + wrong))
    return tuple(changed)


def run(
    n: int, seed: int, path: Path, *, part: str = "device", workers: int = 0, progress: bool = True, **options: Any
) -> list[dict[str, Any]]:
    """Make the draws that are not in the file yet, and append each as it is finished.

    Parameters
    ----------
    n, seed : int
        How many draws, and their stream.
    path : Path
        Where they are kept.
    part : {"noise", "device", "margins"}
        What is drawn.
    workers : int
        Processes, 0 for one per processor.
    progress : bool
        Show a progress bar.
    **options
        Of the part's draw; its defaults otherwise.

    Returns
    -------
    list of dict
        The first n draws in order.
    """
    options = DEFAULTS[part] | options
    parts: dict[str, Callable[..., dict[str, Any]]] = {"noise": draw_noise, "device": draw, "margins": draw_margins}
    head = {"schema": "shj-bayes/calibration/1", "seed": seed, **options}
    done = _read(path, head)
    missing = [number for number in range(n) if number not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    # Written anew without a line that was cut short when the process was killed.
    write_text(path, "".join(json.dumps(row) + "\n" for row in (head, *(done[k] for k in sorted(done)))))
    if missing:
        bar = tqdm(total=n, initial=n - len(missing), unit="draw", disable=None if progress else True)
        context = get_context("spawn")
        pool = ProcessPoolExecutor(min(workers or os.cpu_count() or 1, len(missing)), mp_context=context)
        with bar, pool, path.open("a", encoding="utf-8") as stream:
            futures = [pool.submit(parts[part], number, seed, **options) for number in missing]
            for future in as_completed(futures):
                row = future.result()
                done[row["number"]] = row
                stream.write(json.dumps(row) + "\n")
                stream.flush()
                bar.update()
    return [done[number] for number in range(n)]


def _read(path: Path, head: dict[str, Any]) -> dict[int, dict[str, Any]]:
    """Finished draws of the same settings."""
    if not path.exists():
        return {}
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            rows.append(json.loads(line))
        except ValueError:
            break  # the line that was being written when the process was killed
    if not rows or rows[0] != head:
        raise SystemExit(f"{path} holds draws of other settings; name another file with --file, or delete it")
    return {row["number"]: row for row in rows[1:]}


def envelope(n: int, *, sets: int = 4000) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Simultaneous 95 % band of the cumulative histogram of n uniform ranks, and the law of its test statistic.

    Returns
    -------
    low, high : array, shape (N_RANKS,)
        Band of the number of ranks up to 0, 1, ... N_RANKS - 1.
    smallest : array, shape (sets,)
        Smallest two-sided pointwise probability of each simulated set.
    """
    rng = np.random.default_rng(20180418)
    smallest = np.array([_smallest(rng.integers(0, N_RANKS + 1, n)) for _ in range(sets)])
    level = float(np.quantile(smallest, 0.05))
    share = np.arange(1, N_RANKS + 1) / (N_RANKS + 1)
    low, high = (np.asarray(stats.binom.ppf(p, n, share)) for p in (level / 2, 1 - level / 2))
    return low, high, smallest


def _smallest(ranks: NDArray[Any]) -> float:
    """Smallest pointwise probability that a uniform cumulative histogram is as far off."""
    share = np.arange(1, N_RANKS + 1) / (N_RANKS + 1)
    counts = np.cumsum(np.bincount(ranks, minlength=N_RANKS + 1))[:-1]
    two = 2 * np.minimum(stats.binom.cdf(counts, ranks.size, share), stats.binom.sf(counts - 1, ranks.size, share))
    return float(np.min(np.minimum(two, 1.0)))


def judge_ranks(rows: Iterable[dict[str, Any]]) -> dict[str, float]:
    """Probability of ranks at least as far from uniform, for each parameter."""
    good = [row for row in rows if "ranks" in row]
    _, _, smallest = envelope(len(good))
    out = {}
    for name in good[0]["ranks"]:
        seen = _smallest(np.array([row["ranks"][name] for row in good]))
        out[name] = float((1 + np.count_nonzero(smallest <= seen)) / (1 + smallest.size))
    return out


def failing(p_values: dict[str, float], level: float = 0.01) -> list[str]:
    """Parameters that are off, at a level that is corrected for their number (Bonferroni)."""
    return [name for name, p in p_values.items() if p <= level / len(p_values)]


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Coverage and uniformity as a Markdown table."""
    good = [row for row in rows if "ranks" in row]
    p_values = judge_ranks(rows)
    lines = ["| parameter | 50 % | 80 % | 90 % | 95 % | p of uniform ranks |", "|---|---|---|---|---|---|"]
    for name, p in p_values.items():
        below = np.array([row["below"][name] for row in good])
        held = [float(np.mean(np.abs(below - 0.5) <= level / 2)) for level in LEVELS]
        lines.append(f"| {name} | " + " | ".join(f"{100 * share:.1f} %" for share in held) + f" | {p:.3f} |")
    error = [100 * float(np.sqrt(level * (1 - level) / len(good))) for level in LEVELS]
    lines.append("| Monte-Carlo error | " + " | ".join(f"{e:.1f} %" for e in error) + " | |")
    return "\n".join(lines)


def picture(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Rank histograms above, cumulative histograms minus the diagonal with their envelopes below."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    good = [row for row in rows if "ranks" in row]
    low, high, _ = envelope(len(good))
    share = np.arange(1, N_RANKS + 1) / (N_RANKS + 1)
    names = list(good[0]["ranks"])
    figure = Figure(figsize=(2.0 * len(names), 4.2), layout="constrained")
    axes = figure.subplots(2, len(names), sharey="row")
    for i, name in enumerate(names):
        ranks = np.array([row["ranks"][name] for row in good])
        axes[0, i].hist(ranks, bins=np.linspace(0, N_RANKS + 1, 21), color="#5b7fa6")
        axes[0, i].axhline(len(good) / 20, color="black", linewidth=0.8)
        axes[0, i].set_title(name)
        counts = np.cumsum(np.bincount(ranks, minlength=N_RANKS + 1))[:-1]
        axes[1, i].fill_between(share, low / len(good) - share, high / len(good) - share, color="#d9d9d9")
        axes[1, i].plot(share, counts / len(good) - share, color="#b03a2e", drawstyle="steps-post")
        axes[1, i].set_xlabel("rank / 100")
    axes[0, 0].set_ylabel("draws")
    axes[1, 0].set_ylabel("cumulative share\nminus uniform")
    figure.savefig(path, dpi=110, metadata={"Software": None})


WORDS = {
    "device": (
        "Calibration of the device fit",
        """\
devices with parameters drawn from the priors `afc`, simulated with white and slow force noise and displacement noise,
averaged and sampled like a measured device.""",
        """\
The parameters of the noise are compared with the noise of the force channel alone. Those of a fit describe all that is
left over, so with displacement noise, which the model holds to first order, they are not judged;
`--displacement-noise 0` judges them too.""",
    ),
    "margins": (
        "Calibration of the prediction of a new device",
        "populations of Fy drawn from the population prior: five sets of two tested devices each, known to 2 %.",
        """\
All margins are quantiles of the predictive draws of a new device, so that its row is theirs. The truth is drawn from
the prior: this tests the model and its sampling, not the prior (that is what `benchmarks/population.py` does).""",
    ),
}


def page(rows: Sequence[dict[str, Any]], command: str, drawing: str, part: str, *, wobble_mm: float = 0.0) -> str:
    """Markdown page of a finished run."""
    title, drawn, remark = WORDS[part]
    good = [row for row in rows if "ranks" in row]
    failed = [row for row in rows if "error" in row]
    verdicts = {word: sum(row["verdict"] == word for row in good) for word in Trust}
    seconds = float(np.median([row["seconds"] for row in rows]))
    words = ", ".join(f"{count} {word}" for word, count in verdicts.items())
    off = [name for name in failing(judge_ranks(rows)) if name in LAW or not wobble_mm]
    judged = f"{', '.join(LAW)} pass." if wobble_mm else "Every parameter passes."
    verdict = f"FAILS: {', '.join(off)}." if off else judged
    lines = [
        f"# {title}",
        "",
        f"Printed by `{command}`: {len(rows)}",
        drawn,
        "Share of the draws in which the interval holds the true value:",
        "",
        table(rows),
        "",
        f"{verdict} A parameter fails when its ranks are further from uniform than in 1 % of correct runs, divided by",
        f"the number of parameters. Verdicts of the fits: {words}; {len(failed)} draws could not be fitted",
        f"(they are listed below). Median time of a fit: {seconds:.1f} s.",
        "",
        remark,
        "",
        f"![Rank histograms, and cumulative histograms with their 95 % envelopes]({drawing})",
        "",
        *(f"- draw {row['number']}: {row['error']}" for row in failed),
    ]
    return "\n".join(lines).rstrip() + "\n"


def noise_page(rows: Sequence[dict[str, Any]], command: str) -> str:
    """Markdown page of the part `noise`."""
    lines = [
        "# Calibration of the fit under several noises",
        "",
        f"Printed by `{command}`: {len(rows)} devices",
        "drawn from the priors `afc`. Share of the 90 % intervals that hold the true value, and in brackets the root",
        "mean square of (mean - truth) / sd; later ratios count as `ratio`.",
        "",
        *tables(rows),
        "",
        *(f"- draw {row['number']}: {row['error']}" for row in rows if "error" in row),
    ]
    return "\n".join(lines).rstrip() + "\n"


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="?", choices=tuple(DEFAULTS), default="noise", help="what is calibrated (noise)")
    parser.add_argument("-n", type=int, default=300, help="draws (300)")
    parser.add_argument("--seed", type=int, default=7000, help="stream of the draws (7000)")
    parser.add_argument("--effects", action="store_true", help="noise: a law with an effect")
    parser.add_argument("--rate", type=float, default=5.0, help="device: sampling rate, Hz (5)")
    parser.add_argument("--short", action="store_true", help="device: four cycles instead of Table 1")
    parser.add_argument("--broken", choices=BROKEN, default="", help="device: break one thing; the test must then fail")
    parser.add_argument("--displacement-noise", type=float, default=0.02, help="device: standard deviation, mm (0.02)")
    parser.add_argument("--max-steps", type=int, default=10_000, help="steps of a fit (10000)")
    parser.add_argument("--workers", type=int, default=0, help="processes, 0 for one per processor")
    parser.add_argument("-o", "--out", type=Path, default=ROOT / "reports", help="folder of the page (reports)")
    asked = parser.parse_args()
    kinds, options = [asked.part], {}
    if asked.part == "device":
        kinds = [asked.broken, "short" if asked.short else "", "" if asked.displacement_noise else "still"]
        options = {"rate_Hz": asked.rate, "short": asked.short, "broken": asked.broken, "max_steps": asked.max_steps}
        options["wobble_mm"] = asked.displacement_noise
    elif asked.part == "noise":
        kinds += ["effects"] if asked.effects else []
        options = {"effects": asked.effects, "max_steps": asked.max_steps}
    stem = "-".join(word for word in ("calibration", *kinds) if word)
    rows = run(asked.n, asked.seed, asked.out / f"{stem}.jsonl", part=asked.part, workers=asked.workers, **options)
    command = f"python -m shj_validation.calibrate {' '.join(sys.argv[1:])}".strip()
    if asked.part == "noise":
        text, good = noise_page(rows, command), True
    else:
        picture(rows, asked.out / f"{stem}.png")
        text = page(rows, command, f"{stem}.png", asked.part, wobble_mm=float(options.get("wobble_mm", 0.0)))
        every = asked.part != "device" or not asked.displacement_noise
        off = [name for name in failing(judge_ranks(rows)) if name in LAW or every]
        good = bool(off) == bool(asked.part == "device" and asked.broken)
    write_text(asked.out / f"{stem}.md", text)
    print(text)
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
