"""What is installed, whether it works, how fast this machine is."""

import os
import platform
import time
import timeit
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.inference.posterior import make_posterior
from shj_bayes.inference.run import runs_of
from shj_bayes.inference.start import find_start
from shj_bayes.inference.store import versions
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors, shipped_families
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.report.browse import find_browser

TRUTH = Truth(gamma=1 / 60)


def examine() -> tuple[dict[str, Any], str]:
    """Fit a small simulated device and time the law: what was found, for machines and for people."""
    begin = time.perf_counter()
    runs = runs_of(simulate_device(TRUTH, seed=1, rate_Hz=20.0))
    posterior, start = find_start(make_posterior(runs, DeviceModel(len(runs), read_priors())))
    first = time.perf_counter() - begin
    theta = posterior.natural(start.free[None])[0]
    error = {name: abs(theta[posterior.model.index(name)] / getattr(TRUTH, name) - 1) for name in ("K", "Fy", "gamma")}
    works = bool(max(error.values()) < 0.05)
    batch = np.repeat(theta[None], 16, axis=0)
    seconds = min(timeit.repeat(lambda: posterior.log_likelihood(batch), number=1, repeat=20))
    browser = find_browser()
    families = [f"{family} ({len(read_priors(family).priors)} laws)" for family in shipped_families()]
    record: dict[str, Any] = {
        "schema": "shj-bayes/doctor/1",
        "works": works,
        "versions": versions(),
        "machine": {"system": platform.system(), "processor": platform.machine(), "processors": os.cpu_count()},
        "checks": {
            "fit of a simulated device": f"K, Fy and gamma within {100 * max(error.values()):.2g} % of the truth",
            "priors": ", ".join(families),
            "pages to PDF": f"by {Path(browser).name}"
            if browser
            else "no Chromium, Chrome or Edge found; print by hand",
        },
        "first_fit_s": first,
        "likelihood_ns_per_block": 1e9 * seconds / (16 * posterior.n_blocks),
    }
    lines = [f"{name:12}{version}" for name, version in record["versions"].items()]
    lines += [f"{name:12}{value}" for name, value in record["machine"].items()]
    lines += [f"{name}: {words}" for name, words in record["checks"].items()]
    lines += [
        f"first search for a fit: {first:.1f} s (compiles once after installation)",
        f"likelihood: {record['likelihood_ns_per_block']:.1f} ns per average of samples on one processor",
        "everything works" if works else "NOT WORKING: the fit of a simulated device misses the truth by more than 5 %",
    ]
    return record, "\n".join(lines)
