"""What the modules of a package hold, found by being there."""

import importlib
import sys
from pathlib import Path

import pytest

from shj_bayes._util.imports import discovered
from shj_bayes.errors import ShjError

TOOLS = "from types import SimpleNamespace\nTOOLS = tuple(SimpleNamespace(id=word) for word in ({words},))\n"


def test_a_file_is_enough_and_no_id_stands_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "shelf"
    folder.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    (folder / "__init__.py").write_text("")
    (folder / "helpers.py").write_text("HALF = 0.5\n")
    (folder / "levers.py").write_text(TOOLS.format(words="'lever', 'crank'"))
    (folder / "wedges.py").write_text(TOOLS.format(words="'wedge'"))
    shelf = importlib.import_module("shelf")
    assert [tool.id for tool in discovered(shelf, "TOOLS")] == ["lever", "crank", "wedge"]
    (folder / "wrong.py").write_text(TOOLS.format(words="'crank'"))
    importlib.invalidate_caches()
    with pytest.raises(ShjError, match="shelf: crank stands in TOOLS twice"):
        discovered(shelf, "TOOLS")
    for name in [name for name in sys.modules if name.split(".")[0] == "shelf"]:
        monkeypatch.delitem(sys.modules, name)
