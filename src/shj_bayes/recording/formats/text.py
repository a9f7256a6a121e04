"""Text tables: comma, semicolon, tab or blanks; decimal point or comma; any of the usual encodings.

The file is read as a stream: memory holds the numbers and one block of lines, never the whole text.
"""

import codecs
import gzip
import io
import zlib
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import IO

from shj_bayes.errors import RecordingError
from shj_bayes.recording.dialect import LOOK, Dialect, find_dialect, header_of
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.limits import CHUNK_BYTES, MAX_BYTES, MAX_EMPTY, MAX_LINE
from shj_bayes.recording.numerals import numbers
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Column, Table, bounded_columns

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
    comments: list[str] = []
    stream = _rows(lines, comments, name)
    head = list(islice(stream, 2 * LOOK))
    dialect = find_dialect(head, name)
    names, units, headers = header_of(head[: dialect.first], dialect)
    if not any(names) and comments:  # numpy and gnuplot write the header as a comment
        names, units, headers = header_of([line.lstrip("#% ") for line in comments], dialect)
    if not any(names):
        _refuse_split_numbers(head[: dialect.first], dialect, name)
    bounded_columns(names, name)
    values, n_words, findings = numbers(chain(head[dialect.first :], stream), dialect, names, name)
    if any("simulated" in line.lower() for line in comments):
        findings.append(Finding("simulated", "note", "the file says that it is simulated, not measured"))
    if dialect.decimal == ",":
        findings.append(Finding("decimal-comma", "assumed", "a comma is read as the decimal sign (0,5 is one half)"))
    columns = tuple(
        Column(label or f"#{i + 1}", values[i], units[i], headers[i], n_words[i]) for i, label in enumerate(names)
    )
    return Table(name, kind, sha256, columns, has_header=any(names), findings=(*notes, *findings))


def _refuse_split_numbers(above: list[str], dialect: Dialect, name: str) -> None:
    """Refuse rows of twice as many cells as the header has: each number was taken apart at its decimal comma."""
    width = len(dialect.cells(above[-1])) if above else 0
    if dialect.separator == "," and 2 * width == dialect.width:
        raise RecordingError(
            f"{name}: the header has {width} cells and the rows of numbers {dialect.width}, so commas seem to be the "
            "decimal sign and to stand between the columns; export with semicolons between the columns, or with "
            "decimal points"
        )


def _rows(lines: Iterable[str], comments: list[str], name: str) -> Iterator[str]:
    """Lines that may be rows; the first comments go into a list."""
    surplus = 0
    for line in lines:
        text = line if line[:1].isdigit() else line.lstrip()
        if text and not text.startswith(("#", "%")):
            surplus -= 1
            yield line
            continue
        surplus += 1
        if surplus > MAX_EMPTY:
            raise RecordingError(
                f"{name} holds {MAX_EMPTY} more empty lines and comments than rows of numbers; that is no recording; "
                f"export it again, one row on each line"
            )
        if text and len(comments) < LOOK:
            comments.append(line)


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


FORMATS = (Format("csv", (".csv", ".tsv", ".txt", ".dat", ".asc"), read_text, gzipped=True),)
