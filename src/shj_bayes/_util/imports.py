"""How modules are imported: libraries from a safe folder, and what a package holds, found module by module.

Libraries that look for settings in the current folder are imported from another one. A recording from elsewhere may
come with a ``.numba_config.yaml``, which can name the folder of numba's cache; what is in that cache is run. A
``matplotlibrc`` can call LaTeX, an ``arvizrc`` can stop the import. Settings in the home folder and in the environment
hold as before.
"""

import atexit
import importlib
import os
import pkgutil
import shutil
import sys
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from tempfile import TemporaryDirectory, mkdtemp
from types import ModuleType
from typing import Any

from shj_bayes.errors import ShjError

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
        with _moved(), _stampless() if module.__name__ == "arviz" else nullcontext():
            run(module)
        if module.__name__ == "numba":
            _cache_somewhere(module)
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


def _cache_somewhere(numba: Any) -> None:
    """Give numba a cache of this process's own, where it could write into none: it ends there, in a traceback."""
    try:
        numba.njit(cache=True)(_stand_in)
    except RuntimeError:
        folder = mkdtemp(prefix="shj-bayes-")  # private: what lies in a cache is run
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        os.environ["NUMBA_CACHE_DIR"] = folder  # for workers, too


def _stand_in() -> None:
    """Stand for the functions that are compiled; it never is."""


@contextmanager
def _stampless() -> Iterator[None]:
    """Let ArviZ note the day of its last announcement in a folder that can be written into; it ends where it cannot."""
    try:
        library: Any = importlib.import_module("platformdirs")
    except ImportError:  # an ArviZ that notes nothing
        yield
        return
    before = library.user_cache_dir
    with TemporaryDirectory() as scratch:
        library.user_cache_dir = lambda *_, **__: scratch
        try:
            yield
        finally:
            library.user_cache_dir = before


@contextmanager
def without(*names: str) -> Iterator[None]:
    """Import a library as if others, slow to import and used only where they are there, were not installed."""
    hidden = [name for name in names if name not in sys.modules]
    nowhere: Any = None  # what makes an import say that there is no such module
    sys.modules.update(dict.fromkeys(hidden, nowhere))
    try:
        yield
    finally:
        for name in hidden:
            sys.modules.pop(name, None)


def arviz() -> Any:
    """ArviZ, before and after its rewrite; without the announcement of version 0.23, and without numba."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing a major refactor", category=FutureWarning)
        library: Any = importlib.import_module("arviz")
    numba: Any = vars(library).get("Numba")  # version 1 has none
    if numba is not None:
        numba.disable_numba()  # it compiles its variance anew in every process, which takes longer than it ever saves
    return library


def import_elsewhere() -> None:
    """Put the rule into force for this process."""
    if not any(isinstance(finder, _Elsewhere) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Elsewhere())


def discovered(package: ModuleType, constant: str) -> list[Any]:
    """Values of the tuples of that name, such as ``EFFECTS``, in all modules of a package; no two of one id."""
    modules = (
        importlib.import_module(f"{package.__name__}.{one.name}") for one in pkgutil.iter_modules(package.__path__)
    )
    found = [value for module in modules for value in getattr(module, constant, ())]
    twice = [name for name, n in Counter(value.id for value in found).items() if n > 1]
    if twice:
        raise ShjError(f"{package.__name__}: {', '.join(twice)} stands in {constant} twice; an id is that of one alone")
    return found
