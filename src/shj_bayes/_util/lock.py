"""One process at a time writes into a results folder.

The lock is the operating system's, on a file that says who holds it; it goes when its process ends, however that ends.
A file that a killed process left is taken over. Where a file system knows no locks, nothing is held.
"""

import errno
import functools
import inspect
import json
import os
import socket
import stat
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path
from typing import ParamSpec, TypeVar

from shj_bayes.errors import ShjError, shown

LOCK = "shj-bayes.lock"
_WRITTEN = 4096  # the file is shorter; Windows locks the byte behind, so that the others can read what is written
_BUSY = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}

P = ParamSpec("P")
T = TypeVar("T")


def alone_in(parameter: str, kept: str = "") -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function that writes into a folder, one of its parameters: it does so `alone`, or raises as that.

    `kept` is a file of a finished result; where it is there, the folder may be one that cannot be written into.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            folder = Path(signature.bind(*args, **kwargs).arguments[parameter])
            with alone(folder, kept):
                return function(*args, **kwargs)

        return call

    return decorate


@contextmanager
def alone(folder: Path, kept: str = "") -> Iterator[None]:
    """Hold a results folder for a while; a folder that was made for it and stayed empty is taken away again.

    `kept` is as for `alone_in`. `ShjError` if another process, or another thread of this one, is at work in it;
    `OSError` if it cannot be made or written into.
    """
    made = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stream = _locked(folder / LOCK)
    except OSError as error:
        if kept and (folder / kept).exists():
            stream = None
        else:
            raise OSError(error.errno, os.strerror(error.errno or errno.EIO), str(folder)) from error
    try:
        yield
    finally:
        if stream is not None:
            _release(stream, folder / LOCK)
        with suppress(OSError):
            for place in made:
                place.rmdir()


def _locked(path: Path) -> int | None:
    """Descriptor of the locked file, with who holds it written into it; None where there are no locks."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    while True:
        stream = os.open(path, flags, 0o666)
        status = os.fstat(stream)
        if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:  # what is written here would be another file's
            os.close(stream)
            raise ShjError(
                f"{path.name} in {path.parent.name} is no file of its own but a pipe, a device or a further name of "
                "another file; take it away, or choose another folder with -o"
            )
        try:
            _lock(stream)
            there = os.fstat(stream).st_ino == path.stat().st_ino  # else its holder took it away meanwhile
        except FileNotFoundError:
            there = False
        except OSError as error:
            if error.errno not in _BUSY:
                os.close(stream)
                path.unlink(missing_ok=True)
                return None
            words = f"{path.parent.name} {_holder(stream)}; wait for it, or choose another folder with -o"
            os.close(stream)
            raise ShjError(words) from None
        if there:
            who = {"process": os.getpid(), "host": socket.gethostname()}
            who["since"] = datetime.now().astimezone().isoformat(timespec="seconds")
            os.ftruncate(stream, 0)
            os.write(stream, json.dumps(who).encode()[:_WRITTEN])
            return stream
        os.close(stream)


def _holder(stream: int) -> str:
    """Say who writes into a folder, as far as that stands in its file."""
    try:
        os.lseek(stream, 0, os.SEEK_SET)
        who = json.loads(os.read(stream, _WRITTEN))
        process, host, since = (shown(who[key]).strip("'") for key in ("process", "host", "since"))
        return f"is being written into by process {process} on {host}, since {since}"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # it has not written that yet
        return "is being written into by another process"


def _release(stream: int, path: Path) -> None:
    """Take the file away while it is locked, where the system allows that, then unlock it."""
    with suppress(OSError):
        if sys.platform != "win32":
            path.unlink()
    os.close(stream)
    with suppress(OSError):
        if sys.platform == "win32":
            path.unlink()


if sys.platform == "win32":
    import msvcrt

    def _lock(stream: int) -> None:
        os.lseek(stream, _WRITTEN, os.SEEK_SET)
        msvcrt.locking(stream, msvcrt.LK_NBLCK, 1)
        os.lseek(stream, 0, os.SEEK_SET)

else:
    import fcntl

    def _lock(stream: int) -> None:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
