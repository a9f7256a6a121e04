"""All design codes: every module of this package that holds a ``CODE``; adding a file is enough."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from shj_bayes.errors import PopulationError
from shj_bayes.margins import codes
from shj_bayes.margins.codes.code import Code


@cache
def catalogue() -> tuple[Code, ...]:
    """Every design code, in the order of its ``place`` on the sheet, then by id."""
    found = []
    for module in pkgutil.iter_modules(codes.__path__):
        code = getattr(importlib.import_module(f"{codes.__name__}.{module.name}"), "CODE", None)
        if code is None:
            continue
        if code.id != module.name:
            raise PopulationError(f"codes/{module.name}.py holds code '{code.id}'; the file carries the code's id")
        found.append(code)
    return tuple(sorted(found, key=lambda code: (code.place, code.id)))
