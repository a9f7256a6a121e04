"""Arrays that stay as they are, and linear algebra of small ones in one thread."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


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


P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Keep BLAS to one thread while a function runs.

    Small matrices shared out among threads cost several times the processor time and save none: the threads wait for
    one another.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
