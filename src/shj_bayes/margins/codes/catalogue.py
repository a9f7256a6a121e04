"""All design codes: every module of this package that holds a ``CODE``; adding a file is enough."""

from functools import cache

from shj_bayes._util.imports import discovered
from shj_bayes.errors import PopulationError
from shj_bayes.margins import codes
from shj_bayes.margins.codes.code import Code


@cache
def catalogue() -> tuple[Code, ...]:
    """Every design code, in the order of its ``place`` on the sheet, then by id."""
    return tuple(sorted(discovered(codes, "CODE", PopulationError), key=lambda code: (code.place, code.id)))
