"""Sealed trials of the planned test: devices of the proof's simulators, one run of Table 1, then a second test.

``python benchmarks/plan.py which -n 60`` takes the way of a user: a device is tested once with Table 1 and diagnosed
(first look); where something matters and the answer is undecided, the next test is planned from it. The planned test,
Table 1 again and an expert's fixed test, in the same minutes, are then recorded, and each is diagnosed together with
the first. Counted is the set of classes that is then the most probable, its probability, and what was foreseen.
``python benchmarks/plan.py gamma -n 40`` compares the foreseen standard deviation of gamma with the one after the test,
``least`` that of the smallest plateau force, over the sets of the first diagnosis fitted anew to both tests. Each trial
is a line of ``build/plan/*.jsonl``; ``--first`` goes on behind trials that are done, ``--table`` prints what is
there, or the trials of a file, and draws what was foreseen against what came (``reports/plan.png``). ``paper`` takes
the paper's case: speed or prying, after one run of Table 1, and what 20 more minutes are worth.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binomtest

from shj_bayes.errors import ShjError
from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.hypothesis import ALPHA
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.planning.information import quantity_named, quantity_of
from shj_bayes.planning.plan import make_plan
from shj_bayes.planning.protocol import Protocol, ProtocolBlock, Rig, Waveform, proposals, within
from shj_bayes.planning.rivals import (
    DeviceUnderTest,
    PretestPosterior,
    class_of,
    common_scales,
    linearise,
)
from shj_bayes.planning.rivals import Key as Set
from shj_bayes.recording.recording import Recording
from shj_validation.proof.cases import Key, development_keys, stated_key
from shj_validation.proof.make import make
from shj_validation.proof.protocols import IMPROVED, Course
from shj_validation.proof.simulators.simulator import simulators_by_id
from shj_validation.proof.truth import truth_of

ROOT = Path(__file__).resolve().parents[1]
BUILD, PICTURE = ROOT / "build" / "plan", ROOT / "reports" / "plan.png"
TESTS = {"planned": "#0b5394", "table 1": "#b45f06", "expert": "#666666"}
RATE_HZ, FINE = 10.0, 10
SPEED_MM_S = 40.0
# What one run of Table 1 hides, in groups of effects that look alike in it.
GROUPS = {
    "slow": ("wear_saturating", "wear_power", "thermal", "amplitude", "bedding_in"),
    "speed or place": ("prying", "prying_quadratic", "stribeck", "velocity_law"),
    "sides": ("asymmetry", "load_offset", "taper"),
    "start of stroke": ("slack", "two_stage"),
}
SHARE = (0.03, 0.15)  # of the largest size that the proof conceals: what one run may leave undecided
BATCH = 16
BINS, LEAST = (0.9, 0.95, 0.98, 0.995), 1e-3  # of the chance foreseen; smallest probability that is drawn


def main() -> None:
    """Run the trials of one question."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("question", choices=("which", "gamma", "least", "paper"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-n", "--n", type=int, default=8, help="trials that count")
    parser.add_argument("--first", type=int, default=1, help="number of the first device that is drawn")
    parser.add_argument("--group", choices=tuple(GROUPS), help="devices of one group only")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    parser.add_argument("--table", nargs="?", const="", metavar="FILE", help="print what is there and run nothing")
    asked = parser.parse_args()
    if asked.question == "paper":
        paper()
        return
    BUILD.mkdir(parents=True, exist_ok=True)
    path = BUILD / f"{asked.question}-seed{asked.seed}.jsonl"
    if asked.table is None:
        wanted = [k for k in range(asked.first, asked.first + 40 * asked.n) if asked.group in (None, group_of(k))]
        counted = 0
        with (
            path.open("a", encoding="utf-8") as file,
            ProcessPoolExecutor(asked.workers, mp_context=get_context("spawn")) as pool,
        ):
            # in short batches, so that few devices are drawn beyond the last that counts
            for at in range(0, len(wanted), BATCH):
                if counted >= asked.n:
                    break
                for row in pool.map(partial(trial, asked.seed, question=asked.question), wanted[at : at + BATCH]):
                    counted += row["outcome"] == "counted"
                    file.write(json.dumps(row, allow_nan=False) + "\n")
                    file.flush()
                    print(line(row), flush=True)
    rows = [json.loads(text) for text in Path(asked.table or path).read_text(encoding="utf-8").splitlines()]
    rows = [r for r in rows if r.get("question", asked.question) == asked.question]
    print(table(rows, asked.question))
    if asked.table is not None and asked.question == "which":
        draw(rows, PICTURE)


def group_of(number: int) -> str:
    """Group of a device: in turn."""
    return list(GROUPS)[number % len(GROUPS)]


def key_of(seed: int, number: int) -> tuple[Key, str]:
    """Draw the device of a trial and the group of its effect: groups in turn, effects within them in turn."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77, number)))
    group = group_of(number)
    names = GROUPS[group]
    name = names[(number // len(GROUPS)) % len(names)]
    key = development_keys(7000 + seed, number, "one", effect=name, rate_Hz=RATE_HZ)[-1]
    effect = key.effects[0]
    largest = simulators_by_id()[effect.id].sizes[1]
    low, high = largest * np.array(SHARE)
    size = float(np.sign(effect.size) * np.exp(rng.uniform(np.log(low), np.log(high))))
    return replace(key, protocol="paper", effects=(replace(effect, size=size),)), group


def trial(seed: int, number: int, question: str) -> dict[str, Any]:
    """Make a device, plan its second test, run the three second tests and judge them."""
    key, group = key_of(seed, number)
    effect = key.effects[0]
    row: dict[str, Any] = {
        "question": question,
        "number": number,
        "group": group,
        "effect": effect.id,
        "size": effect.size,
    }
    begin = time.process_time()
    try:
        row |= _trial(key, seed, number, question)
    except (ShjError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        row |= {"outcome": "failed", "reason": f"{type(error).__name__}: {error}"}
    return row | {"processor_s": time.process_time() - begin}


def _trial(key: Key, seed: int, number: int, question: str) -> dict[str, Any]:
    if question == "which" and not truth_of(key).required:
        return {"outcome": "small"}
    first = make(key)[0].recording
    device = DeviceModel(1, read_priors("afc"), variant=key.reversal)
    truth = {f"{a} over {c}" for a, c in simulators_by_id()[key.effects[0].id].coordinates}
    found = _diagnosed([first], device, truth)
    out: dict[str, Any] = {"before": found.told()}
    if question == "which" and not found.undecided:
        return out | {"outcome": "decided"}
    minutes = first.duration_s / 60.0
    rig = Rig(95.0, SPEED_MM_S, 1.3 * float(np.abs(first.force_kN).max()), minutes + 0.1, RATE_HZ)
    expert = Protocol("expert", within([ProtocolBlock(a, v, n, Waveform.SINE, r) for a, v, n, r in IMPROVED], rig))
    proposed = proposals(rig)
    runs = runs_of([first])
    scales = common_scales(runs, rig, (*proposed, expert))
    tested = DeviceUnderTest("device", runs, device, found.sets, DiagnoseOptions(quick=True).hidden(device))
    known = linearise(tested, scales)
    quantity = None if question == "which" else quantity_named(known, question)
    quantities = () if quantity is None else (quantity,)
    plan = make_plan([known], rig, proposed, (expert,), question=question, quantities=quantities, seed=number)
    if not plan.best:
        return out | {"outcome": "none"}
    out |= {"outcome": "counted", "tests": {}}
    protocols, rows = (plan.best[0], proposed[0], expert), (plan.record.candidates[0], *plan.record.compared)
    for name, protocol, r in zip(TESTS, protocols, rows, strict=True):
        both = [first, _second(key, protocol)]
        one: dict[str, Any] = {
            "protocol": r.name,
            "minutes": r.minutes,
            "foreseen": r.probability_of_truth,
            "right_foreseen": r.chance_right,
        }
        if quantity is None:
            one |= _diagnosed(both, device, truth).told()
        else:
            then = _weighed(tested, both, scales)
            one |= {
                "sd_foreseen": r.sd,
                "sd": quantity_of(then, quantity.unit, quantity.value).now(then)[1],
                "sd_before": quantity.now(known)[1],
            }
        out["tests"][name] = one
    return out


@dataclass(frozen=True)
class Diagnosed:
    """What a first look at the tests of a device says."""

    verdict: str
    sets: tuple[tuple[Set, float], ...]  # what the device may be, most probable first
    truth: frozenset[str]  # classes that are right: one of them and nothing else

    @property
    def undecided(self) -> bool:
        """Whether something matters and no class is there with 95 %."""
        there = [sum(p for key, p in self.sets if c in key) for c in frozenset().union(*(key for key, _ in self.sets))]
        return self.verdict != "adequate" and max(there, default=0.0) < 1.0 - ALPHA

    def told(self) -> dict[str, Any]:
        """Plain values."""
        true = [len(key) == 1 and key <= self.truth for key, _ in self.sets]
        return {
            "verdict": self.verdict,
            "sets": [[sorted(key), p] for key, p in self.sets[:4]],
            "truth": sum(p for (_, p), right in zip(self.sets, true, strict=True) if right),
            "right": true[0],
        }


def _diagnosed(recordings: Sequence[Recording], device: DeviceModel, truth: set[str]) -> Diagnosed:
    record = diagnose(
        runs_of(list(recordings)), replace(device, n_runs=len(recordings)), DiagnoseOptions(quick=True)
    ).content
    sets = tuple((frozenset(s["classes"]), float(s["probability"])) for s in record["sets"])
    return Diagnosed(str(record["verdict"]), sets or ((frozenset(), 1.0),), frozenset(truth))


def paper(sizes: Sequence[float] = (0.005, 0.05), minutes: float = 20.0) -> None:
    """Print whether it is speed or prying after one run of Table 1, and what further minutes are worth."""
    for size in sizes:
        key = stated_key("prying", size, seed=4, rate_Hz=RATE_HZ, gamma=0.0)
        recording = make(key)[0].recording
        runs = runs_of([recording])
        rig = Rig(95.0, SPEED_MM_S, 1.3 * float(np.abs(recording.force_kN).max()), minutes, RATE_HZ)
        proposed = proposals(rig)
        rivals = ((class_of("velocity"), 0.5), (class_of("prying"), 0.5))
        scales = common_scales(runs, rig, proposed)
        device = DeviceModel(1, read_priors("afc"), variant=key.reversal)
        tested = DeviceUnderTest("device", runs, device, rivals, frozenset({"velocity"}), untold=True)
        known = linearise(tested, scales)
        gamma = quantity_named(known, "gamma")
        mean, sd = gamma.now(known)
        prying = 100 * known.probabilities.get(class_of("prying"), 0.0)
        print(f"prying of {100 * size:.1f} %: after Table 1 {prying:.1f} %, gamma {mean:.5f} +- {sd:.5f} s/mm")
        plan = make_plan([known], rig, proposed, question="gamma", quantities=(gamma,))
        rows = zip((*plan.best[:1], proposed[0]), (*plan.record.candidates[:1], *plan.record.compared), strict=True)
        for protocol, r in rows:
            then = _weighed(tested, [recording, _second(key, protocol)], scales)
            named = 100 * then.probabilities.get(class_of("prying"), 0.0)
            after = quantity_of(then, gamma.unit, gamma.value).now(then)[1]
            print(
                f"  {r.name}, {r.minutes:.1f} min: prying {named:.1f} %, sd of gamma "
                f"{after:.6f} s/mm (foreseen {r.sd:.6f})"
            )
            print(
                "   ",
                f"{r.times} times",
                ", ".join(f"{b.amplitude_mm:g} mm {b.speed_mm_s:.3g} mm/s {b.cycles}x" for b in r.blocks),
            )


def _weighed(tested: DeviceUnderTest, recordings: Sequence[Recording], scales: Mapping[str, Any]) -> PretestPosterior:
    """Fit the rivals to both tests, in the ways that fit them both."""
    device = replace(tested.device, n_runs=len(recordings))
    return linearise(replace(tested, runs=runs_of(recordings), device=device), scales)


def _second(key: Key, protocol: Protocol) -> Recording:
    """Record the second test of a device, with its own noise."""
    time_s, motion = protocol.sampled(RATE_HZ * FINE)
    return make(key, then=[Course(time_s, motion.displacement_mm, FINE)])[1].recording


def line(row: dict[str, Any]) -> str:
    """One trial in one line."""
    head = f"{row['number']:4} {row['group']:16} {row['effect']:22} {row['size']:+8.3g} {row['outcome']:8}"
    tests = row.get("tests", {})
    body = "; ".join(
        f"{k} sd {t['sd']:.3g} ({t['sd_foreseen']:.3g})"
        if "sd" in t
        else f"{k} {t['verdict']} {100 * t['truth']:.1f} % ({100 * t['foreseen']:.1f})"
        for k, t in tests.items()
    )
    was = row.get("before", {})
    before = f"{was.get('verdict', '')} {100 * was.get('truth', 0):5.1f} %"
    seconds = f"{row['processor_s']:.0f} s"
    return f"{head} before {before} | {body or row.get('reason', '')} | {seconds}"


def table(rows: Sequence[dict[str, Any]], question: str) -> str:
    """Sum the trials up."""
    counted = [r for r in rows if r["outcome"] == "counted"]
    decided = [r for r in rows if r["outcome"] == "decided"]
    small, failed = (sum(r["outcome"] == o for r in rows) for o in ("small", "failed"))
    lines = [
        f"n = {len(counted)}; {len(decided)} more were decided by the first test; what {small} others conceal does "
        f"not matter or cannot be seen; {failed} failed"
    ]
    for name in TESTS:
        own = [r["tests"][name] for r in counted]
        if own:
            lines.append(f"{name:12} " + (named if question == "which" else widths)(own))
    if question == "which":
        for group in GROUPS:
            own, before = [r for r in counted if r["group"] == group], [r for r in decided if r["group"] == group]
            hits = ", ".join(f"{k} {sum(r['tests'][k]['right'] for r in own)}" for k in TESTS)
            wrong = sum(not r["before"]["right"] for r in before)
            lines.append(
                f"  {group}: right of {len(own)}: {hits}; decided before {len(before)}, {wrong} of them wrongly"
            )
    return "\n".join(lines)


def named(own: Sequence[dict[str, Any]]) -> str:
    """Sum up the diagnoses after one second test."""
    mean = {k: 100 * float(np.mean([t[k] for t in own])) for k in ("truth", "foreseen", "right_foreseen", "minutes")}
    right, sure = sum(t["right"] for t in own), [t for t in own if t["sets"] and t["sets"][0][1] >= 1.0 - ALPHA]
    return (
        f"right in {right} of {len(own)} ({share(right, len(own))} %), foreseen {mean['right_foreseen']:.1f} %; "
        f"truth {mean['truth']:.1f} %, foreseen {mean['foreseen']:.1f} %; decided {len(sure)}, "
        f"{sum(not t['right'] for t in sure)} of them wrongly; {mean['minutes'] / 100:.1f} minutes"
    )


def widths(own: Sequence[dict[str, Any]]) -> str:
    """Hold the standard deviations after one second test against those foreseen."""
    ratio = np.array([t["sd"] / t["sd_foreseen"] for t in own])
    near = int(np.sum((ratio > 0.8) & (ratio < 1.25)))
    narrower = float(np.median([t["sd"] / t["sd_before"] for t in own]))
    low, high = np.quantile(ratio, [0.05, 0.95])
    return (
        f"sd after / foreseen: median {np.median(ratio):.3f}, 5 to 95 % {low:.3f} to {high:.3f}; "
        f"within 20 % in {near} of {ratio.size}; after / before {narrower:.3f}"
    )


def share(k: int, n: int) -> str:
    """Wilson 95 % interval of a share, in per cent."""
    low, high = binomtest(k, n).proportion_ci(method="wilson")
    return f"{100 * low:6.1f} to {100 * high:5.1f}"


def draw(rows: Sequence[dict[str, Any]], path: Path) -> None:
    """Draw the share that was right over the chance foreseen, and the gain in log probability of the truth."""
    counted = [r for r in rows if r["outcome"] == "counted"]
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
    for i, (name, colour) in enumerate(TESTS.items()):
        own = [r["tests"][name] for r in counted]
        chance, hit = np.array([[t["right_foreseen"], t["right"]] for t in own]).T
        of = np.digitize(chance, BINS)
        for k in np.unique(of):
            n, hits = int(np.sum(of == k)), int(hit[of == k].sum())
            low, high = binomtest(hits, n).proportion_ci(method="wilson")
            at = 100 * float(chance[of == k].mean()) + 0.12 * (i - 1)
            left.plot([at, at], [100 * low, 100 * high], color=colour, lw=1)
            left.plot(at, 100 * hits / n, "o", color=colour, ms=3 + n**0.5, label=name if k == of.max() else None)
        before = np.array([max(r["before"]["truth"], LEAST) for r in counted])
        foreseen, came = (np.log([max(t[k], LEAST) for t in own] / before) for k in ("foreseen", "truth"))
        right.plot(foreseen, came, "o", color=colour, ms=4, alpha=0.7, label=f"{name}, mean {came.mean():+.2f}")
    for axis, what in ((left, "right [%]"), (right, "gain in log probability of the truth [nats]")):
        low, high = axis.get_xlim()
        axis.plot([low, high], [low, high], color="black", lw=0.8, zorder=0)
        axis.set(xlabel=f"foreseen: {what}", ylabel="what came")
        axis.legend(frameon=False, fontsize=8)
    left.set_ylim(0, 102)
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    main()
