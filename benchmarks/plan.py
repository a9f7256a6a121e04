"""Sealed trials of the planned test: devices of the proof's simulators, one run of Table 1, then a second test.

``python benchmarks/plan.py which -n 12`` draws devices whose effect one run of Table 1 leaves undecided (largest
probability below 95 % among the rivals of its group) and gives each a planned second test, Table 1 again and an
expert's fixed second test, in the same minutes: the name that is then the most probable, the probability of the
truth, and the probability that was foreseen. ``python benchmarks/plan.py gamma -n 20`` compares the foreseen standard
deviation of gamma with the one after the test, ``least`` that of the smallest plateau force. Rivals are fitted anew to
both tests together, in the ways that fit both; ``--diagnose`` runs the whole diagnosis (first look) instead. Each trial
is a line of ``build/plan/*.jsonl``; ``--first`` goes on behind trials that are done, ``--table`` prints what is
there, or the trials of a file, and draws what was foreseen against what came (``reports/plan.png``). ``paper`` takes
the paper's case: speed or prying, after one run of Table 1, and what 20 more minutes are worth.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from scipy.stats import binomtest

from shj_bayes.errors import ShjError
from shj_bayes.inference.run import runs_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.look import Look
from shj_bayes.mismatch.search import MATTERS
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.planning.candidates import proposals
from shj_bayes.planning.foresight import quantity_of
from shj_bayes.planning.known import Key as Set
from shj_bayes.planning.known import Known, Subject, class_of, common_scales, know
from shj_bayes.planning.plan import Question, make_plan
from shj_bayes.planning.proposals import within
from shj_bayes.planning.protocol import Block, Protocol, Waveform
from shj_bayes.planning.questions import quantity_named
from shj_bayes.planning.rig import Rig
from shj_bayes.recording.recording import Recording
from shj_validation.proof.cases import Key, development_keys, stated_key
from shj_validation.proof.make import make
from shj_validation.proof.protocols import IMPROVED, Course
from shj_validation.proof.simulators.simulator import simulators_by_id

ROOT = Path(__file__).resolve().parents[1]
BUILD, PICTURE = ROOT / "build" / "plan", ROOT / "reports" / "plan.png"
TESTS = {"planned": "#0b5394", "table 1": "#b45f06", "expert": "#666666"}
RATE_HZ, FINE = 10.0, 10
SPEED_MM_S = 40.0
# What one run of Table 1 hides, by groups of rivals; the simulator's own class is the right answer.
GROUPS = {
    "slow": (
        ("wear_saturating", "wear_power", "thermal", "amplitude", "bedding_in"),
        ("capacity over travel", "capacity over heat", "capacity over amplitude", "capacity over time"),
    ),
    "speed or place": (
        ("prying", "prying_quadratic", "stribeck", "velocity_law"),
        ("capacity over distance", "capacity over speed", "capacity over slip"),
    ),
    "sides": (
        ("asymmetry", "load_offset", "taper"),
        ("capacity over direction", "added over constant", "capacity over position"),
    ),
    "start of stroke": (("slack", "two_stage"), ("motion over slack", "motion over second surface")),
}
BINS, LEAST = (0.9, 0.95, 0.98, 0.995), 1e-3  # of the chance foreseen; smallest probability that is drawn
# Of the largest size that the proof conceals: what one run may leave undecided.
SHARE, SMALL = (0.03, 0.25), {"speed or place": (0.005, 0.05)}
CONSTANT = "load_offset"  # of less than matters it is an error of the load cell's zero, not an effect


def main() -> None:
    """Run the trials of one question."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("question", choices=("which", "gamma", "least", "paper"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("-n", "--n", type=int, default=8, help="trials that count")
    parser.add_argument("--first", type=int, default=1, help="number of the first device that is drawn")
    parser.add_argument("--group", choices=tuple(GROUPS), help="devices of one group only")
    parser.add_argument("--diagnose", action="store_true", help="the whole diagnosis after each second test")
    parser.add_argument("--table", nargs="?", const="", metavar="FILE", help="print what is there and run nothing")
    asked = parser.parse_args()
    if asked.question == "paper":
        paper()
        return
    BUILD.mkdir(parents=True, exist_ok=True)
    path = BUILD / f"{asked.question}-seed{asked.seed}{'-diagnosed' if asked.diagnose else ''}.jsonl"
    if asked.table is None:
        with path.open("a", encoding="utf-8") as file:
            counted = 0
            for number in range(asked.first, asked.first + 20 * asked.n):
                if asked.group not in (None, list(GROUPS)[number % len(GROUPS)]):
                    continue
                row = trial(asked.seed, number, asked.question, whole=asked.diagnose)
                counted += row["outcome"] == "counted"
                file.write(json.dumps(row, allow_nan=False) + "\n")
                file.flush()
                print(line(row), flush=True)
                if counted >= asked.n:
                    break
    rows = [json.loads(text) for text in Path(asked.table or path).read_text(encoding="utf-8").splitlines()]
    rows = [r for r in rows if r.get("question", asked.question) == asked.question]
    print(table(rows, asked.question))
    if asked.table is not None and asked.question == "which":
        draw(rows, PICTURE)


def key_of(seed: int, number: int) -> tuple[Key, str]:
    """Draw the device of a trial and the group of its effect: groups in turn, effects within them in turn."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77, number)))
    group = list(GROUPS)[number % len(GROUPS)]
    names = GROUPS[group][0]
    name = names[(number // len(GROUPS)) % len(names)]
    key = development_keys(7000 + seed, number, "one", effect=name, rate_Hz=RATE_HZ)[-1]
    effect = key.effects[0]
    largest = simulators_by_id()[effect.id].sizes[1]
    low, high = largest * np.array(SMALL.get(group, SHARE))
    low = max(low, MATTERS) if name == CONSTANT else low
    size = float(np.sign(effect.size) * np.exp(rng.uniform(np.log(low), np.log(high))))
    return replace(key, protocol="paper", effects=(replace(effect, size=size),)), group


def trial(seed: int, number: int, question: str, *, whole: bool) -> dict[str, Any]:
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
        row |= _trial(key, group, seed, number, question, whole=whole)
    except (ShjError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
        row |= {"outcome": "failed", "reason": f"{type(error).__name__}: {error}"}
    return row | {"processor_s": time.process_time() - begin}


def _trial(key: Key, group: str, seed: int, number: int, question: str, *, whole: bool) -> dict[str, Any]:
    first = make(key)[:1]
    runs = runs_of([first[0].recording])
    minutes = first[0].recording.duration_s / 60.0
    force = 1.3 * float(np.abs(first[0].recording.force_kN).max())
    rig = Rig(95.0, SPEED_MM_S, force, minutes + 0.1, RATE_HZ)
    device = DeviceModel(1, read_priors("afc"), variant=key.reversal)
    rivals: tuple[tuple[Set, float], ...] = (*((frozenset({c}), 1.0) for c in GROUPS[group][1]), (frozenset(), 1.0))
    truth = {f"{a} over {c}" for a, c in _classes(key)}
    expert = Protocol("expert", within([Block(a, v, n, Waveform.SINE, r) for a, v, n, r in IMPROVED], rig))
    candidates = proposals(rig, seed, (expert,))
    scales = common_scales(runs, candidates)
    tested = Subject("device", runs, device, rivals, frozenset({"velocity"}), untold=True)
    known = know(tested, scales)
    now = known.probabilities
    before = {"before": max(now.values()), "truth_before": sum(p for k, p in now.items() if k & truth)}
    if question == "which" and max(now.values()) >= 0.95:
        return before | {"outcome": "decided"}
    quantity = None if question == "which" else quantity_named(known, question)
    quantities = () if quantity is None else (quantity,)
    plan = make_plan([known], candidates, Question(question, quantities), seed=number, rehearsals=0)
    out: dict[str, Any] = before | {"outcome": "counted", "tests": {}}
    for name, r in zip(TESTS, (plan.best[0], *plan.compared), strict=True):
        recording, seen = _second(key, r.protocol), r.foreseen[0]
        one: dict[str, Any] = {
            "protocol": r.protocol.name,
            "minutes": r.protocol.duration_s / 60.0,
            "foreseen": seen.of_truth,
            "right_foreseen": seen.right,
        }
        if whole:
            both = runs_of([first[0].recording, recording])
            record = diagnose(both, replace(device, n_runs=2), Look(quick=True)).record
            sets = [(set(s["classes"]), s["probability"]) for s in record["sets"]]
            one |= {"verdict": record["verdict"], "truth": sum(p for c, p in sets if c & truth)}
            one["right"] = bool(sets and sets[0][0] & truth)
        else:
            then = _weighed(tested, [first[0].recording, recording], scales)
            p = then.probabilities
            one["truth"] = sum(v for k, v in p.items() if k & truth)
            one["right"] = bool(max(p, key=lambda k: p[k]) & truth)
            if quantity is not None:
                one |= {
                    "sd_foreseen": seen.sd,
                    "sd": quantity_of(then, quantity.unit, quantity.value).now(then.beliefs)[1],
                    "sd_before": quantity.now(known.beliefs)[1],
                }
        out["tests"][name] = one
    return out


def paper(sizes: Sequence[float] = (0.005, 0.05), minutes: float = 20.0) -> None:
    """Print whether it is speed or prying after one run of Table 1, and what further minutes are worth."""
    for size in sizes:
        key = stated_key("prying", size, seed=4, rate_Hz=RATE_HZ, gamma=0.0)
        recording = make(key)[0].recording
        runs = runs_of([recording])
        rig = Rig(95.0, SPEED_MM_S, 1.3 * float(np.abs(recording.force_kN).max()), minutes, RATE_HZ)
        candidates = proposals(rig, 1)
        rivals = ((class_of("velocity"), 0.5), (class_of("prying"), 0.5))
        scales = common_scales(runs, candidates)
        device = DeviceModel(1, read_priors("afc"), variant=key.reversal)
        tested = Subject("device", runs, device, rivals, frozenset({"velocity"}), untold=True)
        known = know(tested, scales)
        gamma = quantity_named(known, "gamma")
        mean, sd = gamma.now(known.beliefs)
        prying = 100 * known.probabilities.get(class_of("prying"), 0.0)
        print(f"prying of {100 * size:.1f} %: after Table 1 {prying:.1f} %, gamma {mean:.5f} +- {sd:.5f} s/mm")
        plan = make_plan([known], candidates, Question("gamma", (gamma,)), rehearsals=0)
        for r in (*plan.best[:1], *plan.compared):
            then = _weighed(tested, [recording, _second(key, r.protocol)], scales)
            named, seen = 100 * then.probabilities.get(class_of("prying"), 0.0), r.foreseen[0].sd
            after = quantity_of(then, gamma.unit, gamma.value).now(then.beliefs)[1]
            print(
                f"  {r.protocol.name}, {r.protocol.duration_s / 60:.1f} min: prying {named:.1f} %, sd of gamma "
                f"{after:.6f} s/mm (foreseen {seen:.6f})"
            )
            print(
                "   ",
                ", ".join(f"{b.amplitude_mm:g} mm {b.speed_mm_s:.3g} mm/s {b.cycles}x" for b in r.protocol.blocks),
            )


def _weighed(tested: Subject, recordings: Sequence[Recording], scales: Mapping[str, Any]) -> Known:
    """Fit the rivals to both tests, in the ways that fit them both."""
    device = replace(tested.device, n_runs=len(recordings))
    return know(replace(tested, runs=runs_of(recordings), device=device), scales)


def _classes(key: Key) -> tuple[tuple[str, str], ...]:
    return simulators_by_id()[key.effects[0].id].coordinates


def _second(key: Key, protocol: Protocol) -> Recording:
    """Record the second test of a device, with its own noise."""
    time_s, motion = protocol.sampled(RATE_HZ * FINE)
    return make(key, then=[Course(time_s, motion.displacement_mm, FINE)])[1].recording


def line(row: dict[str, Any]) -> str:
    """One trial in one line."""
    head = f"{row['number']:4} {row['group']:16} {row['effect']:18} {row['size']:+8.3g} {row['outcome']:8}"
    tests = row.get("tests", {})
    body = "; ".join(f"{k} {100 * t['truth']:.1f} % ({100 * t['foreseen']:.1f})" for k, t in tests.items())
    if "sd" in tests.get("planned", {}):
        body += "; sd " + ", ".join(f"{t['sd']:.3g} ({t['sd_foreseen']:.3g})" for t in tests.values())
    before, seconds = f"{100 * row.get('truth_before', 0):5.1f} %", f"{row['processor_s']:.0f} s"
    return f"{head} before {before} | {body or row.get('reason', '')} | {seconds}"


def table(rows: Sequence[dict[str, Any]], question: str) -> str:
    """Sum the trials up."""
    counted = [r for r in rows if r["outcome"] == "counted"]
    others = {o: sum(r["outcome"] == o for r in rows) for o in ("decided", "failed")}
    lines = [
        f"n = {len(counted)}; {others['decided']} more were decided by the first test, {others['failed']} failed",
        f"{'second test':12} {'right':>11} {'95 % interval':>16} {'truth':>8} {'foreseen':>9} {'right foreseen':>15} "
        f"{'minutes':>8}",
    ]
    for name in TESTS:
        own = [r["tests"][name] for r in counted]
        if not own:
            continue
        mean = {k: float(np.mean([t[k] for t in own])) for k in ("truth", "foreseen", "right_foreseen", "minutes")}
        right = sum(t["right"] for t in own)
        lines.append(
            f"{name:12} {right:4} of {len(own):3} {share(right, len(own))} "
            f"{100 * mean['truth']:7.1f}% {100 * mean['foreseen']:8.1f}% "
            f"{100 * mean['right_foreseen']:14.1f}% {mean['minutes']:8.1f}"
        )
        if question != "which":
            ratio = np.array([t["sd"] / t["sd_foreseen"] for t in own])
            near = int(np.sum((ratio > 0.8) & (ratio < 1.25)))
            narrower = float(np.median([t["sd"] / t["sd_before"] for t in own]))
            low, high = np.quantile(ratio, [0.05, 0.95])
            lines.append(
                f"{'':12} sd after / foreseen: median {np.median(ratio):.3f}, 5 to 95 % {low:.3f} to {high:.3f}; "
                f"within 20 % in {near} of {ratio.size}; after / before {narrower:.3f}"
            )
    for group in GROUPS:
        own = [r for r in counted if r["group"] == group]
        if any(r["group"] == group for r in rows):
            hits = ", ".join(f"{k} {sum(r['tests'][k]['right'] for r in own)}" for k in TESTS)
            wrong = sum(r["outcome"] == "decided" and r["truth_before"] < 0.5 for r in rows if r["group"] == group)
            decided = sum(r["outcome"] == "decided" for r in rows if r["group"] == group)
            lines.append(f"  {group}: right of {len(own)}: {hits}; decided before {decided}, {wrong} of them wrongly")
    return "\n".join(lines)


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
        before = np.array([max(r["truth_before"], LEAST) for r in counted])
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
