"""What a file format is: its endings, and a function from a file to a table."""

from collections.abc import Callable
from dataclasses import dataclass

from shj_bayes.recording.tables import Table


@dataclass(frozen=True)
class Format:
    """A file format."""

    id: str  # word in files and messages
    endings: tuple[str, ...]  # of file names, in lower case with the dot
    # ``read(path, sha256)`` gives the table; it imports its library itself. With sheets, ``read(path, sha256, sheet)``
    read: Callable[..., Table]
    gzipped: bool = False  # whether it may be compressed, with ``.gz`` behind the ending
    sheets: bool = False  # whether a file may hold several tables, of which ``--sheet`` names one
