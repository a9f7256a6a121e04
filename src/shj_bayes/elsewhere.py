"""Libraries that look for settings in the current folder are imported from another one.

A recording from elsewhere may come with a ``.numba_config.yaml``, which can name the folder of numba's cache; what is
in that cache is run. A ``matplotlibrc`` can call LaTeX, an ``arvizrc`` can stop the import. Settings in the home folder
and in the environment hold as before.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

LOOK_HERE = frozenset({"arviz", "matplotlib", "numba", "numba.core.config"})
_AWAY = os.path.dirname(os.__file__)  # the standard library: may stand in for "", the current folder, on the path


class _Elsewhere(MetaPathFinder):
    """Finds nothing itself: it has the modules of `LOOK_HERE` run in another folder."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        if name not in LOOK_HERE:
            return None
        others = (finder for finder in sys.meta_path if finder is not self)
        spec = next((found for finder in others if (found := finder.find_spec(name, path, target))), None)
        loader: Any = spec and spec.loader
        if loader is not None:
            loader.exec_module = _away(loader.exec_module)
        return spec


def _away(run: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def run_elsewhere(module: ModuleType) -> None:
        with _moved():
            run(module)
        if module.__name__ == "numba.core.config":  # numba reads the file again at every function that it compiles
            vars(module)["_config_fname"] = os.path.join(_AWAY, vars(module)["_config_fname"])

    return run_elsewhere


@contextmanager
def _moved() -> Iterator[None]:
    """Be in another folder for a while."""
    try:
        here = os.getcwd()
    except OSError:  # the folder was deleted, so nothing lies in it
        here = ""
    if not (here and os.access(here, os.X_OK)):  # nothing in it can be opened, and there is no way back
        yield
        return
    os.chdir(_AWAY)
    try:
        yield
    finally:
        os.chdir(here)


def import_elsewhere() -> None:
    """Put the rule into force for this process."""
    if not any(isinstance(finder, _Elsewhere) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Elsewhere())
