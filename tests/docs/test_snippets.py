"""Every snippet of the documents runs: commands through the parser and the rooms, Python as it stands.

Long work is made short in ways that leave the words of the documents as they are: the recordings beside them are
small, samplers are stopped after few steps, a plan weighs three patterns, the published tables are three sets of them,
and workbooks have few rows. What that leaves out is shown by ``make demo``, the slow tests, and the tests of the rooms.
"""

import json
import re
import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import savemat

from shj_bayes.app import design, device
from shj_bayes.cli import EXAMPLES, examples_of, main
from shj_bayes.inference import convergence
from shj_bayes.model.simulate import Truth
from shj_bayes.planning import protocol
from shj_bayes.population.device import published_devices
from shj_bayes.recording.motion import Block
from shj_bayes.report.browse import find_browser

TOP = Path(__file__).resolve().parents[2]
FENCE = re.compile(r"^```(?P<kind>\w*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
WORKERS = re.compile(
    r" --(workers \d+|dask \S+)"
)  # changes nothing but the time it takes (and there is no cluster here)
FOLDERS = ("docs", "docs/guides", "docs/method", "docs/reference")
# Pages whose commands need what only their own rooms make; test_documents holds them to the parser.
APART = ("proof.md", "security.md", "speed.md")
PAGES = [
    TOP / "README.md",
    *(p for folder in FOLDERS for p in sorted((TOP / folder).glob("*.md")) if p.name not in APART),
]
# Run elsewhere: the proof has tests of its own, the demo is `make demo`, and a bench serves until it is ended.
ELSEWHERE = ("prove", "demo", "bench")
RUN_FIRST = ("simulate", "check", "fit", "diagnose", "tables", "campaign")
TRUTH = Truth(gamma=1 / 60)
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2), Block(48.0, 0.034, 3))
SETS = ("Zinc 70", "Zinc 70 corroded", "Zinc 100")  # a pair of each kind that is compared
MANIFEST = """
schema = "shj-bayes/campaign/1"
name = "Spring"
diagnose = "off"
[defaults]
max_steps = 800
[[set]]
name = "bare"
[[set.device]]
name = "A1"
recordings = ["run1.csv", "run2.csv"]
[[set]]
name = "zinc 70 %"
[[set.device]]
name = "B1"
recordings = ["plain-run1.csv", "plain-run2.csv"]
"""


def snippets(kind: str) -> list[tuple[str, str]]:
    """Page and content of every snippet of a kind."""
    return [
        (page.relative_to(TOP).as_posix(), match["body"])
        for page in PAGES
        for match in FENCE.finditer(page.read_text(encoding="utf-8"))
        if match["kind"] == kind
    ]


def commands() -> list[str]:
    """Every command line of the documents and of the help, once, in an order in which each finds what it needs."""
    lines = [line for _, body in snippets("sh") for line in body.splitlines() if line.startswith("shj-bayes")]
    lines += EXAMPLES.split("\n")[1:-1]
    plain = {shlex.join(shlex.split(WORKERS.sub("", line), comments=True)[1:]) for line in lines}
    known = {line for line in plain if line.split()[0] in main.commands}  # one to come has its examples already
    order = {name: place for place, name in enumerate(RUN_FIRST)}
    return sorted(known, key=lambda line: (order.get(line.split()[0], len(order)), line))


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory, no_workers: None, brief_workbooks: None) -> Iterator[Path]:
    """A folder with the files that the documents speak of; chains are cut short."""
    folder = tmp_path_factory.mktemp("desk")
    few = tuple(d for d in published_devices() if d.set_name in SETS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(device, "table_1", lambda _: BLOCKS)
        patch.setattr(protocol, "PATTERNS", dict(list(protocol.PATTERNS.items())[:3]))
        patch.setattr(protocol, "MOST_TIMES", 2)
        patch.setattr(design, "published_devices", lambda: few)
        for limit, loose in (("RHAT_LIMIT", 2.0), ("ESS_LIMIT", 100.0), ("TAU_LIMIT", 1.0)):
            patch.setattr(convergence, limit, loose)
        patch.chdir(folder)
        write_files(folder)
        yield folder


def write_files(folder: Path) -> None:
    """Write the files that the documents speak of."""
    for number, stem in enumerate(("run", "plain-run"), start=3):
        made = device.write_simulated(folder / "x", TRUTH, seed=number, rate_Hz=3.0)
        for run, path in enumerate(made[:2], start=1):
            path.rename(folder / f"{stem}{run}.csv")
    rows = [line.split(",") for line in (folder / "run1.csv").read_text(encoding="utf-8").splitlines()[2:]]
    texts = [f"{1000 * float(t):.6g},0,0,0,{x},0,{1000 * float(f):.7g}" for t, x, f in rows]
    (folder / "test.txt").write_text("\n".join(texts) + "\n", encoding="utf-8")
    table = np.array(rows, dtype=float)
    german = [f"{1000 * float(t):.0f};{float(x) / 10:.6f};{1000 * float(f):.3f}".replace(".", ",") for t, x, f in rows]
    (folder / "own.csv").write_text("Time [ms];Hub [cm];Kraft [N]\n" + "\n".join(german) + "\n", encoding="utf-8")
    heads = "time (s),LVDT 2 (mm),Load A (kN)\n"
    (folder / "test.csv").write_text(heads + "\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    bolts = [f"{t},{x},{f},180,21.5" for t, x, f in rows]
    heads = "Time (s),Displacement (mm),Force (kN),Bolt load (kN),Plate (degC)\n"
    (folder / "bolts.csv").write_text(heads + "\n".join(bolts) + "\n", encoding="utf-8")
    np.savetxt(folder / "seal.txt", np.loadtxt(folder / "test.txt", delimiter=","), fmt="%.9g")
    emps = {"t": table[:, 0], "qm": table[:, 1] / 1e3, "gtau": np.array([[35.0]]), "vir": table[:, 2] * 1e3 / 35}
    savemat(folder / "DATA_EMPS.mat", emps)
    (folder / "campaign.toml").write_text(MANIFEST, encoding="utf-8")
    (folder / "spring.toml").write_text(MANIFEST.rpartition("[[set]]")[0], encoding="utf-8")  # of the first set alone
    _, priors = next(s for s in snippets("toml") if s[0] == "docs/priors.md")
    (folder / "my-device.toml").write_text(priors, encoding="utf-8")
    (folder / "made").mkdir()
    (folder / "made" / "campaign.toml").write_text(MANIFEST.replace('"run', '"../run').replace('"plain', '"../plain'))


def run(line: str) -> str | None:
    """Run one command line; what is wrong, or None."""
    words = shlex.split(line)
    if words[0] == "diagnose" and "--quick" not in words:
        words += ["--quick"]
    done = CliRunner().invoke(main, words)
    # A reader's fit ends reliable and leaves no checkpoint; another fit into the same folder would refuse this one.
    for checkpoint in Path.cwd().glob("*/checkpoint.h5"):
        checkpoint.unlink()
    return None if done.exit_code == 0 else f"{line}: {done.output[-300:]} {done.exception!r}"


def test_commands_run(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("webbrowser.open", lambda *_: True)
    lines = [line for line in commands() if line.split()[0] not in ELSEWHERE]
    made = {
        "shj-bayes-demo": "the demo's own folder",
        "--priors-from": "results that other pages make",
        "displacement=force": "columns that are wrong on purpose",
    }
    if find_browser() is None:
        made["--pdf"] = "a page printed by a browser that is not installed here"
    lines = [line for line in lines if not any(word in line for word in made)]
    # Recordings that a page speaks of but does not make: any two runs will do.
    for line in lines:
        for word in shlex.split(line):
            path = desk / word
            if word.endswith(".csv") and not word.startswith("made/") and not path.exists():
                shutil.copy(desk / ("run2.csv" if "run2" in word else "run1.csv"), path)
    wrong = [fault for line in lines if (fault := run(line))]
    assert wrong == []
    assert len(lines) > 20


# ArviZ's own, of newer pandas; and what it says of a short fit with slack, which a page compares with the law alone.
@pytest.mark.filterwarnings(r"ignore:\s*ArviZ is undergoing a major refactor")  # said when a user imports it first
@pytest.mark.filterwarnings("ignore:The inplace keyword in DataFrame.sort_values")
@pytest.mark.filterwarnings("ignore:Estimated shape parameter of Pareto distribution")
def test_python_runs(desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import matplotlib as mpl  # noqa: PLC0415

    mpl.use("Agg")
    if not (desk / "results" / "posterior.nc").exists():
        run("fit run1.csv run2.csv -o results")
    run("fit run1.csv run2.csv -o with-slack --effects slack")  # a page compares the two
    if not (desk / "tables").exists():
        assert run("tables -o tables") is None
    for page, body in snippets("python"):
        try:
            exec(compile(body, page, "exec"), {"__name__": "snippet"})
        except Exception as error:
            raise AssertionError(f"{page}: {error!r}\n{body}") from error
    assert "kN" in capsys.readouterr().out


def test_the_notebook_runs(desk: Path) -> None:
    notebook = json.loads((TOP / "docs/guides/first-notebook.ipynb").read_text(encoding="utf-8"))
    space: dict[str, object] = {"__name__": "notebook"}
    for cell in notebook["cells"]:
        assert cell["source"]
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile(cell["source"], cell["id"], "exec"), space)
    assert 0 <= float(space["chance"]) <= 1  # type: ignore[arg-type]


def test_every_command_has_examples_that_its_help_shows() -> None:
    for name, command in main.commands.items():
        shown = CliRunner().invoke(main, [name, "--help"]).output
        examples = examples_of(name)
        assert examples, name
        assert all(f"{example}\n" in shown for example in examples), name
        assert command.help
