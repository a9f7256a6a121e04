"""Fuzz everything that is read: ``python tests/fuzz/run.py -n 5000 --seed 1``.

Each case runs in a process that is watched: one that takes more than 10 s, or dies, is a breach like a traceback.
Prints a table by kind of file and every breach with the number that makes it again; exit status 1 if there is one.
"""

from __future__ import annotations

import argparse
import collections
import pickle
import resource
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from pathlib import Path
from queue import Empty, Queue

sys.path.insert(0, str(Path(__file__).resolve().parent))

HANG_S = 60.0  # silence after which a process is ended: 10 s of work are the rule, the rest is for a busy machine
MEMORY = 6 * 1024**3  # a small file that needs more has blown up


def worker(seed: int, first: int, last: int, scratch: Path) -> None:
    """Attack with cases first to last; one line for each on standard output."""
    from attack import attack  # noqa: PLC0415
    from corpus import Corpus  # noqa: PLC0415

    warnings.simplefilter("ignore")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    corpus = pickle.loads((scratch / "corpus.pickle").read_bytes())  # written by our own parent a moment ago
    assert isinstance(corpus, Corpus)
    for number in range(first, last):
        case = corpus.case(number)
        print(f"{number}\tbegin\t{case.kind}\t{case.name}", flush=True)
        with tempfile.TemporaryDirectory(dir=scratch) as folder:
            word = attack(case, Path(folder), scratch / "good" / "campaign")
        print(f"{number}\tend\t{' '.join(word.split())}", flush=True)


def run(n: int, seed: int, *, first: int = 0, results: bool = True, show: bool = True) -> list[tuple[int, str, str]]:
    """Run cases first to first + n.

    Parameters
    ----------
    n, seed, first : int
        How many cases, of which corpus, from which number.
    results : bool
        Whether results files are among them.
    show : bool
        Print the table.

    Returns
    -------
    list of (int, str, str)
        Breaches: number, file, what happened.
    """
    from corpus import Corpus  # noqa: PLC0415

    counts: collections.Counter[tuple[str, str]] = collections.Counter()
    breaches: list[tuple[int, str, str]] = []
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        (scratch / "good").mkdir()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            corpus = Corpus(seed, scratch / "good", results=results)
        (scratch / "corpus.pickle").write_bytes(pickle.dumps(corpus))
        at = first
        while at < first + n:
            at = _watched(seed, at, first + n, scratch, counts, breaches)
    if show:
        _table(counts, breaches, time.perf_counter() - begin)
    return breaches


def _watched(
    seed: int,
    first: int,
    last: int,
    scratch: Path,
    counts: collections.Counter[tuple[str, str]],
    breaches: list[tuple[int, str, str]],
) -> int:
    """Run one process until it is done, hangs or dies; the number to go on with."""
    command = [sys.executable, __file__, "--worker", str(seed), str(first), str(last), str(scratch)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, stderr=subprocess.DEVNULL)
    lines: Queue[str] = Queue()

    def listen() -> None:
        assert process.stdout is not None
        with process.stdout as stream:
            for line in stream:
                lines.put(line)

    threading.Thread(target=listen, daemon=True).start()
    number, kind, name, open_case = first, "", "", False
    wait = 4 * HANG_S  # the first line comes after the imports
    while True:
        try:
            fields = lines.get(timeout=wait).rstrip("\n").split("\t")
        except Empty:
            if process.poll() is not None:
                break
            process.kill()
            process.wait()
            breaches.append((number, name, f"BREACH no answer within {HANG_S:.0f} s"))
            counts[kind, "breach"] += 1
            return number + 1
        wait, number = HANG_S, int(fields[0])
        if fields[1] == "begin":
            kind, name, open_case = fields[2], fields[3], True
        else:
            open_case = False
            word = fields[2]
            if word.startswith("BREACH"):
                breaches.append((number, name, word))
            counts[kind, "breach" if word.startswith("BREACH") else word] += 1
        if number == last - 1 and not open_case:
            process.wait()
            return last
        if process.poll() is not None and lines.empty():
            time.sleep(0.2)
            if lines.empty():
                break
    breaches.append((number, name, f"BREACH the process died with status {process.returncode}"))
    counts[kind, "breach"] += 1
    return number + 1


def _table(counts: collections.Counter[tuple[str, str]], breaches: list[tuple[int, str, str]], seconds: float) -> None:
    print(f"{'kind':12}{'cases':>8}{'read':>8}{'refused':>9}{'breaches':>10}")
    kinds = sorted({kind for kind, _ in counts})
    for kind in kinds:
        row = {word: counts[kind, word] for word in ("read", "refused", "breach")}
        print(f"{kind:12}{sum(row.values()):8}{row['read']:8}{row['refused']:9}{row['breach']:10}")
    print(f"{'all':12}{sum(counts.values()):8}{'':17}{len(breaches):10}   in {seconds:.0f} s")
    seen: collections.Counter[str] = collections.Counter(what.split(":")[0] for _, _, what in breaches)
    for what, count in seen.most_common():
        number, name, words = next(b for b in breaches if b[2].split(":")[0] == what)
        print(f"  {count:5} x {words}   (case {number}, {name})")


def main() -> int:
    """Read the command line."""
    if sys.argv[1:2] == ["--worker"]:
        worker(*map(int, sys.argv[2:5]), Path(sys.argv[5]))
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=5000, help="cases (5000)")
    parser.add_argument("--seed", type=int, default=1, help="corpus (1)")
    parser.add_argument("--first", type=int, default=0, help="first case (0); to repeat one, with -n 1")
    parser.add_argument("--without-results", action="store_true", help="leave out files of results")
    asked = parser.parse_args()
    return int(bool(run(asked.n, asked.seed, first=asked.first, results=not asked.without_results)))


if __name__ == "__main__":
    sys.exit(main())
