"""Development trials of the diagnosis: false alarms under several kinds of noise, and right names for each effect.

``python benchmarks/mismatch.py null -n 20`` and ``python benchmarks/mismatch.py names -n 3`` print the tables of
docs/decisions/0005-mismatch.md; ``outside`` tries effects that are not in the catalogue, ``pairs`` two at once,
``tables`` rediscovers the paper's devices without speed dependence in the law, ``flagship`` gives it prying that looks
like speed dependence, and the converse. The devices are those of `shj_validation.trials`, with development seeds: they
set thresholds and prove nothing. The proof, with other simulators and sealed keys, is a command of its own.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import DiagnosisResult, diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.recording import Recording
from shj_validation.trials import EFFECTS, NOISES, OUTSIDE, PAIRS, simulate


def main() -> None:
    """Run one table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("table", choices=["null", "names", "pairs", "outside", "tables", "flagship"])
    parser.add_argument("-n", type=int, default=3, help="trials for each line")
    parser.add_argument("--seed", type=int, default=1000, help="first development seed")
    parser.add_argument("--workers", type=int, default=2, help="processes at a time")
    parser.add_argument("--only", help="one line of the table")
    arguments = parser.parse_args()
    if arguments.table in ("tables", "flagship"):
        return _others(arguments)
    lines: dict[str, Callable[[int], str]]
    if arguments.table == "null":
        lines = {noise: partial(null_trial, noise) for noise in NOISES}
    elif arguments.table == "names":
        lines = {name: partial(effect_trial, (name,)) for name in EFFECTS}
    elif arguments.table == "pairs":
        lines = {" + ".join(pair): partial(effect_trial, pair) for pair in PAIRS}
    else:
        lines = {name: partial(outside_trial, name) for name in OUTSIDE}
    if arguments.only:
        lines = {arguments.only: lines[arguments.only]}
    seeds = range(arguments.seed, arguments.seed + arguments.n)
    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        for name, trial in lines.items():
            counts = Counter(pool.map(trial, seeds))
            print(f"{name:24}" + ", ".join(f"{n} x {words}" for words, n in counts.most_common()), flush=True)


def _others(arguments: argparse.Namespace) -> None:
    """Run one of the tables that stand in a file of their own."""
    import mismatch_paper  # noqa: PLC0415  (it imports this file)

    with ProcessPoolExecutor(arguments.workers, mp_context=get_context("spawn")) as pool:
        if arguments.table == "tables":
            mismatch_paper.tables(pool, arguments.seed, arguments.only)
        else:
            mismatch_paper.flagship(pool, arguments.n, arguments.seed, arguments.only)


def null_trial(noise: str, seed: int) -> str:
    """Verdict on a device without any effect."""
    return _verdict(simulate({}, seed, noise=noise), ())


def effect_trial(names: tuple[str, ...], seed: int) -> str:
    """Verdict on a device with effects of the catalogue."""
    return _verdict(simulate({name: EFFECTS[name] for name in names}, seed), names)


def outside_trial(name: str, seed: int) -> str:
    """Verdict on a device with an effect that the catalogue does not hold."""
    return _verdict(simulate({}, seed, shape=OUTSIDE[name]), ())


def look(recordings: list[Recording], without: tuple[str, ...] = ()) -> DiagnosisResult:
    """Take a first look at a device."""
    runs = runs_of(recordings)
    return diagnose(runs, DeviceModel(len(runs), read_priors("afc")), DiagnoseOptions(tuple(without), quick=True))


def _verdict(recordings: list[Recording], truth: tuple[str, ...]) -> str:
    """Outcome of a quick diagnosis in a few words: right name, right family, wrong, unknown, adequate."""
    record = look(recordings).content
    found = {effect["id"] for effect in record["effects"]}
    members = {member["id"] for member in record["family"]}
    if not truth:
        over = sorted({row["coordinate"] for row in record["coordinates"] if row["probability"] > 0.5})
        words = sorted(found) if record["verdict"] in ("named", "family") else [f"over {name}" for name in over]
        return f"{record['verdict']} ({', '.join(words)})" if words else str(record["verdict"])
    if record["verdict"] == "named" and found == set(truth):
        return "right name"
    if record["verdict"] == "family" and set(truth) <= found | members:
        return "right family"
    return f"{record['verdict']} ({', '.join(sorted(found)) or 'nothing'})"


if __name__ == "__main__":
    main()
