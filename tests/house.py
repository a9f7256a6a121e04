"""How the tree of the package stands, and the limits that it must hold: ``python tests/house.py``.

Lines, files, classes, layers, circles and result files are counted in the sources; a figure above its limit ends it
with 1, so that what was reached is held.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SRC = ROOT / "src" / "shj_bayes"
RESULTS = re.compile(r"\b(fit|diagnosis|campaign|population|summary|residual)\.json\b|\b(posterior|diagnosis)\.nc\b")
READS = re.compile(r"\b(read_json|open_dataset|open_group|InferenceData|from_netcdf|json\.loads?)\(")
LIMITS = {
    "lines": 36_531,
    "files": 142,
    "dataclasses": 165,
    "class names that exist twice": 0,
    "methods of the largest class": 12,
    "modules that open a result file": 1,
    "layers of the import contract": 12,
    "modules in circles of imports": 0,
}


def counted() -> dict[str, int]:
    """Every figure of `LIMITS`."""
    files = sorted(SRC.rglob("*.py"))
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    trees = {path: ast.parse(text) for path, text in texts.items()}
    classes = [node for tree in trees.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    twice = [name for name, n in Counter(node.name for node in classes).items() if n > 1]
    opened = [path for path, text in texts.items() if RESULTS.search(text) and READS.search(text)]
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    return {
        "lines": sum(len(text.splitlines()) for text in texts.values()),
        "files": len(files),
        "dataclasses": sum(any("dataclass" in ast.unparse(d) for d in node.decorator_list) for node in classes),
        "class names that exist twice": len(twice),
        "methods of the largest class": max(sum(isinstance(n, ast.FunctionDef) for n in node.body) for node in classes),
        "modules that open a result file": len(opened),
        "layers of the import contract": len(contract[0]["layers"]),
        "modules in circles of imports": len(in_circles(imports_of(trees))),
    }


def imports_of(trees: dict[Path, ast.Module]) -> dict[str, set[str]]:
    """Modules that each module imports when it is loaded."""
    names = {path: ".".join(path.relative_to(SRC.parent).with_suffix("").parts) for path in trees}
    known = set(names.values())
    found: dict[str, set[str]] = {}
    for path, tree in trees.items():
        wanted: set[str] = set()
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and node.module:
                wanted |= {node.module, *(f"{node.module}.{one.name}" for one in node.names)}
            elif isinstance(node, ast.Import):
                wanted |= {one.name for one in node.names}
        found[names[path]] = (wanted & known) - {names[path]}
    return found


def in_circles(imports: dict[str, set[str]]) -> set[str]:
    """Modules that reach themselves through what they import."""
    reached = {name: set(wanted) for name, wanted in imports.items()}
    for middle in imports:
        for name, own in reached.items():
            if middle in own:
                reached[name] = own | reached[middle]
    return {name for name, own in reached.items() if name in own}


def main() -> int:
    """Print the table."""
    figures = counted()
    print("| | now | limit |\n|---|---|---|")
    for name, figure in figures.items():
        print(f"| {name} | {figure} | {LIMITS[name]}{' EXCEEDED' if figure > LIMITS[name] else ''} |")
    return int(any(figure > LIMITS[name] for name, figure in figures.items()))


if __name__ == "__main__":
    sys.exit(main())
