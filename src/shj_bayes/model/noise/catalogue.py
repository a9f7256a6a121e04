"""All noise models: every module of this package that holds a ``NOISE``; adding a file is enough."""

from functools import cache

from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model import noise
from shj_bayes.model.noise.noise import Noise

DEFAULT = "slow"


@cache
def noise_models() -> dict[str, Noise]:
    """Every noise model by its word, the default first."""
    found = {model.id: model for model in discovered(noise, "NOISE", ModelError)}
    return dict(sorted(found.items(), key=lambda item: (item[0] != DEFAULT, item[0])))


def noise_model(word: str) -> Noise:
    """Noise model of a word; `ModelError` with those that there are where there is none."""
    known = noise_models()
    if word not in known:
        raise ModelError(
            f"noise '{word}' is not known; choose one of {', '.join(known)}{did_you_mean(word, list(known))}"
        )
    return known[word]
