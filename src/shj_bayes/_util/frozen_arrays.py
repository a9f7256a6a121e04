"""Arrays that stay as they are."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def frozen(values: ArrayLike, kind: type[np.generic] = np.float64) -> NDArray[Any]:
    """Array that nobody can change: a copy, unless nobody can change this one (a law with a delay makes many)."""
    array = np.asarray(values, dtype=kind)
    owner: Any = array
    while isinstance(owner, np.ndarray) and not owner.flags.writeable:
        owner = owner.base
    if owner is not None:
        array = array.copy()
        array.setflags(write=False)
    return array


def freeze(holder: object, *names: str, kind: type[np.generic] = np.float64) -> None:
    """Make arrays of a frozen dataclass `frozen`, by the names of its fields, in its ``__post_init__``."""
    for name in names:
        object.__setattr__(holder, name, frozen(getattr(holder, name), kind))
