"""What a package holds, found module by module: adding a file is enough, nothing is registered."""

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import Any

from shj_bayes.errors import ShjError


def constants(package: ModuleType, constant: str) -> Iterator[tuple[str, Any]]:
    """Modules of a package that hold a constant: name of the module and its value, by name."""
    for module in pkgutil.iter_modules(package.__path__):
        value = getattr(importlib.import_module(f"{package.__name__}.{module.name}"), constant, None)
        if value is not None:
            yield module.name, value


def discovered(package: ModuleType, constant: str, error: type[ShjError]) -> Iterator[Any]:
    """Value of a constant such as ``EFFECT`` in every module that holds one; `error` where its id is not its file's."""
    folder = package.__name__.rpartition(".")[2]
    for name, value in constants(package, constant):
        if value.id != name:
            what = constant.lower()
            raise error(f"{folder}/{name}.py holds {what} '{value.id}'; the file carries the {what}'s id")
        yield value
