"""The shape of the code: imports run one way, and what is public is explained."""

import ast
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import shj_bayes

PACKAGE = Path(shj_bayes.__file__).resolve().parent
TOP = Path(__file__).resolve().parents[2]
ROOMS = ("recording", "model", "inference")  # in the order the data walk through them
LATER = ("mismatch", "validation", "population", "report", "campaign", "pipeline", "cli")


def modules(room: str) -> list[Path]:
    """Source files of a room."""
    return sorted((PACKAGE / room).rglob("*.py"))


def imported_rooms(path: Path) -> set[str]:
    """Rooms of this package that a file imports from, wherever in the file."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module] + [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    return {name.split(".")[1] for name in names if name.startswith("shj_bayes.")}


@pytest.mark.parametrize(
    "path", [p for room in ROOMS for p in modules(room)], ids=lambda p: str(p.relative_to(PACKAGE))
)
def test_imports_run_one_way(path: Path) -> None:
    """The same rule as the import-linter contract, but also where that is not installed."""
    room = path.relative_to(PACKAGE).parts[0]
    forbidden = {*ROOMS[ROOMS.index(room) + 1 :], *LATER}
    assert not imported_rooms(path) & forbidden


def test_import_contract() -> None:
    """The contract of pyproject.toml, including imports through other modules."""
    if "importlinter" not in tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8")).get("tool", {}):
        pytest.skip("pyproject.toml holds no [tool.importlinter]")
    command = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip("import-linter is not installed")
    done = subprocess.run([command, "--no-cache"], cwd=TOP, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("path", [p for room in ("model", "inference") for p in modules(room)], ids=lambda p: p.stem)
def test_public_things_are_explained(path: Path) -> None:
    """Module, public functions, classes and methods have a docstring of more than one word."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            nested = any(
                node in ast.walk(f) and node is not f for f in ast.walk(tree) if isinstance(f, ast.FunctionDef)
            )
            if not nested:
                text = ast.get_docstring(node)
                assert text, f"{path.stem}.{node.name}"
                assert len(text.split()) >= 2, f"{path.stem}.{node.name}"


@pytest.mark.parametrize("path", [p for room in ("model", "inference") for p in modules(room)], ids=lambda p: p.stem)
def test_described_parameters_are_the_parameters(path: Path) -> None:
    """A "Parameters" section names the arguments (or fields) that there are, in their order."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        described = section(ast.get_docstring(node) or "")
        if not described:
            continue
        if isinstance(node, ast.ClassDef):
            fields = [s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)]
            actual = [name for name in fields if not name.startswith("_")]
        else:
            a = node.args
            actual = [x.arg for x in (*a.args, *a.kwonlyargs) if x.arg not in ("self", "cls")]
            actual += [f"**{a.kwarg.arg}"] if a.kwarg else []
        assert described == actual, f"{path.stem}.{node.name}"


def section(docstring: str) -> list[str]:
    """Names in the "Parameters" section of a numpydoc docstring."""
    lines = docstring.splitlines()
    if "Parameters" not in lines:
        return []
    names: list[str] = []
    for line in lines[lines.index("Parameters") + 2 :]:
        if line.startswith("---") or (line and not line.startswith(" ") and " : " not in line):
            break
        if line and not line.startswith(" "):
            names += [name.strip() for name in line.split(" : ")[0].split(",")]
    return names


def test_no_global_random_stream() -> None:
    """One random stream, carried by hand: no call of np.random.seed, rand, normal and their like."""
    allowed = {"default_rng", "SeedSequence", "Generator", "RandomState", "MT19937"}
    for room in ROOMS:
        for path in modules(room):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if (
                    isinstance(node, ast.Attribute)
                    and isinstance(node.value, ast.Attribute)
                    and node.value.attr == "random"
                ):
                    assert node.attr in allowed, f"{path.name}:{node.lineno} np.random.{node.attr}"
