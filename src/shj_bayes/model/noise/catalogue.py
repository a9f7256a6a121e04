"""All noise models: every module of this package that holds a ``NOISE``; adding a file is enough."""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from shj_bayes.errors import ModelError
from shj_bayes.model import noise
from shj_bayes.model.noise.noise import Noise
from shj_bayes.suggest import did_you_mean

DEFAULT = "slow"


@cache
def noise_models() -> dict[str, Noise]:
    """Every noise model by its word, the default first."""
    found = {}
    for module in pkgutil.iter_modules(noise.__path__):
        model = getattr(importlib.import_module(f"{noise.__name__}.{module.name}"), "NOISE", None)
        if model is None:
            continue
        if model.id != module.name:
            raise ModelError(f"noise/{module.name}.py holds noise model '{model.id}'; the file carries its word")
        found[model.id] = model
    return dict(sorted(found.items(), key=lambda item: (item[0] != DEFAULT, item[0])))


def noise_model(word: str) -> Noise:
    """Noise model of a word.

    Raises
    ------
    ModelError
        If there is none, with those that there are.
    """
    known = noise_models()
    if word not in known:
        raise ModelError(
            f"noise '{word}' is not known; choose one of {', '.join(known)}{did_you_mean(word, list(known))}"
        )
    return known[word]
