"""Growth with devices and workers: one campaign by processes and on a dask cluster, with one worker and with two.

Run ``python benchmarks/workers.py [-n 40]`` (ten minutes). The devices are those of ``thousand.py``, short recordings
of which one in twenty is broken. The first devices of a process start the interpreter and read compiled code, so a
quarter of the devices is fitted in a campaign of its own first; what is told is the time that a further device takes.
Overhead is what the cluster takes longer than the same number of processes. Without dask only the processes are
measured.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import thousand

from shj_bayes.app.campaign import run_campaign
from shj_bayes.app.manifest import Manifest, read_manifest


@contextmanager
def cluster(folder: Path, n_workers: int) -> Iterator[str]:
    """Scheduler file of a cluster of separate processes, one thread each, that ends with the block."""
    path = folder / f"scheduler-{n_workers}.json"
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    one_thread = os.environ | {"OMP_NUM_THREADS": "1"}

    def start(part: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", "--scheduler-file", str(path), *options]
        return subprocess.Popen(command, env=one_thread, **quiet)  # type: ignore[call-overload,no-any-return]

    running = [start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")]
    try:
        while not path.exists():
            time.sleep(0.1)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
        running += [start("worker", *options) for _ in range(n_workers)]
        yield str(path)
    finally:
        for process in reversed(running):
            process.kill()
            process.wait()


def seconds_a_device(manifest: Manifest, out: Path, workers: int, address: str = "") -> float:
    """Wall time of a further device, s: a whole campaign less one of a quarter of its devices."""
    few = len(manifest.devices) // 4
    taken = []
    for name, devices in (("few", manifest.devices[:few]), ("all", manifest.devices)):
        begin = time.perf_counter()
        run_campaign(manifest._replace(devices=devices), out / name, workers=workers, cluster=address)
        taken.append(time.perf_counter() - begin)
    return (taken[1] - taken[0]) / (len(manifest.devices) - few)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("-n", type=int, default=40, help="devices (40)")
    n = parser.parse_args().n
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        thousand.make(folder, n, seed=1, max_steps=200)
        manifest = read_manifest(folder / "campaign.toml")
        print(f"{n} devices\nworkers  processes, s a device  dask, s a device  overhead", flush=True)
        for workers in (1, 2):
            alone = seconds_a_device(manifest, folder / f"processes-{workers}", workers)
            line = f"{workers:7}  {alone:21.2f}"
            if importlib.util.find_spec("distributed"):
                with cluster(folder, workers) as address:
                    there = seconds_a_device(manifest, folder / f"dask-{workers}", workers, address)
                line += f"  {there:16.2f}  {100 * (there / alone - 1):+7.1f} %"
            print(line, flush=True)


if __name__ == "__main__":
    main()
