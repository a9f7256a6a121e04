"""A fence around the process that diagnoses: it cannot open, list or import anything that leads to a key.

The interpreter's audit hooks see every file that Python code opens, every folder it lists, every module it imports, and
every process or socket it makes; a hook cannot be taken off again. Compiled code could go past it: the fence is against
leaks, not against an attacker with a debugger. What it does not rest on is trust in the diagnosis.
"""

import os
import sys
import sysconfig
import tempfile
from collections.abc import Sequence
from pathlib import Path

import shj_bayes
import shj_validation
from shj_bayes._util.files import shipped

FORBIDDEN = (
    "shj_validation.proof.cases",
    "shj_validation.proof.make",
    "shj_validation.proof.seal",
    "shj_validation.proof.run",
    "shj_validation.proof.simulators",
)
_STARTS_SOMETHING = ("os.system", "os.exec", "os.fork", "os.forkpty", "os.posix_spawn", "os.spawn", "os.startfile")
_PATHS = ("open", "os.listdir", "os.scandir", "os.chdir", "os.rename", "os.remove", "os.link", "os.symlink", "shutil.")


def raise_fence(folder: Path) -> None:
    """Confine this process, for good, to one folder and to the installed packages.

    Parameters
    ----------
    folder : Path
        The only folder with data that may be read.

    Raises
    ------
    RuntimeError
        If a module that knows keys has been imported already.
    """
    known = [name for name in sys.modules if name.startswith(FORBIDDEN)]
    if known:
        raise RuntimeError(f"{known[0]} is loaded already; the fence must be raised in a fresh process")
    inside = _roots(folder)

    def watch(event: str, arguments: tuple[object, ...]) -> None:
        if event == "import" and str(arguments[0]).startswith(FORBIDDEN):
            raise PermissionError(f"import of {arguments[0]} is refused: it knows the keys of the proof")
        if event.startswith(("subprocess.", "socket.", *_STARTS_SOMETHING)):
            raise PermissionError(f"{event} is refused behind the fence of the proof")
        if event.startswith(_PATHS):
            for argument in arguments[:2]:
                if isinstance(argument, str | bytes | os.PathLike) and not _within(argument, event, inside):
                    raise PermissionError(
                        f"{event} of {os.fsdecode(argument)} is refused behind the fence of the proof"
                    )

    sys.addaudithook(watch)


def _roots(folder: Path) -> list[str]:
    """Places that may be read: the data, the interpreter, its packages, these two, the priors, its loaded libraries.

    The last are listed to keep BLAS to one thread.
    """
    packages = [Path(place) for package in (shj_bayes, shj_validation) for place in package.__path__]
    places = [folder, shipped("priors"), *packages, Path(sys.prefix), Path(sys.base_prefix)]
    places += [Path(path) for path in sysconfig.get_paths().values()]
    real = [os.path.realpath(place) for place in places if str(place) != os.path.sep]
    return [*real, os.path.realpath("/proc/self/maps"), os.devnull]


def _within(path: str | bytes | os.PathLike[str], event: str, inside: Sequence[str]) -> bool:
    """Whether a path lies in one of the folders; the mode of ``open`` is a second argument and no path."""
    text = os.fsdecode(path)
    if event == "open" and text in {
        "r",
        "w",
        "a",
        "x",
        "b",
        "rb",
        "wb",
        "r+",
        "rb+",
        "ab",
        "xb",
        "w+",
        "wb+",
        "rt",
        "wt",
    }:
        return True
    place = os.path.realpath(text)
    return any(place == root or place.startswith(root + os.sep) for root in inside)


def scratch() -> str:
    """Folder for the copies of recordings: fresh, outside the proof's folder, with a name that says nothing."""
    return tempfile.mkdtemp(prefix="shj-blind-")
