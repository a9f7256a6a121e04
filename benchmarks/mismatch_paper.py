"""The diagnosis on the paper's own devices: found blind (``tables``), not fooled by what looks alike (``flagship``).

Run as ``python benchmarks/mismatch.py tables`` and ``python benchmarks/mismatch.py flagship -n 20 --seed 9500``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial
from typing import Any

import numpy as np
from mismatch import look

from shj_bayes.mismatch.diagnosis import DiagnosisResult
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.population.device import PublishedRow, published_rows
from shj_validation.trials import simulate

RATE_HZ = 5.0
Trials = dict[str, Callable[[int], dict[str, Any]]]
FLAGSHIP: Trials = {}


def tables(pool: Executor, first_seed: int, only: str | None) -> None:
    """Diagnose each row of Tables 3 and 4 without speed dependence in the law, one line each."""
    rows = [row for row in published_rows() if row.table in (3, 4) and only in (None, row.row)]
    print("row: where the law without speed dependence fails (largest regions; force along the motion)")
    print("    verdict: names; held-out kN before -> after (noise); gamma of the row -> found (90 %), 1/1000 s/mm")
    for line in pool.map(table_trial, rows, range(first_seed, first_seed + len(rows))):
        print(line, flush=True)


def table_trial(row: PublishedRow, seed: int) -> str:
    """Two runs of Table 1 with the row's parameters and AR(1) noise of 1 kN, diagnosed without speed dependence."""
    values = row.values
    truth = Truth(values["K", 1], values["Fy", 1], values["beta", 1], row.gamma, row.ratio)
    diagnosis = look(list(simulate_device(truth, seed=seed, rate_Hz=RATE_HZ)), ("velocity",))
    record = diagnosis.content
    names = (
        ", ".join(f"{effect['id']} ({100 * effect['probability']:.0f} %)" for effect in record["effects"]) or "nothing"
    )
    family = ", ".join(member["id"] for member in record["family"])
    velocity = next((effect for effect in record["effects"] if effect["id"] == "velocity"), None)
    found = "not estimated"
    if velocity:
        size = velocity["parameters"]["size"]
        found = f"{1e3 * size['mean']:+.2f} ({1e3 * size['q05']:+.2f} to {1e3 * size['q95']:+.2f})"
    before, after = record["before"]["heldout_rmse_kN"], record["after"]["heldout_rmse_kN"]
    return (
        f"{f'T{row.table} {row.row}':18} {located(diagnosis)}\n    {record['verdict']}: {names}"
        f"{f'; family: {family}' if family else ''}; held out {before:.2f} -> {after:.2f} "
        f"({record['after']['noise_kN']:.2f}); gamma {1e3 * row.gamma:+.2f} -> {found}"
    )


def located(diagnosis: DiagnosisResult) -> str:
    """Largest region over speed and over position, and what the law leaves along the motion at mid-stroke."""
    out = []
    for coordinate, unit in (("speed", "mm/s"), ("position", "mm")):
        own = [where for where in diagnosis.content["location"] if where["coordinate"] == coordinate]
        if own:
            top = max(own, key=lambda where: abs(where["size_kN"]))
            low, high = top["interval"]
            out.append(f"{low:.3g} to {high:.3g} {unit} {top['direction']} {top['size_kN']:+.1f} kN")
        else:
            out.append(f"no region of {coordinate}")
    c = diagnosis.channels
    left = (c["force_kN"] - c["before_kN"]) * c["direction"]
    fast = (c["speed_mm_s"] > 9.0) & (np.abs(c["position_mm"]) < 20.0) & (c["slip_mm"] > 20.0)
    out.append(f"left at mid-stroke, speed above 9 mm/s: {left[fast].mean():+.1f} kN")
    return "; ".join(out)


def flagship(pool: Executor, n: int, first_seed: int, only: str | None) -> None:
    """Print friction that falls with position and none with speed, and the converse: every trial, then the counts."""
    names = [name for name in FLAGSHIP if only in (None, name)]
    pairs = [(name, seed) for seed in range(first_seed, first_seed + n) for name in names]
    records: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for (name, seed), record in zip(pairs, pool.map(_one, *zip(*pairs, strict=True)), strict=True):
        records[name].append(record)
        mark = "as it should be" if record["as_it_should"] else "NOT as it should be"
        print(f"{seed} {name}: {record['verdict']} ({record['names']}), {record['gamma']}, {mark}", flush=True)
    for name in names:
        print(f"{name}\n    {summary(records[name])}")


def _one(name: str, seed: int) -> dict[str, Any]:
    return FLAGSHIP[name](seed)


def flagship_trial(
    effects: dict[str, dict[str, float]], gamma: float, without: tuple[str, ...], seed: int
) -> dict[str, Any]:
    """Diagnose one device and keep what matters."""
    record = look(simulate(effects, seed, gamma=gamma), without).content
    known = {effect["id"]: effect["family"] for effect in record["effects"]}
    members = {member["id"] for member in record["family"]}
    even = {"prying", "centre_wear"} & (set(known) | members)
    shift = record["shift"].get("gamma")
    before, low, high = 0.0, 0.0, 0.0
    if shift:
        before, after = shift["before"]["mean"], shift["after"]
        low, high = after["mean"] - 1.96 * after["sd"], after["mean"] + 1.96 * after["sd"]
    for effect in record["effects"]:
        if effect["id"] == "velocity":  # the law runs without it, and found it
            low, high = effect["parameters"]["size"]["q05"], effect["parameters"]["size"]["q95"]
    contains = low <= gamma <= high
    velocity = "velocity" in set(known) | members
    right = bool(even) and contains if effects else not even and (velocity if without else contains)
    return {
        "verdict": record["verdict"],
        "names": ", ".join([*known, *(f"or {m}" for m in sorted(members - set(known)))]) or "nothing",
        "even": bool(even),
        "exact": set(known) == set(effects) and not members,
        "contains": contains,
        "velocity": velocity,
        "before": before,
        "gamma": f"gamma {1e3 * before:+.1f} before, {1e3 * low:+.1f} to {1e3 * high:+.1f} after (1/1000 s/mm)",
        "as_it_should": right,
    }


def summary(records: list[dict[str, Any]]) -> str:
    """Count over the trials of one line."""
    n = len(records)
    count = {key: sum(bool(r[key]) for r in records) for key in ("even", "exact", "contains", "velocity")}
    gammas = sorted(r["before"] for r in records)
    middle = gammas[n // 2]
    dep = f"{1 / middle:+.0f} mm/s" if middle else "not fitted"
    return (
        f"even-in-position effect reported {count['even']} of {n} (it alone {count['exact']}); interval of gamma "
        f"holds the truth {count['contains']} of {n}; velocity reported {count['velocity']} of {n}; the published law "
        f"alone: dep {dep} (median)"
    )


FLAGSHIP |= {
    "prying 17 %, no speed dependence": partial(flagship_trial, {"prying": {"size": 0.17, "power": 2.0}}, 0.0, ()),
    "worn centre 12 %, no speed dependence": partial(
        flagship_trial, {"centre_wear": {"size": 0.12, "width": 0.3}}, 0.0, ()
    ),
    "gamma = 1/60, nothing missing": partial(flagship_trial, {}, 1 / 60, ()),
    "gamma = 1/60, law without velocity": partial(flagship_trial, {}, 1 / 60, ("velocity",)),
}
