"""Files written whole or not at all, files read with bounds, safe names, and one process at a time in a results folder.

The lock of a folder is the operating system's, on a file that says who holds it; it goes when its process ends, however
that ends. A file that a killed process left is taken over. Where a file system knows no locks, nothing is held.
"""

import errno
import glob
import hashlib
import inspect
import json
import math
import os
import re
import socket
import stat
import sys
import tomllib
import unicodedata
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from functools import partial, wraps
from io import BufferedReader
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, ParamSpec, TypeVar

from shj_bayes.errors import PopulationError, ShjError, StrangeFileError, plain_lines, plain_text, shown

MAX_POINTS = 400  # in a line of TOML; a key of a hundred thousand parts, a.a.a, keeps Python's parser busy for hours
MAX_JSON = 64 * 1024**2  # the largest files of results are some megabytes
_MAY_STEER = re.compile(rb"\\[bfru]|[\x7f-\xff]")  # in JSON; without these, no text in it holds what steers a terminal
FOLDER_DIGITS = 12  # of a digest: a hundred thousand names of one slug share one with a chance of 2e-5
MAX_ARRAYS = 2 * 1024**3  # draws of a hundred thousand sets
MAX_SEARCHED = 5_000_000  # characters of TOML in which the line of a value is looked for: about a second
_TOML = re.compile(  # texts of several lines, heads of tables, keys, and the ends of lines
    r'"""(?:\\.|[^\\])*?"{3,5}|\'{3}.*?\'{3,5}|^[ \t]*\[(?P<list>\[?)(?P<table>[^\]\n]+)|^(?P<key>[^=#\[\n]+)=|\n',
    re.DOTALL | re.MULTILINE,
)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the name of a file beside the old one to write to, then put it in the place of the old one.

    What was begun is taken away when writing fails, with `OSError` also where a library says it in another way; the old
    file is then as it was.
    """
    # The process number keeps a worker that outlived its killed parent from writing into the file of its successor.
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        part.unlink(missing_ok=True)  # of a killed process of the same number, or a link that was laid there
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0), 0o666))
        yield part
        with part.open("rb+") as stream:  # so that a power cut cannot leave the new name with nothing behind it
            os.fsync(stream.fileno())
        os.replace(part, path)
        for left_over in path.parent.glob(f"{glob.escape(path.name)}.*.part"):  # of processes that were killed
            with suppress(OSError):
                left_over.unlink()
    except BaseException as error:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        if isinstance(error, RuntimeError):  # HDF5 reports a full disk so when it fails on closing
            raise OSError(errno.EIO, "the file could not be written", str(path)) from error
        if isinstance(error, OSError) and error.errno:
            raise OSError(error.errno, os.strerror(error.errno), str(path)) from error
        raise


def reserve(path: Path, n_bytes: int) -> None:
    """Make sure that a file of this size can be written, before a library that reports a full disk badly begins.

    HDF5 that cannot write prints tracebacks while it is torn down, and may even end the process. The file is made, and
    may be written over; `OSError` where there is no room.
    """
    with path.open("wb") as stream:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(stream.fileno(), 0, n_bytes)
        else:
            for _ in range(n_bytes // 2**20 + 1):
                stream.write(bytes(2**20))


def need_files(paths: Iterable[Path], error: type[ShjError]) -> None:
    """Refuse files that are not there; before anything heavy is imported, so that the answer comes at once."""
    for path in paths:
        if not path.exists():
            raise error(f"{path}: there is no such file; check the name and the folder")


def need_population(folder: Path) -> None:
    """Refuse what is no folder, where one that ``tables`` or ``campaign`` wrote is needed."""
    if not folder.is_dir():
        raise PopulationError(f"{folder} is not a folder; run `shj-bayes tables` or `shj-bayes campaign` first")


def make_writable(folder: Path) -> None:
    """Make a folder for results; one that cannot be written to (`OSError`) is found before the work."""
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


def write_text(path: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    with replacing(path) as part:
        part.write_bytes(text.encode("utf-8", "replace"))


@contextmanager
def damage_told(what: str, error: type[ShjError]) -> Iterator[None]:
    """Raise one line that names the file where damaged or hand-made content makes our own code fail.

    Files that carry digests never come so far; those of earlier versions, or made by hand, may lack anything.
    """
    try:
        yield
    except (ShjError, MemoryError):
        raise
    except Exception as problem:
        if isinstance(problem, OSError) and problem.filename is not None:  # the system; without a name, a library
            raise
        reason = f"{type(problem).__name__}: {str(problem)[:200]}"
        raise error(f"{what} lacks something or holds something else ({reason}); run the command again") from problem


def sealed(record: dict[str, Any]) -> dict[str, Any]:
    """Record with the digest of its own content, so that a change by hand or by a bad disk is seen when it is read."""
    return record | {"digest": _digest_of(record)}


def check_seal(record: Any, path: Path, error: type[ShjError]) -> None:
    """Refuse a record that was altered after it was written; one without a digest is of an earlier version."""
    if isinstance(record, dict) and "digest" in record and record["digest"] != _digest_of(record):
        raise error(
            f"{path.name} in {path.parent.name} was altered after it was written (its digest does not fit); "
            "restore it, or run the command again that wrote it"
        )


def _digest_of(record: dict[str, Any]) -> str:
    rest = {key: value for key, value in record.items() if key != "digest"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def open_ordinary(path: Path) -> BufferedReader:
    """Open a file for reading; `OSError` where it is a device or a pipe, which have no size and may never end."""
    stream = open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0)))  # noqa: SIM115
    if not stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
        stream.close()
        raise StrangeFileError(errno.EINVAL, "it is not an ordinary file; it must be a file on the disk", str(path))
    return stream


def read_bytes(path: Path, max_bytes: int, error: type[ShjError]) -> bytes:
    """Read an ordinary file of at most so many bytes; what cannot be read, or is larger, raises `error`."""
    try:
        if path.is_dir():
            raise error(f"{path.name or path} is a folder; name the file in it")
        with open_ordinary(path) as stream:
            size = os.fstat(stream.fileno()).st_size
            raw = stream.read(max_bytes + 1) if size <= max_bytes else b""  # it may grow meanwhile
        if max(size, len(raw)) > max_bytes:
            size = max(size, len(raw))
            raise error(f"{path.name} has {size} bytes; at most {max_bytes} are read; is it the right file?")
        return raw
    except (OSError, ValueError) as problem:
        reason = getattr(problem, "strerror", None) or problem
        raise error(f"cannot read {path.name}: {reason}; check the name and the folder") from problem


def refuse_packed(path: Path, error: type[ShjError]) -> None:
    """Refuse an archive of arrays (``.npz``) that would take more memory than it takes on the disk, before it is read.

    Ours are not compressed. What its directory and the heads of the arrays claim is compared with what is there.
    """
    import numpy as np  # noqa: PLC0415

    with open_ordinary(path) as stream, zipfile.ZipFile(stream) as archive:
        there = os.fstat(stream.fileno()).st_size
        parts = archive.infolist()
        whole = sum(part.file_size for part in parts) <= there <= MAX_ARRAYS
        for part in parts if whole else ():
            with archive.open(part) as content:
                version = np.lib.format.read_magic(content)
                read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
                shape, _, kind = read(content)
                whole &= math.prod(shape) * kind.itemsize <= part.file_size
    if not whole:
        raise error(
            f"{path.name} in {path.parent.name} would unpack to more than it holds, or than {MAX_ARRAYS // 2**20} MiB; "
            "run the command again that wrote it"
        )


def read_json(path: Path, error: type[ShjError]) -> Any:
    """Read a JSON file of our own; what cannot be read raises `error` with the file and the place in it.

    No text in it can steer a terminal or spoil a table. A record that was sealed is so still.
    """
    return json_of(read_bytes(path, MAX_JSON, error), path, error)


def json_of(raw: bytes, path: Path, error: type[ShjError]) -> Any:
    """Give the content of a JSON file, as `read_json` does, from what was read of it."""
    try:
        content = json.loads(raw.decode("utf-8"))
        if not _MAY_STEER.search(raw):
            return content
        plain = _plain(content)
        whole = isinstance(content, dict) and "digest" in content and content["digest"] == _digest_of(content)
        return sealed(plain) if whole else plain
    except (ValueError, RecursionError) as problem:
        raise error(f"{path.name} is damaged: {problem}; write it again") from problem


def _plain(value: Any) -> Any:
    """Value from JSON with plain texts, keys too."""
    if isinstance(value, str):
        return plain_lines(value)
    if isinstance(value, dict):
        return {plain_text(key): _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, list) else value


def read_toml(path: Path, schema: str, max_bytes: int, error: type[ShjError]) -> tuple[dict[str, Any], str]:
    """Read a TOML file of a known schema and of bounded size: content, and SHA-256; `error` where that fails."""
    raw = read_bytes(path, max_bytes, error)
    for number, line in enumerate(raw.split(b"\n"), start=1):
        if line.count(b".") > MAX_POINTS:
            raise error(f"{path.name}, line {number} holds more than {MAX_POINTS} points; put lists on several lines")
    try:
        table = tomllib.loads(raw.decode("utf-8-sig"))
    except (ValueError, RecursionError, AttributeError, KeyError) as problem:  # the last two: bugs of tomllib 3.11
        raise error(f"{path.name} is not valid TOML: {problem}; correct that place") from problem
    if table.get("schema") != schema:
        stated = repr(table.get("schema"))[:80]
        raise error(f"{path.name}: schema is {stated}; this version reads {schema!r}; write that, or update shj-bayes")
    return table, hashlib.sha256(raw).hexdigest()


def toml_line(path: Path, keys: Sequence[str | int]) -> int | None:
    """Line, from 1, of a valid TOML file on which a value begins; `keys` is the way to it: tables, places in lists.

    None where there is no such key, or the file is long. What stands within braces or brackets begins where these do.
    """
    text = path.read_text(encoding="utf-8-sig")
    lines: dict[tuple[str | int, ...], int] = {}
    last: dict[tuple[str | int, ...], int] = {}  # place of the last table of each list of tables
    here: tuple[str | int, ...] = ()
    line = 1
    for match in _TOML.finditer(text) if len(text) <= MAX_SEARCHED else ():
        names = [name.strip().strip("\"'") for name in (match["table"] or match["key"] or "").split(".")]
        if match["key"]:
            for n in range(1, len(names) + 1):
                lines.setdefault((*here, *names[:n]), line)
        elif match["table"]:
            here = ()
            for n, name in enumerate(names, start=1):
                here += (name,)
                if n == len(names) and match["list"]:
                    last[here] = last.get(here, -1) + 1
                here += (last[here],) if here in last else ()
        line += match[0].count("\n")
    found = (lines.get(tuple(keys[:n])) for n in range(len(keys), 0, -1))
    return next((line for line in found if line), None)


def file_digest(path: Path) -> str:
    """SHA-256 of an ordinary file, read in pieces."""
    with open_ordinary(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def plain_name(name: str) -> str:
    """Name without control characters, at most 80 characters long; letters that look the same are the same."""
    return re.sub(r"\s+", " ", plain_text(unicodedata.normalize("NFC", name[:400]))).strip()[:80].strip() or "device"


def folder_name(*names: str) -> str:
    """Name of a folder made from any texts: letters, digits, dot, dash; never empty, hidden or a device of Windows.

    Other texts, or the same words parted elsewhere, give another one.
    """
    slug = re.sub(r"[^A-Za-z0-9.-]+", "-", " ".join(names)).strip("-.").lower()[:60]
    digest = hashlib.sha256("\0".join(names).encode("utf-8", "replace")).hexdigest()
    return f"{slug}-{digest[:FOLDER_DIGITS]}".strip("-")


def shipped(*parts: str) -> Path:
    """Path of a shipped file or folder such as ``"priors", "afc.toml"``; `FileNotFoundError` where there is none."""
    package = Path(__file__).resolve().parents[1]
    for root in (package / "_shipped", package.parents[1]):
        candidate = root.joinpath(*parts)
        if candidate.exists():
            return candidate
    raise FileNotFoundError(f"{'/'.join(parts)} does not ship with this installation; reinstall shj-bayes")


LOCK = "shj-bayes.lock"
_WRITTEN = 4096  # the file is shorter; Windows locks the byte behind, so that the others can read what is written
_BUSY = {errno.EACCES, errno.EAGAIN, errno.EDEADLK}

P = ParamSpec("P")
T = TypeVar("T")


def alone_in(parameter: str, kept: str = "") -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorate a function that writes into the folder a parameter names: it holds that `alone`, or raises as `alone`.

    `kept` is a file of a finished result; where it is there, the folder may be one that cannot be written into.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)

        @wraps(function)
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
        handle = _locked(folder / LOCK)
    except OSError as error:
        if kept and (folder / kept).exists():
            handle = None
        else:
            raise OSError(error.errno, os.strerror(error.errno or errno.EIO), str(folder)) from error
    try:
        yield
    finally:
        if handle is not None:
            # The file is taken away while it is locked, where the system allows that.
            steps = (partial(os.unlink, folder / LOCK), partial(os.close, handle))
            for step in steps if sys.platform != "win32" else reversed(steps):
                with suppress(OSError):
                    step()
        with suppress(OSError):
            for place in made:
                place.rmdir()


def _locked(path: Path) -> int | None:
    """Descriptor of the locked file, with who holds it written into it; None where there are no locks."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    while True:
        handle = os.open(path, flags, 0o666)
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:  # what is written here would be another file's
            os.close(handle)
            raise ShjError(
                f"{path.name} in {path.parent.name} is no file of its own but a pipe, a device or a further name of "
                "another file; take it away, or choose another folder with -o"
            )
        try:
            _lock(handle)
            there = os.fstat(handle).st_ino == path.stat().st_ino  # else its holder took it away meanwhile
        except FileNotFoundError:
            there = False
        except OSError as error:
            if error.errno not in _BUSY:
                os.close(handle)
                path.unlink(missing_ok=True)
                return None
            by = "another process"
            with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):  # it has not written that yet
                os.lseek(handle, 0, os.SEEK_SET)
                who = json.loads(os.read(handle, _WRITTEN))
                process, host, since = (shown(who[key]).strip("'") for key in ("process", "host", "since"))
                by = f"process {process} on {host}, since {since}"
            os.close(handle)
            raise ShjError(
                f"{path.parent.name} is being written into by {by}; wait for it, or choose another folder with -o"
            ) from None
        if there:
            who = {"process": os.getpid(), "host": socket.gethostname()}
            who["since"] = datetime.now().astimezone().isoformat(timespec="seconds")
            os.ftruncate(handle, 0)
            os.write(handle, json.dumps(who).encode()[:_WRITTEN])
            return handle
        os.close(handle)


if sys.platform == "win32":
    import msvcrt

    def _lock(handle: int) -> None:
        os.lseek(handle, _WRITTEN, os.SEEK_SET)
        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        os.lseek(handle, 0, os.SEEK_SET)

else:
    import fcntl

    def _lock(handle: int) -> None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
