"""All effects: every module of this package that holds an ``EFFECT``; adding a file is enough."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from shj_bayes.errors import ModelError
from shj_bayes.model import effects
from shj_bayes.model.effects.effect import FAMILIES, Effect


@cache
def _discovered() -> tuple[Effect, ...]:
    """Effects by family, in the order of `FAMILIES`, then by id."""
    found = []
    for module in pkgutil.iter_modules(effects.__path__):
        effect = getattr(importlib.import_module(f"{effects.__name__}.{module.name}"), "EFFECT", None)
        if effect is None:
            continue
        if effect.id != module.name:
            raise ModelError(f"effects/{module.name}.py holds effect '{effect.id}'; the file carries the effect's id")
        found.append(effect)
    return tuple(sorted(found, key=lambda effect: (FAMILIES.index(effect.family), effect.id)))


def catalogue() -> dict[str, Effect]:
    """Every effect by id, in a fixed order: family, then id."""
    return {effect.id: effect for effect in _discovered()}
