"""What a file format is: its endings, and a function from a file to a table."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from shj_bayes.recording.tables import Table


@dataclass(frozen=True)
class Format:
    """A file format."""

    id: str  # word in files and messages
    endings: tuple[str, ...]  # of file names, in lower case with the dot
    read: Callable[[Path, str], Table]  # ``read(path, sha256)`` gives the table; it imports its library itself
    gzipped: bool = False  # whether it may be compressed, with ``.gz`` behind the ending
