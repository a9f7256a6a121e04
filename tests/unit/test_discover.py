"""What a package holds, one thing a module."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError


def test_a_file_is_enough_and_carries_the_id(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "shelf"
    folder.mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    (folder / "__init__.py").write_text("")
    (folder / "helpers.py").write_text("HALF = 0.5\n")
    (folder / "lever.py").write_text("from types import SimpleNamespace\nTOOL = SimpleNamespace(id='lever')\n")
    shelf = importlib.import_module("shelf")
    assert list(discovered(shelf, "TOOL", ModelError)) == [SimpleNamespace(id="lever")]
    (folder / "wrong.py").write_text("from shelf.lever import TOOL\n")
    importlib.invalidate_caches()
    with pytest.raises(ModelError, match=r"shelf/wrong\.py holds tool 'lever'; the file carries the tool's id"):
        list(discovered(shelf, "TOOL", ModelError))
    for name in [name for name in sys.modules if name.split(".")[0] == "shelf"]:
        monkeypatch.delitem(sys.modules, name)
