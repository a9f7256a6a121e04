"""All effects: every module of this package that holds an ``EFFECT``; adding a file is enough."""

from functools import cache

from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError
from shj_bayes.model import effects
from shj_bayes.model.effects.effect import FAMILIES, Effect


@cache
def _discovered() -> tuple[Effect, ...]:
    """Effects by family, in the order of `FAMILIES`, then by id."""
    found = discovered(effects, "EFFECT", ModelError)
    return tuple(sorted(found, key=lambda effect: (FAMILIES.index(effect.family), effect.id)))


def catalogue() -> dict[str, Effect]:
    """Every effect by id, in a fixed order: family, then id; behind each the other forms of its mechanism."""
    return {one.id: one for effect in _discovered() for one in (effect, *effect.forms)}
