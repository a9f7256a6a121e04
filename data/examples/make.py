"""Make the example recordings anew: ``python data/examples/make.py`` (the files here are rounded to six digits).

Two sets of three simulated devices. Their parameters are scattered around two published rows (Bisalloy 500 bare,
Table 3; zinc 70 %, Table 4) by made-up device-to-device spreads, so that the demo has something to pool and to compare.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shj_bayes.app.device import write_simulated
from shj_bayes.model.simulate import Truth
from shj_bayes.recording.recording import write_csv
from shj_validation.proof.cases import stated_key
from shj_validation.proof.make import make

FOLDER = Path(__file__).parent
SEED = 2026
SETS = {
    "bisalloy500-bare": {"K": 18.0, "Fy": 80.0, "beta": 100.0, "gamma": 1 / 60, "ratio": 0.875},
    "bisalloy500-zinc70": {"K": 11.0, "Fy": 90.0, "beta": 10.0, "gamma": -1 / 75, "ratio": 0.72},
}
SPREAD = {"K": 0.10, "Fy": 0.06, "ratio": 0.04}
SPREAD_GAMMA = 0.002


def main() -> None:
    """Write recordings, truths and the campaign's manifest."""
    rng = np.random.default_rng(SEED)
    for number, (name, centre) in enumerate(SETS.items()):
        for device in range(1, 4):
            truth = {key: centre[key] * float(np.exp(s * rng.standard_normal())) for key, s in SPREAD.items()}
            gamma = centre["gamma"] + SPREAD_GAMMA * float(rng.standard_normal())
            stated = {key: round(value, 4) for key, value in truth.items()}
            device_truth = Truth(beta=centre["beta"], gamma=1 / round(1 / gamma, 2), sigma=1.0, phi=0.7, **stated)
            write_simulated(FOLDER / f"{name}-{device}", device_truth, seed=100 * number + device, rate_Hz=5.0)
    prying()


def prying() -> None:
    """Write a device that loses clamping off centre and knows no speed, by a simulator of the proof."""
    key = stated_key("prying", 0.17, seed=2, rate_Hz=5.0, gamma=0.0, K=18.0, Fy=80.0, beta=10.0, ratio=0.875)
    words = "SIMULATED by shj-bayes (data/examples/make.py); not a measurement. Truth: prying, no speed dependence"
    for run, one in enumerate(make(key), start=1):
        write_csv(FOLDER / f"prying-run{run}.csv", one.recording, comment=words)


if __name__ == "__main__":
    main()
