"""A campaign of a thousand simulated devices, one in twenty broken, with a worker killed midway.

``python benchmarks/thousand.py [-n 1000] [--workers 2] [-o DIR]`` makes short recordings, breaks 5 % of them in eight
ways, runs ``shj-bayes campaign`` with a first look at each device, kills one of its workers with SIGKILL when a third
is done, and prints what became of the devices, the time, and the peak memory of the parent and of the largest worker.
Then the same command again: it must fit nothing. Exit status 1 if a good device is missing, a bad one is not named, or
the second call does something.

``python benchmarks/thousand.py --margins`` takes as many devices, in twenty sets, after their virtual test and prints
the processor time of pooling them, of the margins, of their files and of the sheet.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from timing import of_children

from shj_bayes.app.campaign import run_campaign
from shj_bayes.app.manifest import read_manifest
from shj_bayes.margins.files import write_margins
from shj_bayes.margins.sheet import margins, pool
from shj_bayes.margins.virtual_test import VirtualTestResult
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.population.device import Tags
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult
from shj_bayes.population.readings import TABLE
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv
from shj_bayes.report.margins_page import render_margins

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
WAYS = ("empty", "missing", "words", "force in N", "swapped", "one channel", "cut short", "not text")


@dataclass
class Watch:
    """Memory and kills of a campaign while it runs; a thread fills it.

    Parameters
    ----------
    folder : Path
        Campaign folder.
    kill_at : int
        Finished devices at which one worker is killed; 0 for never.
    """

    folder: Path
    kill_at: int
    killed: int = 0
    parent_mb: float = 0.0
    worker_mb: float = 0.0
    done: threading.Event = field(default_factory=threading.Event)

    def look(self, parent: int) -> None:
        """Look at the processes twice a second until told that the campaign is done."""
        while not self.done.wait(0.5):
            workers = _children(parent)
            self.parent_mb = max(self.parent_mb, _peak_mb(parent))
            self.worker_mb = max([self.worker_mb, *map(_peak_mb, workers)])
            if self.kill_at and not self.killed and workers:
                finished = sum(1 for _ in self.folder.glob("devices/*/fit.json"))
                if finished >= self.kill_at:
                    # the largest is one that fits, not the resource tracker
                    self.killed = max(workers, key=_peak_mb)
                    os.kill(self.killed, signal.SIGKILL)


def _children(pid: int) -> list[int]:
    """Process numbers of the children."""
    try:
        threads = Path(f"/proc/{pid}/task").iterdir()
        return [int(c) for thread in threads for c in (thread / "children").read_text().split()]
    except OSError:
        return []


def _peak_mb(pid: int) -> float:
    """Peak resident memory, MB; 0 for a process that is gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines()
        return next(float(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))
    except (OSError, StopIteration):
        return 0.0


def make(folder: Path, n: int, seed: int, max_steps: int, *, whole: bool = False, look: str = "off") -> dict[str, str]:
    """Write recordings and manifest; device name to the way in which it is broken, or ""."""
    rng = np.random.default_rng(seed)
    bad = set(rng.choice(n, size=max(1, n // 20), replace=False).tolist())
    ways: dict[str, str] = {}
    text = ""
    for number in range(n):
        truth = Truth(
            K=float(18 * np.exp(0.15 * rng.standard_normal())),
            Fy=float(80 * np.exp(0.2 * rng.standard_normal())),
            gamma=float(0.01 * rng.standard_normal()),
            phi=0.3,
        )
        name = f"d{number:04d}"
        path = folder / f"{name}.csv"
        asked: dict[str, Any] = {"rate_Hz": 20.0} if whole else {"rate_Hz": 4.0, "n_runs": 1, "blocks": BLOCKS}
        first, *others = simulate_device(truth, seed=seed + number, **asked)
        write_csv(path, first)
        names = [path.name, *(write_csv(folder / f"{name}-run2.csv", run).name for run in others)]
        ways[name] = WAYS[len([w for w in ways.values() if w]) % len(WAYS)] if number in bad else ""
        if ways[name]:
            break_file(path, ways[name])
        if number % 250 == 0:
            text += f'[[set]]\nname = "set {number // 250 + 1}"\n'
        text += f'[[set.device]]\nname = "{name}"\nrecordings = {json.dumps(names)}\n'
    head = 'schema = "shj-bayes/campaign/1"\nname = "thousand"\nsimulated = true\n'
    head += f'diagnose = "{look}"\n[defaults]\nmax_steps = {max_steps}\n'
    (folder / "campaign.toml").write_text(head + text, encoding="utf-8")
    return ways


def break_file(path: Path, way: str) -> None:
    """Break a recording in one of the ways that laboratories know."""
    lines = path.read_text(encoding="utf-8").splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("time"))
    rows = [line.split(",") for line in lines[head + 1 :]]
    if way == "empty":
        path.write_bytes(b"")
    elif way == "missing":
        path.unlink()
    elif way == "words":
        path.write_text("the recording is on the other computer\n", encoding="utf-8")
    elif way == "not text":
        path.write_bytes(bytes(range(256)) * 20)
    else:
        changed = {
            "force in N": [[t, x, repr(1000 * float(f))] for t, x, f in rows],
            "swapped": [[t, f, x] for t, x, f in rows],
            "one channel": [[t, x, ""] for t, x, _ in rows],
            "cut short": rows[:20],
        }[way]
        path.write_text("\n".join(["time_s,displacement_mm,force_kN", *map(",".join, changed)]), encoding="utf-8")


def campaign(folder: Path, out: Path, workers: int, kill_at: int) -> tuple[float, Watch, dict[str, dict[str, Any]]]:
    """Run the campaign in a process of its own; seconds, what was watched, and what became of each device."""
    code = "import sys; sys.path.insert(0, sys.argv[1]); import thousand; thousand.fit_all(*sys.argv[2:])"
    command = [sys.executable, "-c", code, str(Path(__file__).parent), str(folder / "campaign.toml"), str(out)]
    begin = time.perf_counter()
    process = subprocess.Popen([*command, str(workers)])
    watch = Watch(out, kill_at)
    thread = threading.Thread(target=watch.look, args=(process.pid,))
    thread.start()
    status = process.wait()
    watch.done.set()
    thread.join()
    if status:
        raise SystemExit(f"the campaign ended with status {status}")
    record = json.loads((out / "campaign.json").read_text(encoding="utf-8"))
    return time.perf_counter() - begin, watch, {d["name"]: d for s in record["sets"] for d in s["devices"]}


def fit_all(manifest: str, out: str, workers: str) -> None:
    """Fit the devices of a manifest; the population is not what is measured here."""
    run_campaign(read_manifest(Path(manifest)), Path(out), workers=int(workers), progress=True)


def run(folder: Path, n: int, *, workers: int, max_steps: int, whole: bool, look: str) -> bool:
    """Make, run, kill, run again, print; whether all is as it should be."""
    ways = make(folder, n, 1, max_steps, whole=whole, look=look)
    out = folder / "out"
    before = of_children()
    seconds, watch, devices = campaign(folder, out, workers, max(1, n // 3))
    processor = of_children() - before
    status = Counter(device["status"] for device in devices.values())
    wrong = [name for name, way in ways.items() if (devices[name]["status"] == "failed") != bool(way)]
    silent = [name for name, way in ways.items() if way and not devices[name]["reason"]]
    print(f"{n} devices, {sum(map(bool, ways.values()))} of them broken, {workers} workers: {dict(status)}")
    print(f"  {seconds:.0f} s, {seconds / n:.2f} s a device, {processor / n:.2f} of processor")
    print(f"  worker {watch.killed or 'none'} killed midway")
    print(f"  peak memory: {watch.worker_mb:.0f} MB for the largest worker, {watch.parent_mb:.0f} MB for the parent")
    for way in WAYS:
        example = next((name for name, w in ways.items() if w == way), None)
        if example:
            print(f"  {way:12}{devices[example]['reason'][:150]}")
    stamps = {p: p.stat().st_mtime_ns for p in out.glob("devices/*/*")}
    again_s, _, second = campaign(folder, out, workers, 0)
    kept = Counter(device["status"] for device in second.values())
    idle = {p: p.stat().st_mtime_ns for p in out.glob("devices/*/*")} == stamps and not kept["done"]
    print(f"  second call: {again_s:.0f} s, {dict(kept)}, {'no' if idle else 'SOME'} file was touched")
    left = list(out.rglob("*.part"))
    for words, names in (("wrong outcome", wrong), ("no reason", silent), ("left over", left)):
        if names:
            print(f"  {words}: {', '.join(map(str, names[:10]))}")
    return not (wrong or silent or left) and idle and bool(watch.killed)


def time_margins(n: int, n_sets: int = 20, seed: int = 1) -> None:
    """Print the processor time of every step from devices after their virtual test to the written sheet."""
    rng = np.random.default_rng(seed)
    runs = ("least", "most", "plateau", "energy")
    names = ("lowest", "highest", "third", "ratio", "K", *runs, *(f"{q}_2" for q in runs))
    table = (dict.fromkeys(TABLE, (1.0, 1.0, 1.0, 1.0)),) * 2
    trials = []
    for i in range(n):
        scatter = np.exp(0.08 * rng.standard_normal() + 0.02 * rng.standard_normal(len(names)))
        values = {q: (0.85 if q == "ratio" else 80.0) * float(x) for q, x in zip(names, scatter, strict=True)}
        errors = dict.fromkeys(names, 0.01)
        trials.append(VirtualTestResult(f"d{i}", f"set {i % n_sets}", table, values, errors, errors, np.full(20, 0.01)))
    sets = {
        name: tuple(t.name for t in trials if t.set_name == name) for name in dict.fromkeys(t.set_name for t in trials)
    }
    bare = tuple(DeviceSet(name, members, Tags(), {}) for name, members in sets.items())
    clock = [time.process_time()]

    def tell(words: str) -> None:
        clock.append(time.process_time())
        print(f"  {words}: {clock[-1] - clock[-2]:.1f} s")

    print(f"{n} devices in {n_sets} sets, processor time:")
    design = pool(trials, PopulationResult(bare, {}, {}, {}, {}, seed))
    tell(f"{len(names)} quantities pooled under three priors")
    sheet = margins(design, trials)
    tell(f"{len(sheet.rows)} margins")
    with tempfile.TemporaryDirectory() as name:
        write_margins(sheet, Path(name))
        tell("their files")
        render_margins(Path(name), sheet, name="thousand", importance="II")
        tell("the sheet")
    print(f"  together: {clock[-1] - clock[0]:.1f} s")


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=1000, help="devices (1000)")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--whole", action="store_true", help="two runs of Table 1 at 20 Hz, 24 000 samples, each")
    parser.add_argument("--max-steps", type=int, default=200, help="steps of each fit (200)")
    parser.add_argument("--diagnose", choices=("quick", "full", "off"), default="quick", help="quick by default")
    parser.add_argument("--margins", action="store_true", help="time population and margins instead")
    parser.add_argument("-o", "--out", type=Path, help="folder that is kept; a temporary one by default")
    asked = parser.parse_args()
    if asked.margins:
        time_margins(asked.n)
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = asked.out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        kind = {"max_steps": asked.max_steps, "whole": asked.whole, "look": asked.diagnose}
        return int(not run(folder, asked.n, workers=asked.workers, **kind))


if __name__ == "__main__":
    sys.exit(main())
