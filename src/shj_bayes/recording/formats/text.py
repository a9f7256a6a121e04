"""Text tables: comma, semicolon, tab or blanks; decimal point or comma; any of the usual encodings.

The file is read as a stream: memory holds the numbers and one block of lines, never the whole text.
"""

import codecs
import gzip
import io
import re
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import IO

from shj_bayes.errors import RecordingError
from shj_bayes.recording.dialect import LOOK, Dialect, find_dialect
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.heads import head_of
from shj_bayes.recording.limits import CHUNK_BYTES, MAX_BYTES, MAX_EMPTY, MAX_LINE
from shj_bayes.recording.numerals import numbers
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Table, bounded_columns
from shj_bayes.recording.timed import timed

# hyphens, dashes and minus signs before a number or in its exponent; marks without width
_MINUS = re.compile("(?:(?<!\\w)|(?<=[0-9][eEdD]))[\u2010-\u2015\u2212\ufe58\ufe63\uff0d](?=[.,]?[0-9])")
_INVISIBLE = dict.fromkeys((0xFEFF, 0x200B, 0x200C, 0x200D, 0x200E, 0x200F, 0x2060))
_HEAD = 4096  # bytes in which the zeros of UTF-16 are looked for


def read_text(path: Path, sha256: str) -> Table:
    """Read a text table, plain or gzipped; `sha256` is its digest."""
    encoding = find_encoding(path)
    said = "Latin-1" if encoding == "cp1252" else encoding
    notes = [] if encoding.startswith("utf-8") else [Finding("encoding", "note", f"text read as {said}")]
    with _opened(path) as raw, io.TextIOWrapper(raw, encoding, "replace" if encoding == "cp1252" else "strict") as text:
        return table_from_lines(_lines(text, path.name), path.name, sha256, "csv", tuple(notes))


def table_from_lines(lines: Iterable[str], name: str, sha256: str, kind: str, notes: tuple[Finding, ...] = ()) -> Table:
    """Find header and numbers in lines of text; empty ones mean nothing, and ``#`` or ``%`` begins a comment.

    `kind` is the format of the table, `notes` what was met before.
    """
    rows = _Rows(lines, name)
    stream = iter(rows)
    first = list(islice(stream, 2 * LOOK))
    dialect = find_dialect(first, name)
    head = head_of(first[: dialect.first], dialect)
    if not any(head.names) and rows.comments:  # numpy and gnuplot write the header as a comment
        head = head_of([line.lstrip("#% ") for line in rows.comments], dialect)
    if not any(head.names):
        _refuse_split_numbers(first[: dialect.first], dialect, name)
    bounded_columns(head.names, name)
    read = numbers(chain(first[dialect.first :], stream), dialect, head, name, rows.line_of)
    findings = read.findings
    if any("simulated" in line.lower() for line in rows.comments):
        findings.append(Finding("simulated", "note", "the file says that it is simulated, not measured"))
    if dialect.decimal == ",":
        findings.append(Finding("decimal-comma", "assumed", "a comma is read as the decimal sign (0,5 is one half)"))
    columns, more = timed(read, head, name)
    return Table(name, kind, sha256, columns, has_header=any(head.names), findings=(*notes, *findings, *more))


def _refuse_split_numbers(above: list[str], dialect: Dialect, name: str) -> None:
    """Refuse rows of twice as many cells as the header has: each number was taken apart at its decimal comma."""
    width = len(dialect.cells(above[-1])) if above else 0
    if dialect.separator == "," and 2 * width == dialect.width:
        raise RecordingError(
            f"{name}: the header has {width} cells and the rows of numbers {dialect.width}, so commas seem to be the "
            "decimal sign and to stand between the columns; export with semicolons between the columns, or with "
            "decimal points"
        )


class _Rows:
    """Lines that may be rows; the first comments go into a list."""

    def __init__(self, lines: Iterable[str], name: str) -> None:
        self.lines, self.name = lines, name
        self.comments: list[str] = []
        self.passed = array("q")  # how many rows came before each line that is none

    def __iter__(self) -> Iterator[str]:
        """Give the rows, in the signs of typewriters."""
        n_rows = 0
        for line in self.lines:
            text = line if line[:1].isdigit() else line.lstrip()
            if text and not text.startswith(("#", "%")):
                n_rows += 1
                yield line if line.isascii() else _typed(line)
                continue
            self.passed.append(n_rows)
            if len(self.passed) - n_rows > MAX_EMPTY:
                raise RecordingError(
                    f"{self.name} holds {MAX_EMPTY} more empty lines and comments than rows of numbers; that is no "
                    f"recording; export it again, one row on each line"
                )
            if text and len(self.comments) < LOOK:
                self.comments.append(line)

    def line_of(self, row: int) -> int:
        """Give the number of a row's line in the file, counted from 1."""
        return row + 1 + bisect_right(self.passed, row)


def _typed(line: str) -> str:
    """Line in which a minus before a number is a hyphen, whatever a typesetter made of it, and nothing is invisible."""
    return _MINUS.sub("-", line.translate(_INVISIBLE))


def find_encoding(path: Path) -> str:
    """Codec of a text file, plain or gzipped: UTF-8, -16 or -32 by marks or zeros, else Latin-1 as Windows writes it.

    The file is read once to its end.
    """
    with _opened(path) as raw:
        head = raw.read(_HEAD)
        encoding = _by_head(head, path.name)
        decoder = codecs.getincrementaldecoder(encoding)()
        piece = head
        try:
            while piece:
                decoder.decode(piece)
                piece = raw.read(CHUNK_BYTES)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError as error:
            if encoding not in ("utf-8", "utf-8-sig"):
                raise RecordingError(
                    f"{path.name} begins as {encoding} but is damaged ({error.reason}); export it again, as UTF-8"
                ) from error
            return "cp1252"
    return encoding


def _by_head(head: bytes, name: str) -> str:
    """Tell the encoding by the byte-order mark, or by where the zeros are."""
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if head.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    if b"\x00" not in head:
        return "utf-8"
    zeros_odd, zeros_even = head[1::2].count(0), head[0::2].count(0)
    if max(zeros_odd, zeros_even) < 0.3 * len(head) / 2:
        raise RecordingError(f"{name} is not text (it holds binary zeros); its ending should say its real format")
    return "utf-16-le" if zeros_odd > zeros_even else "utf-16-be"


class _Bounded(io.RawIOBase):
    """An unpacked stream that is stopped early when it grows beyond any recording, or is damaged."""

    def __init__(self, raw: IO[bytes], unpacked: IO[bytes] | gzip.GzipFile, name: str) -> None:
        self.raw, self.stream, self.name, self.total = raw, unpacked, name, 0

    def readable(self) -> bool:
        """Say that it can be read."""
        return True

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        """Pass on the next piece."""
        try:
            piece = self.stream.read(min(len(buffer), CHUNK_BYTES))
        except (OSError, EOFError, zlib.error) as error:
            what = "gzip file is damaged" if self.name.lower().endswith(".gz") else "file cannot be read to its end"
            raise RecordingError(f"{self.name}: the {what} ({error}); copy or compress it again") from error
        self.total += len(piece)
        if self.total > MAX_BYTES:
            raise RecordingError(
                f"{self.name} unpacks to more than {MAX_BYTES // 1024**2} MiB; that is no recording; "
                f"export fewer channels or rows"
            )
        buffer[: len(piece)] = piece
        return len(piece)

    def close(self) -> None:
        """Close what it reads from as well."""
        self.stream.close()
        self.raw.close()
        super().close()


def _opened(path: Path) -> io.BufferedReader:
    raw = path.open("rb")
    unpacked = gzip.GzipFile(fileobj=raw) if path.suffix.lower() == ".gz" else raw
    return io.BufferedReader(_Bounded(raw, unpacked, path.name), 1 << 16)


def _lines(text: io.TextIOWrapper, name: str) -> Iterator[str]:
    """Lines without their ends, each of a bounded length."""
    number, held = 0, ""
    while piece := text.read(CHUNK_BYTES):
        *whole, held = (held + piece).split("\n")
        longest = max(map(len, (*whole, held)))
        if longest > MAX_LINE:
            at = number + 1 + next(i for i, line in enumerate((*whole, held)) if len(line) == longest)
            raise RecordingError(
                f"{name}: line {at} has more than {MAX_LINE} characters; a row of a recording has some dozens; "
                f"export it as a table with one row for each sample"
            )
        number += len(whole)
        yield from whole
    if held:
        yield held


FORMATS = (Format("csv", (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm"), read_text, gzipped=True),)
