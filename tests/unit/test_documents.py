"""The documents: their commands and options exist, their snippets parse, their links lead somewhere.

Nothing long is run; ``make demo`` and the tests of the rooms do that.
"""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import click
import pytest

from shj_bayes import __version__
from shj_bayes.app.manifest import SCHEMA, read_manifest
from shj_bayes.cli import main
from shj_bayes.inference.convergence import RHAT_LIMIT
from shj_bayes.model.priors import read_priors, shipped_families
from shj_bayes.results.fit import ParameterRow

TOP = Path(__file__).resolve().parents[2]
FOLDERS = ("docs", "data", "priors", "reports")
# tests/ and .venv hold no documents; reports/ may hold what users built
PAGES = sorted(
    {
        *TOP.glob("*.md"),
        *(page for folder in FOLDERS for page in (TOP / folder).glob("*.md")),
        *TOP.glob("docs/*/*.md"),
        *TOP.glob("data/*/README.md"),
    }
)
FENCE = re.compile(r"^```(?P<kind>\w*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"`(shj-bayes [^`]+)`")
LINK = re.compile(r"\]\((?P<target>[^)\s]+)\)")
MACHINE_PATH = re.compile(r"(?<![\w.])(/(home|root|work|tmp|Users|usr|var|opt|mnt)/|[A-Z]:\\)")
ADDRESS = re.compile(r"https?://|pypi|conda|github\.com", re.IGNORECASE)
SECRETARIAL = {"CHANGELOG.md", "README.md", "CONTRIBUTING.md", "SECURITY.md", "CITATION.cff"}


def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def snippets(page: Path, kind: str) -> list[str]:
    return [match["body"] for match in FENCE.finditer(text(page)) if match["kind"] == kind]


def lines_of_shell(content: str) -> Iterator[str]:
    """Lines that call the command in code blocks, and whole commands in running text that carry an option."""
    for match in FENCE.finditer(content):
        if match["kind"] == "sh":
            yield from (line for line in match["body"].splitlines() if line.startswith("shj-bayes"))
    for command in INLINE.findall(FENCE.sub("", content)):
        if " ..." not in command and re.search(r"\s-", command):
            yield command


def complaint(line: str) -> str | None:
    """What is wrong with a command line, None when click would take it; nothing is run."""
    words = shlex.split(line, comments=True)[1:]
    if words and words[0] in {"--help", "-h", "--version"}:
        return None
    if not words or words[0] not in main.commands:
        return f"no such command: {words[:1]}"
    if "--help" in words:
        return None
    command = main.commands[words[0]]
    try:
        command.make_context(words[0], words[1:], parent=click.Context(main))
    except click.UsageError as error:
        return error.format_message()
    return None


def prepared(page: Path) -> Iterator[str]:
    yield from lines_of_shell(text(page))


def local_targets(page: Path) -> list[str]:
    targets = [match["target"] for match in LINK.finditer(FENCE.sub("", text(page)))]
    return [target.partition("#")[0] for target in targets if not target.startswith(("#", "http", "mailto"))]


def citation(content: str) -> dict[str, str]:
    """Top-level ``key: value`` lines; the file is simple enough for that."""
    pairs = re.findall(r"^([a-z-]+):[ ]*(.*)$", content, re.MULTILINE)
    return {key: value.strip().strip('"') for key, value in pairs}


@pytest.fixture(params=PAGES, ids=lambda page: page.relative_to(TOP).as_posix())
def page(request: pytest.FixtureRequest) -> Path:
    found: Path = request.param
    return found


def test_the_documents_are_there() -> None:
    names = {page.relative_to(TOP).as_posix() for page in PAGES}
    wanted = {f"docs/{name}.md" for name in ("README", "start", "recordings", "priors", "manifest", "results")}
    assert wanted <= names
    assert all((TOP / name).is_file() for name in SECRETARIAL)


def test_commands_and_options_exist(page: Path) -> None:
    wrong = {line: reason for line in prepared(page) if (reason := complaint(line))}
    assert not wrong


def test_every_command_is_shown_in_the_readme() -> None:
    shown = {line.split()[1] for line in lines_of_shell(text(TOP / "README.md"))}
    assert set(main.commands) <= shown


def test_the_two_commands_come_first() -> None:
    first = snippets(TOP / "README.md", "sh")[0].splitlines()
    assert first == ["make demo", "make test"]
    before = text(TOP / "README.md").partition("make demo")[0]
    assert before.count("\n") < 12


def test_make_targets_exist(page: Path) -> None:
    named = set(re.findall(r"`make ([a-z-]+)`", text(page))) | {
        line.split()[1] for body in snippets(page, "sh") for line in body.splitlines() if line.startswith("make ")
    }
    targets = set(re.findall(r"^\.PHONY: (.*)$", text(TOP / "Makefile"), re.MULTILINE)[0].split())
    assert named <= targets


def test_scripts_that_are_named_exist(page: Path) -> None:
    named = re.findall(r"`(?:[\w./-]*python\S*|py -3\.11) ([\w/]+\.py)", text(page))
    named += [
        w
        for w in re.findall(r"`((?:src|validation|tests|benchmarks|docs|data)/[\w./-]+\.\w+)`", text(page))
        if "ID" not in w
    ]
    assert [name for name in named if not (TOP / name).is_file()] == []


def test_links_lead_somewhere(page: Path) -> None:
    assert [target for target in local_targets(page) if not (page.parent / target).exists()] == []


def test_what_is_linked_is_kept() -> None:
    """A page of results that `.gitignore` leaves out is there for the author and for nobody else."""
    git = shutil.which("git")
    targets = [str((page.parent / target).resolve()) for page in PAGES for target in local_targets(page)]
    if git is None or not (TOP / ".git").exists():
        pytest.skip("no git, or no repository")
    answer = subprocess.run([git, "check-ignore", *targets], cwd=TOP, capture_output=True, text=True, check=False)
    assert answer.stdout == ""


def test_no_machine_paths_and_no_addresses(page: Path) -> None:
    assert MACHINE_PATH.search(text(page)) is None
    assert ADDRESS.search(text(page)) is None


def test_python_snippets_parse(page: Path) -> None:
    for body in snippets(page, "python"):
        ast.parse(body)


def test_toml_snippets_parse_and_are_accepted(page: Path, tmp_path: Path) -> None:
    for number, body in enumerate(snippets(page, "toml")):
        table = tomllib.loads(body)
        file = tmp_path / f"{number}.toml"
        file.write_text(body, encoding="utf-8")
        if table["schema"] == SCHEMA:
            assert read_manifest(file).devices
        else:
            assert read_priors(file).priors


def test_manifest_page_lists_every_option() -> None:
    from shj_bayes.app.manifest import OPTIONS  # noqa: PLC0415

    rows = set(re.findall(r"^\| `(\w+)` \|", text(TOP / "docs/manifest.md"), re.MULTILINE))
    assert rows == set(OPTIONS)


def test_recordings_page_lists_every_code() -> None:
    source = "".join(text(path) for path in (TOP / "src/shj_bayes/recording").glob("*.py"))
    codes = set(re.findall(r"Finding\(\s*\"([a-z-]+)\"", source)) | set(re.findall(r"code = \"([a-z-]+)\"", source))
    shown = set(re.findall(r"`([a-z-]+)`", text(TOP / "docs/recordings.md")))
    assert len(codes) > 25
    assert sorted(codes - shown) == []


def test_pages_say_what_the_code_does() -> None:
    results = text(TOP / "docs/results.md")
    assert all(f"`{column}`" in results for column in (one.name for one in fields(ParameterRow)))
    assert f"R-hat below {RHAT_LIMIT}" in results
    families = re.findall(r"^\| `(\w+)`", text(TOP / "priors/README.md"), re.MULTILINE)
    assert sorted(families) == shipped_families()


def test_citation_is_whole() -> None:
    content = text(TOP / "CITATION.cff")
    fields = citation(content)
    assert {"cff-version", "message", "title", "authors", "version"} <= set(fields)
    assert fields["cff-version"] == "1.2.0"
    assert fields["version"] == __version__
    assert re.search(r"^authors:\n  - name: \"The shj-bayes developers\"$", content, re.MULTILINE)
    assert "\t" not in content


def test_pictures_are_small_pngs() -> None:
    pictures = [TOP / target for target in local_targets(TOP / "README.md") if target.endswith(".png")]
    assert len(pictures) == 2
    for picture in pictures:
        raw = picture.read_bytes()
        assert raw.startswith(b"\x89PNG")
        assert len(raw) < 300_000


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("shj-bayes measure run1.csv", "no such command: ['measure']"),
        ("shj-bayes fit run1.csv", "--out"),
        ("shj-bayes fit run1.csv -o results --model seeds", "'seeds'"),
        ("shj-bayes check run1.csv --unit mm", "--unit"),
        ("shj-bayes compare tables onlyone", "'B'"),
    ],
)
def test_wrong_command_lines_are_noticed(line: str, wrong: str) -> None:
    assert wrong in (complaint(line) or "")


def test_wrong_pages_are_noticed(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("see [there](gone.md)\n\n```sh\nshj-bayes fly\n```\n/home/me/x\n", encoding="utf-8")
    assert local_targets(page) == ["gone.md"]
    assert [complaint(line) for line in prepared(page)] == ["no such command: ['fly']"]
    assert MACHINE_PATH.search(text(page))
    assert snippets(page, "sh") == ["shj-bayes fly\n"]
