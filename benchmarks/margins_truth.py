"""How many new devices lie beyond each printed margin: ``python benchmarks/margins_truth.py -n 40 --devices 2 3 6``.

Nothing is concealed: populations are simulated, tested devices are known to 1 % (no recording, no sampling), sheets are
made from them, and 4000 new devices of each set are drawn from the truth. Their delivered force is the smaller (larger)
of both runs at the least favourable speed from standstill to the tested one. "Closest third": the sets whose tested
devices agree best in Fy, where chance flatters the spread.
"""

from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.margins.row import HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sheet import Sheet, margins
from shj_bayes.population.device import DeviceEstimate
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.measurement import Stated
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import new_device
from shj_bayes.population.quantities import QUANTITIES, FloatArray
from shj_bayes.population.tested import PUBLISHED

SPREAD = {"K": 0.12, "Fy": 0.10, "ratio": 0.06, "gamma": 0.004, "beta": 0.30}
LEVEL = {"K": np.log(18.0), "Fy": np.log(80.0), "ratio": np.log(0.8), "gamma": 0.0, "beta": np.log(15.0)}
BETWEEN = {"K": 0.15, "Fy": 0.20, "ratio": 0.15, "gamma": 0.012, "beta": 0.30}
KNOWN_TO = 0.01
"""How well each tested device is known, as a share; gamma to 0.0005 s/mm."""
N_NEW = 4000
DEFAULT_ALONE = "new device, default prior alone"
QUANTITIES_SHOWN = ("Fy", "Fy_second", "ratio", "force")
SHOWN = (
    DEFAULT_ALONE,
    "new device, 5 %",
    "new device, 95 %",
    "EN 1990 characteristic, lognormal, V unknown",
    "EN 1990 characteristic, lognormal, V common",
    "EN 1990 design, lognormal, V common",
    "tolerance 95/95 one-sided, lognormal, V unknown",
    "tolerance 95/95 one-sided, lognormal, V common",
    "ASCE 7 lower bound force",
    "ASCE 7 upper bound force",
    "EN 15129 LBDP, importance class II",
    "EN 15129 UBDP, importance class II",
    "phi equivalent, first run",
    "phi equivalent, after a first earthquake",
    "phi_o equivalent",
)
CODES = SHOWN[8:]
"""Bounds of the delivered force."""


@dataclass(frozen=True)
class Campaign:
    """Simulated sets: their tested devices, and new ones from the truth.

    Parameters
    ----------
    tested : dict of str to array, shape (n_sets, n_devices)
        Pooled scale, by quantity.
    new : tuple of dict of str to array
        Per set what new devices do, natural units.
    """

    tested: dict[str, FloatArray]
    new: tuple[dict[str, FloatArray], ...]


def simulate(n_sets: int, n_devices: int, rng: np.random.Generator) -> Campaign:
    """Draw sets, their tested devices and new ones."""
    tested, fresh = {}, {}
    for q, spread in SPREAD.items():
        mu = rng.normal(LEVEL[q], BETWEEN[q], n_sets)[:, None]
        tested[q] = rng.normal(mu, spread, (n_sets, n_devices))
        fresh[q] = QUANTITIES[q].natural(rng.normal(mu, spread, (n_sets, N_NEW)))
    moving = np.maximum(1.0 + fresh["gamma"] * PUBLISHED.fastest_mm_s, 0.01)
    second = fresh["Fy"] * fresh["ratio"]
    truth = {
        "Fy": fresh["Fy"],
        "ratio": fresh["ratio"],
        "Fy_second": second,
        "force": fresh["Fy"] * moving,
        "first": fresh["Fy"] * np.minimum(1.0, moving),
        "second": second * np.minimum(1.0, moving),
        "least": np.minimum(fresh["Fy"], second) * np.minimum(1.0, moving),
        "most": np.maximum(fresh["Fy"], second) * np.maximum(1.0, moving),
    }
    return Campaign(tested, tuple({q: values[s] for q, values in truth.items()} for s in range(n_sets)))


def sheet_of(campaign: Campaign, seed: int, rng: np.random.Generator) -> tuple[PopulationResult, Sheet]:
    """Make population and sheet of the tested devices, each known with a small error."""
    devices = []
    for s, d in np.ndindex(campaign.tested["Fy"].shape):
        known = {}
        for q, pooled in campaign.tested.items():
            error = 0.0005 if q == "gamma" else KNOWN_TO
            value = float(QUANTITIES[q].natural(pooled[s, d] + error * rng.standard_normal()))
            known[q] = Stated(value, error if q == "gamma" else error * value)
        devices.append(DeviceEstimate(f"d{d}", f"s{s}", known))
    result = replace(fit_population(devices, seed=seed), tested=PUBLISHED)
    return result, margins(result)


def beyond(row: Margin, new: dict[str, FloatArray], nominal_kN: float) -> float | None:
    """Share of new devices on the wrong side of a margin; None where the margin gives no value or no truth is known."""
    value, quantity = row.value, row.quantity
    if row.kind in CODES:
        quantity = "least" if row.side == LOW else "most"
        if row.kind.startswith("phi"):
            value *= nominal_kN
            runs = {"phi equivalent, first run": "first", "phi equivalent, after a first earthquake": "second"}
            quantity = runs.get(row.kind, "most")
    if quantity not in new or not np.isfinite(value):
        return None
    return float(np.mean(new[quantity] < value if row.side == LOW else new[quantity] > value))


def table(n_campaigns: int, n_devices: int, n_sets: int, seed: int) -> None:
    """Print one line for each margin."""
    found: dict[tuple[str, str, str], list[list[float]]] = defaultdict(list)
    agree: list[float] = []
    for c in range(n_campaigns):
        rng = np.random.default_rng([seed, n_devices, c])
        campaign = simulate(n_sets, n_devices, rng)
        result, sheet = sheet_of(campaign, c, rng)
        agree += campaign.tested["Fy"].std(axis=1, ddof=1).tolist()
        shares: dict[tuple[str, str, str], list[float]] = defaultdict(list)
        for s, new in enumerate(campaign.new):
            low, _, high = new_device(result, f"s{s}").band("Fy")
            shares[DEFAULT_ALONE, LOW, "Fy"].append(float(np.mean(new["Fy"] < low)))
            shares[DEFAULT_ALONE, HIGH, "Fy"].append(float(np.mean(new["Fy"] > high)))
        for row in sheet.rows:
            if row.kind not in SHOWN or row.set_name == ANY_SET or row.quantity not in QUANTITIES_SHOWN:
                continue
            nominal = sheet.get(row.set_name, "Fy", "nominal sliding force", MIDDLE)
            share = beyond(row, campaign.new[int(row.set_name[1:])], nominal.value if nominal else np.nan)
            if share is not None:
                shares[row.kind, row.side, row.quantity].append(share)
        for key, values in shares.items():
            found[key].append(values)
    closest = np.argsort(np.argsort(agree)).reshape(n_campaigns, n_sets) < n_campaigns * n_sets / 3
    print(f"\n{n_devices} tested devices in each of {n_sets} sets, {n_campaigns} campaigns, seed {seed}\n")
    print("| margin | quantity | side | share beyond, % | MC error | closest third, % | sets with at most 5 % beyond |")
    print("|---|---|---|---|---|---|---|")
    order = sorted(found, key=lambda k: (SHOWN.index(k[0]), k[2], {LOW: 0, HIGH: 1}[k[1]]))
    for kind, side, quantity in order:
        x = 100.0 * np.array(found[kind, side, quantity])
        error = x.mean(axis=1).std(ddof=1) / np.sqrt(n_campaigns)
        print(
            f"| {kind} | {quantity} | {side} | {x.mean():.1f} | {error:.1f} | {x[closest].mean():.1f} | "
            f"{np.mean(x <= 5.0):.2f} |"
        )


def main() -> None:
    """Print a table for each number of tested devices."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-n", type=int, default=40, help="campaigns (40)")
    parser.add_argument("--devices", type=int, nargs="+", default=[2, 3, 6], help="tested devices of each set (2 3 6)")
    parser.add_argument("--sets", type=int, default=3, help="sets of each campaign (3)")
    parser.add_argument("--seed", type=int, default=18)
    arguments = parser.parse_args()
    for n_devices in arguments.devices:
        table(arguments.n, n_devices, arguments.sets, arguments.seed)


if __name__ == "__main__":
    main()
