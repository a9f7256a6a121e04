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
# In the order in which the data walk through them; what stands at the ends is used by all, and uses all.
ROOMS = (
    "_util",
    "recording",
    "model",
    "results",
    "inference",
    "mismatch",
    "population",
    "margins",
    "planning",
    "report",
    "app",
    "bench",
)
FACE = ("__main__", "api", "cli")  # alone leads to what validates
EXPLAINED = ("_util", "recording", "model", "results", "inference")


def modules(room: str) -> list[Path]:
    """Source files of a room."""
    return sorted((PACKAGE / room).rglob("*.py"))


def imported_rooms(path: Path) -> set[str]:
    """Rooms of this package that a file imports from, wherever in the file, and the package that validates it."""
    names: list[str] = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names += [node.module] + [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
    rooms = {name.split(".")[1] for name in names if name.startswith("shj_bayes.")}
    return rooms | {name.split(".")[0] for name in names} & {"shj_validation"}


@pytest.mark.parametrize(
    "path", [p for room in ROOMS for p in modules(room)], ids=lambda p: str(p.relative_to(PACKAGE))
)
def test_imports_run_one_way(path: Path) -> None:
    """The same rule as the import-linter contract, but also where that is not installed."""
    room = path.relative_to(PACKAGE).parts[0]
    forbidden = {*ROOMS[ROOMS.index(room) + 1 :], *FACE, "shj_validation"}
    assert not imported_rooms(path) & forbidden


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_are_looked_at(room: str) -> None:
    """A room that moves away must not take its tests with it."""
    assert len(modules(room)) > 4


def test_every_folder_is_a_room() -> None:
    """A new room needs its place in the order."""
    assert {path.parent.name for path in PACKAGE.glob("*/__init__.py")} == set(ROOMS)


def test_the_root_is_the_public_face_alone() -> None:
    """Whatever does something stands in a room."""
    assert {path.stem for path in PACKAGE.glob("*.py")} == {"__init__", "errors", "options", *FACE}


def test_import_contract() -> None:
    """The contract of pyproject.toml, including imports through other modules."""
    if "importlinter" not in tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8")).get("tool", {}):
        pytest.skip("pyproject.toml holds no [tool.importlinter]")
    command = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip("import-linter is not installed")
    done = subprocess.run([command, "--no-cache"], cwd=TOP, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    "path", [p for room in EXPLAINED for p in modules(room)], ids=lambda p: str(p.relative_to(PACKAGE))
)
def test_public_things_are_explained(path: Path) -> None:
    """Module, public functions, classes and methods have a docstring of more than one word."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert ast.get_docstring(tree)
    hidden = {
        inner
        for outer in ast.walk(tree)
        if isinstance(outer, ast.FunctionDef) or (isinstance(outer, ast.ClassDef) and outer.name.startswith("_"))
        for inner in ast.walk(outer)
        if inner is not outer
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_") and node not in hidden:
            text = ast.get_docstring(node)
            assert text, f"{path.stem}.{node.name}"
            assert len(text.split()) >= 2, f"{path.stem}.{node.name}"


@pytest.mark.parametrize(
    "path", [p for room in EXPLAINED for p in modules(room)], ids=lambda p: str(p.relative_to(PACKAGE))
)
def test_described_parameters_are_the_parameters(path: Path) -> None:
    """A "Parameters" section names the arguments (or fields) that there are, in their order."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        described = section(ast.get_docstring(node) or "")
        if not described:
            continue
        if isinstance(node, ast.ClassDef):
            made = next((s for s in node.body if isinstance(s, ast.FunctionDef) and s.name == "__init__"), None)
            fields = [s.target.id for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)]
            fields += [x.arg for x in made.args.args[1:]] if made else []
            actual = [name for name in fields if not name.startswith("_")]
        else:
            a = node.args
            actual = [x.arg for x in a.args if x.arg not in ("self", "cls")]
            actual += [f"*{a.vararg.arg}"] if a.vararg else []
            actual += [x.arg for x in a.kwonlyargs] + ([f"**{a.kwarg.arg}"] if a.kwarg else [])
        assert described == actual, f"{path.stem}.{node.name}"


def section(docstring: str) -> list[str]:
    """Names in the "Parameters" section of a numpydoc docstring."""
    lines = docstring.splitlines()
    if "Parameters" not in lines:
        return []
    names: list[str] = []
    first = lines.index("Parameters") + 2
    for line, below in zip(lines[first:], [*lines[first + 1 :], ""], strict=True):
        if below.startswith("---"):  # the title of the next section
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
