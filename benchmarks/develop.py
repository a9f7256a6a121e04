"""Development trials of the diagnosis: the simulators of the proof, seeds of development, one line a trial.

``python benchmarks/develop.py --kind one -n 20`` takes a first look at 20 devices that hold one effect each and prints
what is concealed, the verdict, the coordinates with their probabilities, the names and the seconds of processor time;
then a table. ``--effect wear`` holds the forms of wear in turn, ``--effect wear_power`` one form. Trial i of a seed is
the same whatever ``-n`` is; ``--first`` goes on behind trials that are done. Every trial is a line of
``build/develop/*.jsonl``, with its key. The figures set thresholds and prove nothing.

``--others`` draws as a proof does: triangles, ramps with rests, several speeds, earthquakes, cycles about an offset;
hum, noise that grows with the force; 5 to 1000 Hz; displacement at the machine. Without it Table 1 and a test of
several speeds, as the earlier kind of proof. ``--protocol`` and ``--noise`` choose among all. ``--first-off`` puts the
first force reading of each run three standard deviations off.
``--without split_curve`` leaves a move of the search out: what it is worth. ``--table FILE...`` prints the tables of
trials that are done: by effect; by protocol and noise false alarms, coordinates, and the error on cycles left out
before and after.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.errors import ShjError
from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch import search
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.moves import LAST_MOVES
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_validation.proof.cases import DESIGNS, KINDS, PROOF_1, PROOF_2, Key, canonical, development_keys
from shj_validation.proof.make import make
from shj_validation.proof.noise import ALL_NOISES
from shj_validation.proof.protocols import PEAK_SPEED_MM_S
from shj_validation.proof.score import coordinate_right, outcome, rate
from shj_validation.proof.simulators.simulator import simulators_by_id
from shj_validation.proof.summary import RIGHT_OUTCOMES
from shj_validation.proof.truth import truth_of

BUILD = Path(__file__).resolve().parents[1] / "build" / "develop"
LAST = {move.__name__: move for move in LAST_MOVES}
MOVES = ("try_constant", "replace_by_formula", "drop_one", "follow_bends", "refit_noise", *LAST)
KEPT = ("verdict", "reason", "p_value", "coordinates", "effects", "family", "before", "after")


def main() -> None:
    """Run the trials of one kind."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seed", type=int, default=1, help="of development")
    parser.add_argument("-n", "--n", type=int, default=10, help="number of trials")
    parser.add_argument("--first", type=int, default=1, help="number of the first trial")
    parser.add_argument("--kind", choices=KINDS, default="one", help="what the trials hold")
    parser.add_argument("--effect", help="simulator, or effect whose forms are taken in turn")
    parser.add_argument("--rate", type=float, help="sampling rate, Hz; drawn if not given")
    parser.add_argument("--others", action="store_true", help="what a proof draws from, not its earlier kind")
    parser.add_argument("--protocol", action="append", choices=PEAK_SPEED_MM_S, help="to draw from; may be repeated")
    parser.add_argument("--noise", action="append", choices=ALL_NOISES, help="to draw from; may be repeated")
    parser.add_argument("--first-off", action="store_true", help="first force reading of each run three deviations off")
    parser.add_argument("--without", action="append", choices=MOVES, default=[], help="moves to leave out")
    parser.add_argument(
        "--table", type=Path, nargs="+", metavar="FILE", help="print the tables of trials that are done"
    )
    arguments = parser.parse_args()
    if arguments.table:
        done = [json.loads(text) for path in arguments.table for text in path.read_text().splitlines()]
        print(tables(list({canonical(row["key"]): row for row in done}.values())))  # of a trial made again the last
        return
    usual = DESIGNS[PROOF_2 if arguments.others else PROOF_1]
    protocols, noises = arguments.protocol or usual.protocols, arguments.noise or usual.noises
    keys = development_keys(
        arguments.seed,
        arguments.n,
        arguments.kind,
        effect=arguments.effect,
        rate_Hz=arguments.rate,
        design=replace(usual, protocols=protocols, noises=noises),
        first=arguments.first_off,
    )
    words = [arguments.kind, arguments.effect, arguments.rate, "others" if arguments.others else None]
    words += [*(arguments.protocol or ()), *(arguments.noise or ()), "first-off" if arguments.first_off else None]
    words += [f"seed{arguments.seed}", *(f"without-{move}" for move in arguments.without)]
    for move in arguments.without:
        setattr(search, move, lambda out, *_, **__: out)
    setattr(search, "LAST_MOVES", tuple(move for name, move in LAST.items() if name not in arguments.without))  # noqa: B010
    BUILD.mkdir(parents=True, exist_ok=True)
    rows = []
    with (BUILD / ("-".join(str(word) for word in words if word is not None) + ".jsonl")).open("a") as file:
        for key in keys[arguments.first - 1 :]:
            row = trial(key)
            rows.append(row)
            print(line(row), flush=True)
            file.write(json.dumps(row, allow_nan=False) + "\n")
            file.flush()
    print(tables(rows))


def trial(key: Key) -> dict[str, Any]:
    """Make, diagnose and judge one trial."""
    made = make(key)
    truth = truth_of(key, made)
    row: dict[str, Any] = {"key": key.to_dict(), "each": {k: list(v) for k, v in truth.each.items()}}
    row["required"] = sorted(truth.required)
    begin = time.process_time()
    try:
        runs = runs_of([one.recording for one in made])
        device = DeviceModel(len(runs), read_priors("afc"), variant=key.reversal)
        record = diagnose(runs, device, DiagnoseOptions(quick=True)).content
    except (ShjError, ArithmeticError, ValueError) as error:
        row |= {"outcome": "failed", "right": False, "verdict": "failed", "reason": f"{type(error).__name__}: {error}"}
        return row | {"seconds": time.process_time() - begin}
    row |= {"seconds": time.process_time() - begin} | {name: record[name] for name in KEPT if name in record}
    row["outcome"] = outcome(key, record, truth.required)
    row["right"] = coordinate_right(key, record, truth.required)
    return row


def line(row: dict[str, Any]) -> str:
    """One trial in one line."""
    key = row["key"]
    visible = (f"{one['id']} {one['size']:+.3g} ({row['each'][one['id']][0]:.1%})" for one in key["effects"])
    concealed = " + ".join(visible) or "nothing"
    if key["effects"] and not row["required"]:
        concealed += " too small"
    setting = f"{key['protocol']} {key['rate_Hz']:g} Hz {key['reversal'][:4]} {key['nuisance']['noise']}"
    setting += " at the machine" if key.get("machine_kN_mm") else ""
    setting += " first off" if key.get("first_sd") else ""
    place = {True: "right", False: "WRONG", None: "-"}[row["right"]]
    stated = sorted(row.get("coordinates", []), key=lambda entry: -entry["probability"])[:4]
    coordinates = ", ".join(f"{e['action']}/{e['coordinate']} {e['probability']:.2f}" for e in stated)
    names = "+".join(effect["id"] for effect in row.get("effects", []))
    family = ", ".join(member["id"] for member in row.get("family", []))
    answer = f"{row['verdict']} {names}{f' or {family}' if family else ''}".strip()
    head = f"{key['number']:4} {concealed:44} {setting:36} coordinate {place:6} {row['outcome']:13}"
    return f"{head} {row['seconds']:5.1f} s | {answer} | {coordinates}"


def tables(rows: list[dict[str, Any]]) -> str:
    """By effect; by protocol, by noise and by first reading."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        key = row["key"]
        first = "first reading off" if key.get("first_sd") else "first reading as others"
        where = "displacement: at the machine" if key.get("machine_kN_mm") else "displacement: across the slip"
        for name in (f"protocol: {key['protocol']}", f"noise: {key['nuisance']['noise']}", where, first):
            groups.setdefault(name, []).append(row)
    lines = [f"{'':34} {'alarms':>10} {'coordinate':>12} {'kN left out, before and after':>30} {'worse':>12}"]
    for name, own in [("all", rows), *sorted(groups.items())]:
        quiet = [row for row in own if not row["key"]["effects"]]
        alarms = sum(row["verdict"] not in ("adequate", "failed") for row in quiet)
        stated = [row for row in own if row["required"] and row["right"] is not None]
        pairs = np.array([held_out(row) for row in own if row["verdict"] in ("named", "family")]).reshape(-1, 2)
        middle = "{:.3f}, {:.3f}".format(*np.nanmedian(pairs, axis=0)) if len(pairs) else "-"
        lines.append(
            f"{name:34} {alarms:3} of {len(quiet):3} {sum(row['right'] for row in stated):5} of {len(stated):3} "
            f"{middle:>30} {np.count_nonzero(pairs[:, 1] > pairs[:, 0]):5} of {len(pairs):3}"
        )
    lines.append("kN left out, worse: error on cycles left out where something was named or a family; medians")
    failed = [f"failed: {row['reason']}" for row in rows if row["verdict"] == "failed"]
    return "\n".join([table(rows), "", *lines, *failed])


def held_out(row: dict[str, Any]) -> tuple[float, float]:
    """Error on cycles left out before and after, kN; without one the trial counts as not worse."""
    before, after = (row[when].get("heldout_rmse_kN") for when in ("before", "after"))
    return (before, after) if None not in (before, after) else (np.nan, np.nan)


def table(rows: list[dict[str, Any]]) -> str:
    """Count all trials, then those of each effect and form."""
    lines = [f"{'':30} {'coordinate':>12} {'name':>12} {'adequate':>9} {'alarms':>7} {'median s':>9} {'worst s':>8}"]
    known = simulators_by_id()
    groups = {"all": rows}
    for row in rows:
        for one in row["key"]["effects"]:
            groups.setdefault(known[one["id"]].effect, []).append(row)
            if one["id"] != known[one["id"]].effect:
                groups.setdefault(f"  {one['id']}", []).append(row)
    for name, own in [("all", rows), *sorted((n, g) for n, g in groups.items() if n != "all")]:
        seen = [row for row in own if row["required"]]
        stated = [row for row in seen if row["right"] is not None]
        places = rate(sum(bool(row["right"]) for row in stated), len(stated))
        outside = ("unknown", *RIGHT_OUTCOMES)
        hits = sum(row["outcome"] in (outside if row["key"]["kind"] == "outside" else RIGHT_OUTCOMES) for row in seen)
        quiet = [row for row in own if not row["key"]["effects"]]
        alarms = sum(row["verdict"] != "adequate" for row in quiet)
        seconds = [row["seconds"] for row in own] or [0.0]
        lines.append(
            f"{name:30} {places['hits']:5} of {places['n']:3} {hits:5} of {len(seen):3} "
            f"{sum(row['verdict'] == 'adequate' for row in own):9} {alarms:7} "
            f"{np.median(seconds):9.1f} {max(seconds):8.1f}"
        )
    quiet = [row for row in rows if not row["key"]["effects"]]
    if quiet:
        alarms = rate(sum(row["verdict"] != "adequate" for row in quiet), len(quiet))
        lines.append(f"false alarms {alarms['hits']} of {alarms['n']}, upper 95 % limit {alarms['high']:.1%}")
    lines.append("coordinate and name: of the trials whose effects can be seen in their noise; two effects, both")
    return "\n".join(lines)


if __name__ == "__main__":
    main()
