"""HDF5 files of results, which may come from elsewhere: read in a process of their own before they are read here.

A damaged one can end the process that opens it, take all memory or never come back. One process goes through all files
that this one asks for.
"""

import atexit
import faulthandler
import json
import os
import subprocess
import sys
import threading
from functools import cache
from pathlib import Path
from typing import Any

from shj_bayes._util.child_processes import PYTHON, bound_memory
from shj_bayes.errors import shown

_CHILD = "from shj_bayes._util.vetting import child; child()"
_SECONDS = 20  # for a small file on a busy machine, and more by its size
_BYTES_S = 4 * 1024**2  # read in a second by the slowest disk
_NUMBERS = 512 * 1024**2  # in a file; ours hold some megabytes
_BYTES = 768 * 1024**2  # of memory for one variable, its chunks and the library
_PARTS = 2000  # groups and variables in a file; ours hold about a hundred
_ELSEWHERE = "is a link to somewhere else, or lies there"
_MORE = "lies deeper, or behind more parts, than in a file of ours"
_ONE_AT_A_TIME = threading.Lock()


def vet(path: Path, group: str = "") -> None:
    """Refuse (`ValueError`) an HDF5 file that is no result of ours, or cannot be read within bounds.

    Read is one `group` at the top of it, or all that it holds.
    """
    with _ONE_AT_A_TIME:
        child, answer = _child(), b""
        try:
            child.stdin.write(json.dumps([os.path.abspath(path), group]).encode() + b"\n")
            child.stdin.flush()
            answer = child.stdout.readline()
        except BrokenPipeError:
            pass
        finally:
            if not answer.endswith(b"\n"):  # it died, or Ctrl-C came and the answer would be that to the next question
                child.kill()
                _end()
    if not answer.endswith(b"\n"):
        raise ValueError("the library of its format cannot read it and gave up")
    if reason := json.loads(answer):
        raise ValueError(reason)


@cache
def _child() -> Any:
    """Start the process; it ends when its input does."""
    pipe = subprocess.PIPE
    return subprocess.Popen([*PYTHON, "-c", _CHILD], stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)


@atexit.register
def _end() -> None:
    if _child.cache_info().currsize:
        with _child():  # closes its input, and waits
            pass
        _child.cache_clear()


def child() -> None:
    """Answer each line of standard input, a path and a group, with a line: null, or why the file is refused."""
    import h5py  # noqa: F401, PLC0415  what is loaded does not count against the bound

    bound_memory(_BYTES)
    for line in sys.stdin.buffer:
        path, group = json.loads(line)
        try:
            seconds = _SECONDS + os.path.getsize(path) // _BYTES_S
            faulthandler.dump_traceback_later(seconds, exit=True)  # also where the library holds every thread up
            _read(path, group)
            reason = None
        except Exception as error:  # the library raises dozens of kinds for damaged files; all mean the same
            reason = str(error) or type(error).__name__
        faulthandler.cancel_dump_traceback_later()
        sys.stdout.write(json.dumps(reason) + "\n")
        sys.stdout.flush()


def _read(path: str, group: str) -> None:
    """Read what `group` of a file holds; `ValueError` where the file has parts that ours have not.

    Ours have hard links alone, and groups that hold variables: a file with other links, or external or virtual
    variables, is a window into others.
    """
    import h5py  # noqa: PLC0415

    names: list[str] = []

    # What a callback raises is lost in the library; what it returns ends the walk.
    def look(name: bytes, link: Any) -> str | None:
        names.append(name.decode("utf-8", "replace"))
        if link.type != h5py.h5l.TYPE_HARD:
            return _ELSEWHERE
        return _MORE if name.count(b"/") > 1 or len(names) > _PARTS else None

    with h5py.File(path, "r") as file:
        if wrong := file.id.links.visit(look, info=True):
            raise ValueError(f"{shown(names[-1])} {wrong}")
        parts = {name: file[name] for name in names if group in ("", name.split("/")[0])}
        variables = {name: part for name, part in parts.items() if isinstance(part, h5py.Dataset)}
        if (size := sum(one.size * one.dtype.itemsize for one in variables.values())) > _NUMBERS:
            raise ValueError(f"it claims {size // 2**20} MiB of numbers; allowed are {_NUMBERS // 2**20}")
        for name, one in variables.items():
            if one.external or one.is_virtual:
                raise ValueError(f"{shown(name)} {_ELSEWHERE}")
            one[()]
        for part in parts.values():
            dict(part.attrs)
