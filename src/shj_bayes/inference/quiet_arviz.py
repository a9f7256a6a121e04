"""ArviZ, before and after its rewrite; without the announcement of version 0.23 at every import, and without numba."""

import warnings
from typing import Any

with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing a major refactor", category=FutureWarning)
    import arviz as az

_numba: Any = vars(az).get("Numba")  # carries no types; version 1 has none
if _numba is not None:
    _numba.disable_numba()  # it compiles its variance anew in every process, which takes longer than it ever saves here

__all__ = ["az"]
