"""Never a traceback: ``python tests/robust/robust.py -n 200 --seed 1 --recordings ../shared/recordings``.

Cuts, decimates, shifts, scales, joins and repeats the public recordings and runs fit, diagnose (a first look), plan and
margins on each combination, as a user would; a short chain, as its numbers are not looked at. A refusal in words is
right; a traceback, or a number that no file can hold, is a breach. Each case is a process of its own; one that takes
longer than ``--seconds`` is ended and counted as such. A line for each case goes to ``build/robust/seed-N.jsonl``, and
cases that stand there are not run again. ``--longest 300 --without diagnose`` runs short ones, and one command less.
``--first 17 -n 1 --again`` repeats one. Exit status 1 if there is a breach.
"""

from __future__ import annotations

import argparse
import collections
import json
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from changed_recordings import case

from shj_bayes import api
from shj_bayes.app.resume import design_margins
from shj_bayes.errors import ShjError

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "robust"
STEPS = ("fit", "diagnose", "plan", "margins")
DONE, REFUSED, LATE, BREACH = "done", "refused", "too long", "BREACH"
MAX_STEPS = 400  # of the chain
MINUTES = 10.0  # of the test that is planned
MANIFEST = """schema = "shj-bayes/campaign/1"
name = "robust"
[defaults]
{defaults}
[[set]]
name = "s"
[[set.device]]
name = "d"
recordings = {recordings}
"""


def outcomes(
    seed: int, number: int, recordings: Path | None, folder: Path, *, longest: int | None = None, without: str = ""
) -> Iterator[tuple[str, str]]:
    """Run the commands on one case, all but one if asked; give each with what came of it, in words."""
    made = case(seed, number, recordings, longest=longest)
    paths = made.write(folder)
    options: dict[str, Any] = made.options | {"max_steps": MAX_STEPS}
    names = json.dumps([path.name for path in paths])
    defaults = "\n".join(f"{name} = {json.dumps(value)}" for name, value in options.items())
    manifest = folder / "campaign.toml"
    manifest.write_text(MANIFEST.format(defaults=defaults, recordings=names), encoding="utf-8")
    campaign, out = api.Campaign.read(manifest), folder / "out"
    device = out / campaign.manifest.devices[0].folder  # where the campaign finds it, and does not fit it again

    def fit() -> Any:
        return api.fit(paths, device, name="d", threads=1, **options).record

    def diagnose() -> Any:
        return api.diagnose(paths, folder / "look", name="d", quick=True, threads=1, **options).record

    def plan() -> Any:
        return api.plan(device, folder / "next", max_minutes=MINUTES).record

    def margins() -> Any:
        result = campaign.run(out, workers=1, diagnose="off")
        for one in (one for group in result.record["sets"] for one in group["devices"]):
            if "unexpected " in str(one.get("reason", "")):  # what a campaign makes of a traceback
                raise RuntimeError(one["reason"])
        return design_margins(out).record

    commands: tuple[tuple[str, Callable[[], Any]], ...] = tuple(zip(STEPS, (fit, diagnose, plan, margins), strict=True))
    for name, command in commands:
        if name != without:
            yield name, _word(command)


def _word(command: Callable[[], Any]) -> str:
    """What came of one command."""
    try:
        json.dumps(command(), allow_nan=False)
    except (ShjError, OSError) as error:
        words = str(error)
        return f"{REFUSED}: {words}" if words and "\n" not in words else f"{BREACH} no refusal in one line: {words!r}"
    except Exception as error:  # a traceback is what is looked for
        return f"{BREACH} {type(error).__name__} at {_place(error)}: {str(error)[:200]}"
    return DONE


def _place(error: BaseException) -> str:
    """Last line of our own in the traceback."""
    trace, place = error.__traceback__, ""
    while trace is not None:
        if "shj_bayes" in trace.tb_frame.f_code.co_filename:
            place = f"{Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
        trace = trace.tb_next
    return place


def _watched(asked: argparse.Namespace, number: int, recordings: Path | None) -> dict[str, Any]:
    """Run one case in a process of its own."""
    seed, longest, without = asked.seed, asked.longest, asked.without
    where = [str(recordings)] if recordings else []
    command = [sys.executable, __file__, "--case", str(seed), str(number), str(longest or 0), without or "none", *where]
    row: dict[str, Any] = {"number": number, "case": case(seed, number, recordings, longest=longest).words}
    said, ended = "", ""
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=asked.seconds, check=False)
        said, ended = done.stdout, f"{BREACH} the process ended with status {done.returncode}: {done.stderr[-300:]}"
    except subprocess.TimeoutExpired as error:
        said, ended = (error.stdout or b"").decode(), LATE
    for line in said.splitlines():
        name, words = json.loads(line)
        row[name] = words
    missing = [name for name in STEPS if name not in row and name != without]
    return row | ({missing[0]: ended} if missing else {})


def table(rows: list[dict[str, Any]]) -> str:
    """Count what came of each command, then name each kind of breach with one case that makes it again."""
    words = (DONE, REFUSED, LATE, BREACH)
    lines = [f"{'command':10}" + "".join(f"{word:>10}" for word in words)]
    for name in STEPS:
        own = [row[name] for row in rows if name in row]
        lines.append(f"{name:10}" + "".join(f"{sum(w.startswith(word) for w in own):10}" for word in words))
    breaches = breaches_of(rows)
    lines.append(f"{len(rows)} cases, {len(breaches)} breaches")
    kinds: dict[str, list[tuple[int, str, str]]] = collections.defaultdict(list)
    for number, name, what in breaches:
        kinds[f"{name} {what.split(':')[0]}"].append((number, name, what))
    lines += [f"  {len(own):4} x {own[0][1]} {own[0][2]}   (case {own[0][0]})" for own in kinds.values()]
    return "\n".join(lines)


def breaches_of(rows: list[dict[str, Any]]) -> list[tuple[int, str, str]]:
    """Breaches: number of the case, command, what happened."""
    return [(r["number"], s, r[s]) for r in rows for s in STEPS if str(r.get(s, "")).startswith(BREACH)]


def main() -> int:
    """Read the command line."""
    if sys.argv[1:2] == ["--case"]:
        seed, number, longest, without, *where = sys.argv[2:]
        warnings.simplefilter("ignore")
        with tempfile.TemporaryDirectory() as folder:
            public = Path(where[0]) if where else None
            most = int(longest) or None
            for said in outcomes(int(seed), int(number), public, Path(folder), longest=most, without=without):
                print(json.dumps(said), flush=True)
        return 0
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", type=int, default=200, help="cases (200)")
    parser.add_argument("--seed", type=int, default=1, help="of what is drawn (1)")
    parser.add_argument("--first", type=int, default=0, help="first case (0)")
    parser.add_argument("--seconds", type=float, default=600.0, help="that a case may take (600)")
    parser.add_argument("--longest", type=int, help="most rows of a file, for a quick run; drawn if not given")
    parser.add_argument("--without", choices=STEPS, help="a command that is left out")
    parser.add_argument("--again", action="store_true", help="run cases that are done once more")
    parser.add_argument(
        "--recordings", type=Path, default=ROOT.parent / "shared" / "recordings", help="public recordings"
    )
    asked = parser.parse_args()
    public = asked.recordings if asked.recordings.is_dir() else None
    if public is None:
        print(f"{asked.recordings} is not there: simulated recordings are changed instead", file=sys.stderr)
    BUILD.mkdir(parents=True, exist_ok=True)
    name = f"{'seed' if public else 'simulated'}-{asked.seed}"
    name += "".join(f"-{k}-{v}" for k, v in (("longest", asked.longest), ("without", asked.without)) if v)
    kept = BUILD / f"{name}.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    done = {row["number"]: row for row in map(json.loads, lines)}
    numbers = range(asked.first, asked.first + asked.n)
    with kept.open("a", encoding="utf-8") as file:
        for number in numbers:
            if number in done and not asked.again:
                continue
            row = done[number] = _watched(asked, number, public)
            said = ", ".join(f"{name} {row[name][:90]}" for name in STEPS if name in row)
            print(f"{number:4} {row['case']}: {said}", flush=True)
            file.write(json.dumps(row) + "\n")
            file.flush()
    rows = [done[number] for number in numbers]
    print(table(rows))
    return int(bool(breaches_of(rows)))


if __name__ == "__main__":
    sys.exit(main())
