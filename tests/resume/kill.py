"""Kill commands at random moments, run them again, compare with what was never stopped.

``python tests/resume/kill.py [-n 5] [--seed 1] [--steps 600]`` prints one line for each kill: when, what lay there
then, and whether every file has the same bits afterwards, but for the time (docs/security.md). Exit
status 1 if one has not. The last lines try a full disk, a folder that cannot be written to, and a folder that vanishes
while the fit runs.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

import h5py
import numpy as np
import xarray as xr

from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import check_files, read

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
COMMAND = [sys.executable, "-c", "from shj_bayes.cli import main; main(prog_name='shj-bayes')"]
DEVICES = 3
KINDS = ("fit", "campaign", "tables", "plan", "margins")
OUT, BASE = "{out}", "{base}"  # in arguments: the folder of the results, and that of a finished campaign
# what tells when, or by which call, something was made, and the digests that tell it
TIME = re.compile(
    rb'[0-9a-f]{64}|"created": "[^"]*"|"seconds": [-+.\de]+|"status": "(?:done|kept)"|<dt>Made</dt><dd>[^<]*'
)


@dataclass(frozen=True)
class Kill:
    """One kill and what came after it.

    Parameters
    ----------
    what : str
        What was killed, one of ``KINDS``.
    after_s : float
        Moment, seconds after the start.
    steps, finished : int
        Steps in the checkpoints and finished fits that lay there then.
    half : tuple of str
        Files that could not be read then; none is allowed.
    same : bool
        Whether every file of the resumed result has the bits of the uninterrupted one.
    left : tuple of str
        Temporary files left after the resumed run; none is allowed.
    """

    what: str
    after_s: float
    steps: int
    finished: int
    half: tuple[str, ...]
    same: bool
    left: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether nothing was lost."""
        return self.same and not self.half and not self.left


def make_inputs(folder: Path, steps: int) -> dict[str, list[str]]:
    """Simulate short recordings and write the manifest; the arguments of each command."""
    entries = []
    for number in range(1, DEVICES + 1):
        runs = simulate_device(Truth(Fy=70.0 + 5 * number, phi=0.3), seed=number, rate_Hz=6.0, blocks=BLOCKS)
        names = [write_csv(folder / f"d{number}-{i}.csv", run).name for i, run in enumerate(runs, start=1)]
        entries.append(f'[[set.device]]\nname = "{number}"\nrecordings = {json.dumps(names)}\n')
    head = 'schema = "shj-bayes/campaign/1"\nname = "kill"\ndiagnose = "off"\n[defaults]\n'
    head += f'max_steps = {steps}\n[[set]]\nname = "a"\n'
    manifest = folder / "campaign.toml"
    manifest.write_text(head + "".join(entries), encoding="utf-8")
    runs_of_one = [str(folder / "d1-1.csv"), str(folder / "d1-2.csv")]
    return {
        "fit": ["fit", *runs_of_one, "--max-steps", str(steps)],
        "campaign": ["campaign", str(manifest), "--workers", "2"],
        "tables": ["tables"],
        "plan": ["plan", f"{BASE}/devices/a-1-05a9c569a185"],
        "margins": ["margins", OUT, "--amplitude", "20"],
    }


def start(arguments: list[str], out: Path) -> subprocess.Popen[bytes]:
    """Start a command in a process group of its own, so that its workers can be killed with it."""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    base = out.with_name("base")
    if OUT in arguments and not out.exists():  # what the command adds to
        copytree(base, out)
    filled = [a.replace(OUT, str(out)).replace(BASE, str(base)) for a in arguments]
    command = [*COMMAND, *filled, *([] if OUT in arguments else ["--out", str(out)]), "--quiet"]
    return subprocess.Popen(command, env=environment, start_new_session=True, stderr=subprocess.PIPE)


def finish(arguments: list[str], out: Path) -> float:
    """Run a command to its end; seconds it took."""
    begin = time.perf_counter()
    process = start(arguments, out)
    _, said = process.communicate()
    # 1 is a fit whose few steps did not converge: what counts here are its bits
    if process.returncode not in (0, 1) or b"Traceback" in said or not out.exists():
        raise SystemExit(f"{arguments[0]} ended with status {process.returncode}: {said.decode()}")
    return time.perf_counter() - begin


def folders_of(out: Path) -> list[Path]:
    """Folders below `out` in which a device is or was being fitted."""
    return sorted({p.parent for name in ("fit.json", "checkpoint.h5") for p in out.rglob(name)})


def look(out: Path) -> tuple[int, int, tuple[str, ...]]:
    """Count steps in checkpoints and finished fits, and name files that are not whole, as they lie after a kill."""
    steps, finished, half = 0, 0, []
    for folder in folders_of(out):
        try:
            if (folder / "checkpoint.h5").exists():
                with h5py.File(folder / "checkpoint.h5", "r") as file:
                    steps += int(file["ensemble_0/chain"].shape[0]) - 1
                    np.asarray(file["ensemble_3/chain"])
            if (folder / "fit.json").exists():
                check_files(folder, read(FitRecord, folder))
                finished += 1
        except Exception as error:  # whatever cannot be read is what is looked for
            half.append(f"{folder.name}: {error}")
    for path in out.rglob("*.json"):
        try:
            json.loads(path.read_bytes())
        except ValueError as error:
            half.append(f"{path.name}: {error}")
    return steps, finished, tuple(half)


def content(path: Path) -> Any:
    """What a file holds but for the time and the call that made it."""
    if path.suffix != ".nc":
        return TIME.sub(b"", path.read_bytes())
    with xr.open_datatree(path, engine="h5netcdf") as data:
        return {f"{g.path}/{name}": v.to_numpy().tobytes() for g in data.subtree for name, v in g.variables.items()}


def same_bits(one: Path, two: Path) -> bool:
    """Whether two output folders hold the same files with the same content."""
    names = [sorted(p.relative_to(out) for p in out.rglob("*") if p.is_file()) for out in (one, two)]
    differ = [str(n) for n in names[0] if n in names[1] and content(one / n) != content(two / n)]
    differ += [str(n) for n in set(names[0]) ^ set(names[1])]
    if differ:
        print(f"not the same: {', '.join(differ)}")
    return bool(names[0]) and not differ


def kill_and_resume(what: str, arguments: list[str], reference: Path, out: Path, after_s: float) -> Kill:
    """Start, kill with SIGKILL after a time, look, run the same command again, compare."""
    process = start(arguments, out)
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    steps, finished, half = look(out)
    finish(arguments, out)
    left = tuple(str(p.relative_to(out)) for p in out.rglob("*.part*"))
    return Kill(what, after_s, steps, finished, half, same_bits(reference, out), left)


def hardships(arguments: list[str], scratch: Path) -> list[tuple[str, bool, str]]:
    """Full disk, folder that cannot be written to, folder that vanishes: what is said, and whether it is one line."""
    results = []
    earlier = scratch / "earlier"
    finish(arguments, earlier)
    (earlier / "checkpoint.h5").unlink(missing_ok=True)  # else the stranger's checkpoint is what stops the next fit
    kept = {p.name: p.read_bytes() for p in earlier.iterdir()}
    for kilobytes in (16, 1500):  # the checkpoint, then the posterior, which reserves more than a page takes
        limited = ["bash", "-c", f'ulimit -f {kilobytes}; exec "$@"', "bash", *COMMAND, *arguments]
        for out, words in ((scratch / f"full{kilobytes}", "empty folder"), (earlier, "folder with an earlier result")):
            done = subprocess.run(
                [*limited, "--seed", "2", "--out", str(out), "--quiet"], capture_output=True, check=False
            )
            whole = all((earlier / name).read_bytes() == content for name, content in kept.items())
            results.append(_said(f"disk full after {kilobytes} KiB, {words}", done, extra=whole))
    done = subprocess.run(
        [*COMMAND, *arguments, "--out", "/sys/shj-bayes", "--quiet"], capture_output=True, check=False
    )
    results.append(_said("folder that cannot be written to", done))
    out = scratch / "vanishing"
    process = start(arguments, out)
    waiting = threading.Thread(target=_take_away, args=(out,))
    waiting.start()
    _, said = process.communicate()
    waiting.join()
    ended = subprocess.CompletedProcess[bytes]([], process.returncode, b"", said)
    results.append(_said("folder taken away at the first checkpoint", ended))
    return results


def _take_away(out: Path) -> None:
    until = time.monotonic() + 120
    while not (out / "checkpoint.h5").exists() and time.monotonic() < until:
        time.sleep(0.005)
    rmtree(out, ignore_errors=True)


def _said(what: str, done: subprocess.CompletedProcess[bytes], *, extra: bool = True) -> tuple[str, bool, str]:
    lines = done.stderr.decode("utf-8", "replace").strip().splitlines()
    good = done.returncode == 1 and len(lines) == 1 and lines[0].startswith("shj-bayes: ") and extra
    return what, good, " / ".join(lines)[:150]


def run(n: int, seed: int, steps: int, kinds: tuple[str, ...] = KINDS) -> list[Kill]:
    """Kill each kind n times at moments spread over its whole duration; prints as it goes."""
    kills = []
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        commands = make_inputs(scratch, steps)
        print(f"{'what':10}{'killed at':>10}{'of':>8}{'steps kept':>12}{'fits kept':>11}  half files   same bits")
        if {"plan", "margins"} & {*kinds}:
            finish(commands["campaign"], scratch / "base")
        for what in kinds:
            reference = scratch / f"{what}-reference"
            finish(commands[what], scratch / f"{what}-warm")  # the first start compiles and fills the caches
            whole_s = finish(commands[what], reference)
            for number in range(n):
                # one moment in each n-th of the duration, so that no part of it is left out
                after_s = float((number + rng.random()) / n * whole_s)
                kill = kill_and_resume(what, commands[what], reference, scratch / f"{what}-{number}", after_s)
                kills.append(kill)
                words = "none" if not kill.half + kill.left else "; ".join(kill.half + kill.left)
                print(
                    f"{what:10}{after_s:8.2f} s{whole_s:6.1f} s{kill.steps:12}{kill.finished:11}  {words:12} "
                    f"{'yes' if kill.same else 'NO'}",
                    flush=True,
                )
                rmtree(scratch / f"{what}-{number}")
    return kills


def main() -> int:
    """Read the command line, kill, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=5, help="kills of each kind (5)")
    parser.add_argument("--seed", type=int, default=1, help="moments (1)")
    parser.add_argument("--steps", type=int, default=600, help="steps of each fit (600)")
    parser.add_argument("--only", choices=(*KINDS, "hardships"), help="one part alone")
    asked = parser.parse_args()
    kinds: tuple[str, ...] = KINDS if asked.only is None else tuple({asked.only} - {"hardships"})
    kills = run(asked.n, asked.seed, asked.steps, kinds) if kinds else []
    good = sum(kill.good for kill in kills)
    if kills:
        print(f"{good} of {len(kills)} resumed to the same bits, with no half file and nothing left over")
    results: list[tuple[str, bool, str]] = []
    if asked.only in (None, "hardships"):
        with tempfile.TemporaryDirectory() as name:
            results = hardships(make_inputs(Path(name), asked.steps)["fit"], Path(name))
        for what, ok, said in results:
            print(f"{'ok' if ok else 'NOT OK':8}{what}: {said}")
    return int(good < len(kills) or not all(ok for _, ok, _ in results))


if __name__ == "__main__":
    sys.exit(main())
