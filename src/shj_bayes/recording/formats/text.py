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
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain, islice, pairwise
from pathlib import Path

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import RecordingError
from shj_bayes.recording.clock import Stamps
from shj_bayes.recording.columns import roles_named
from shj_bayes.recording.limits import CHUNK_BYTES, MAX_BYTES, MAX_EMPTY, MAX_LINE, SAME_INSTANT
from shj_bayes.recording.recording import Column, Finding
from shj_bayes.recording.rows import LOOK, TextRows, find_dialect, head_of
from shj_bayes.recording.tables import Format, Table, bounded_columns, seconds_of

# hyphens, dashes and minus signs before a number or in its exponent; marks without width
_MINUS = re.compile("(?:(?<!\\w)|(?<=[0-9][eEdD]))[\u2010-\u2015\u2212\ufe58\ufe63\uff0d](?=[.,]?[0-9])")
_INVISIBLE = dict.fromkeys((0xFEFF, 0x200B, 0x200C, 0x200D, 0x200E, 0x200F, 0x2060))
_NO_ROW = {"", "#", "%"}  # how lines begin that are no rows
_HEAD = 4096  # bytes in which the zeros of UTF-16 are looked for


def read_text(path: Path) -> Table:
    """Read a text table, plain or gzipped: UTF-8, -16 or -32 by marks or zeros, else Latin-1 as Windows writes it."""
    encoding = _by_head(next(_pieces(path), b"")[:_HEAD], path.name)
    try:
        return table_from_lines(_lines(path, encoding), path.name, _read_as(encoding))
    except UnicodeDecodeError as error:
        if encoding not in ("utf-8", "utf-8-sig"):
            raise RecordingError(
                f"{path.name} begins as {encoding} but is damaged ({error.reason}); export it again, as UTF-8"
            ) from error
        return table_from_lines(_lines(path, "cp1252"), path.name, _read_as("Latin-1"))


def _read_as(encoding: str) -> list[Finding]:
    return [] if encoding.startswith("utf-8") else [Finding("encoding", "note", f"text read as {encoding}")]


def table_from_lines(blocks: Iterable[Sequence[str]], name: str, notes: Iterable[Finding] = ()) -> Table:
    """Find header and numbers in blocks of lines of text; empty ones mean nothing, and ``#`` or ``%`` begins a comment.

    `notes` is what was met before.
    """
    text = _Lines(blocks, name)
    stream = iter(text)
    first = list(islice(stream, 2 * LOOK))
    dialect = find_dialect(first, name)
    head = head_of(first[: dialect.first], dialect)
    if not any(head.names) and text.comments:  # numpy and gnuplot write the header as a comment
        head = head_of([line.lstrip("#% ") for line in text.comments], dialect)
    above = len(dialect.cells(first[dialect.first - 1])) if dialect.first else 0
    if not any(head.names) and dialect.separator == "," and 2 * above == dialect.width:  # numbers taken apart
        raise RecordingError(
            f"{name}: the header has {above} cells and the rows of numbers {dialect.width}, so commas seem to be the "
            "decimal sign and to stand between the columns; export with semicolons between the columns, or with "
            "decimal points"
        )
    bounded_columns(head.names, name)
    rows = TextRows(dialect, head, name, text.line_of)
    rows.read(chain(first[dialect.first :], stream))
    findings = [*notes, *rows.findings()]
    if any("simulated" in line.lower() for line in text.comments):
        findings.append(Finding("simulated", "note", "the file says that it is simulated, not measured"))
    if dialect.decimal == ",":
        findings.append(Finding("decimal-comma", "assumed", "a comma is read as the decimal sign (0,5 is one half)"))
    columns = _with_times(rows, findings)
    return Table(name, tuple(columns), has_header=any(head.names), findings=tuple(findings))


class _Lines:
    """Lines that may be rows, out of blocks of lines; the first comments go into a list."""

    def __init__(self, blocks: Iterable[Sequence[str]], name: str) -> None:
        self.blocks, self.name = blocks, name
        self.comments: list[str] = []
        self.n_rows = 0
        self.passed = array("q")  # how many rows came before each line that is none

    def __iter__(self) -> Iterator[str]:
        """Give the rows, in the signs of typewriters."""
        for block in self.blocks:
            if all(map(str.isascii, block)) and _NO_ROW.isdisjoint({line.lstrip()[:1] for line in block}):
                self.n_rows += len(block)
                yield from block  # as it is, which nearly all blocks are
                continue
            for line in block:
                text = line.lstrip()
                if text[:1] not in _NO_ROW:
                    self.n_rows += 1
                    # A minus is a hyphen, whatever a typesetter made of it, and nothing is invisible.
                    yield line if line.isascii() else _MINUS.sub("-", line.translate(_INVISIBLE))
                    continue
                self.passed.append(self.n_rows)
                if len(self.passed) - self.n_rows > MAX_EMPTY:
                    raise RecordingError(
                        f"{self.name} holds {MAX_EMPTY} more empty lines and comments than rows of numbers; that is no "
                        f"recording; export it again, one row on each line"
                    )
                if text and len(self.comments) < LOOK:
                    self.comments.append(line)

    def line_of(self, row: int) -> int:
        """Give the number of a row's line in the file, counted from 1."""
        return row + 1 + bisect_right(self.passed, row)


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


def _pieces(path: Path) -> Iterator[bytes]:
    """Bytes of a file, unpacked, in pieces; stopped early where they grow beyond any recording, or are damaged."""
    packed, total = path.suffix.lower() == ".gz", 0
    with path.open("rb") as raw:
        stream = gzip.GzipFile(fileobj=raw) if packed else raw
        while True:
            try:
                piece = stream.read(CHUNK_BYTES)
            except (OSError, EOFError, zlib.error) as error:
                what = "gzip file is damaged" if packed else "file cannot be read to its end"
                raise RecordingError(f"{path.name}: the {what} ({error}); copy or compress it again") from error
            total += len(piece)
            if total > MAX_BYTES:
                raise RecordingError(
                    f"{path.name} unpacks to more than {MAX_BYTES // 1024**2} MiB; that is no recording; "
                    f"export fewer channels or rows"
                )
            if not piece:
                return
            yield piece


def _lines(path: Path, encoding: str) -> Iterator[list[str]]:
    """Lines of a file without their ends, each of a bounded length, in blocks."""
    decoder = codecs.getincrementaldecoder(encoding)("replace" if encoding == "cp1252" else "strict")
    text = io.IncrementalNewlineDecoder(decoder, translate=True)
    number, held = 0, ""
    for piece in chain(_pieces(path), [b""]):
        *whole, held = (held + text.decode(piece, final=not piece)).split("\n")
        longest = max(map(len, (*whole, held)))
        if longest > MAX_LINE:
            at = number + 1 + next(i for i, line in enumerate((*whole, held)) if len(line) == longest)
            raise RecordingError(
                f"{path.name}: line {at} has more than {MAX_LINE} characters; a row of a recording has some dozens; "
                f"export it as a table with one row for each sample"
            )
        number += len(whole)
        yield whole
    if held:
        yield [held]


def _with_times(rows: TextRows, findings: list[Finding]) -> list[Column]:
    """Columns of what was read, with one time where all channels have the same, and what to say."""
    columns, stamps = list[Column](), [column.stamps for column in rows.columns]
    dates = [one for one in stamps if one is not None and not one.n_clocks]
    for i, (column, label) in enumerate(zip(rows.columns, rows.labels, strict=True)):
        values, unit, written, own = column.joined(), rows.head.units[i], rows.head.written[i], stamps[i]
        if own is not None:
            beside = dates[0] if len(dates) == 1 and not own.known else None
            values, unit, said = own.joined(label, written, beside)
            findings += said if own.n_clocks else []
        columns.append(Column(label, values, unit, written, column.n_words))
    timed = _with_waves(columns, rows, findings)
    each_its_own = len(timed) < len(columns)
    return timed if each_its_own else _one_time(timed, stamps, rows.file, findings)


def _with_waves(columns: list[Column], rows: TextRows, findings: list[Finding]) -> list[Column]:
    """Columns of a LabVIEW file whose ``X_Value`` is empty, with the times that start and interval give."""
    waves = rows.head.waves
    if not any(step > 0 for _, _, step in waves) or np.isfinite(columns[0].values).any():
        return columns
    edges = [0, *(row for row, _ in rows.heads), columns[0].values.size]
    heads = [rows.head, *(one for _, one in rows.heads)]
    clocks = []
    for i in range(len(columns) - 1):
        own = [one.waves[i] if i < len(one.waves) else ("", 0.0, 0.0) for one in heads]
        starts = Stamps()
        starts.add(started for started, _, _ in own)
        pieces = [
            start + first + step * np.arange(b - a)
            for start, (_, first, step), (a, b) in zip(
                np.nan_to_num(starts.absolute()), own, pairwise(edges), strict=True
            )
        ]
        clocks.append(np.concatenate(pieces))
    first = min(float(clock[0]) for clock in clocks)
    if any(not np.allclose(clock, clocks[0], rtol=0, atol=1e-9) for clock in clocks):
        return [replace(column, clock_s=clock - first) for column, clock in zip(columns[1:], clocks, strict=True)]
    shown = f"{columns[0].label}: {waves[0][2]:g} s"
    findings.append(Finding("time-from-step", "assumed", f"time is made from the constant interval of {shown}"))
    return [replace(columns[0], name="X_Value", values=clocks[0] - first, unit="s"), *columns[1:]]


def _one_time(columns: list[Column], stamps: list[Stamps | None], name: str, findings: list[Finding]) -> list[Column]:
    """Columns without times that say the same as another one; where these differ, each channel keeps its own."""
    named = {i: seconds_of(column) for i, column in enumerate(columns) if "time" in roles_named(column.name)}
    clocks = {i: clock for i, clock in named.items() if clock is not None}
    if len(clocks) < 2:
        return columns
    times = list(clocks)
    # numbers rather than stamps, and of these the finer
    best = min(times, key=lambda i: (stamps[i] is not None, -np.unique(columns[i].values).size))
    same = [i for i in times if i != best and _agree((clocks[best], stamps[best]), (clocks[i], stamps[i]))]
    paired = times[0] == 0 and times[-1] < len(columns) - 1 and bool(np.all(np.diff(times) > 1))
    if paired and len(same) < len(times) - 1:
        if any(stamps[i] is not None for i in times):
            shown = ", ".join(f"{columns[i].label} for {columns[i + 1].name}" for i in times)
            raise RecordingError(f"{name}: the channels have time stamps of their own ({shown}); export one for all")
        known = {i: np.isfinite(columns[i].values) for i in times}  # a channel goes as far as its time
        return [
            replace(column, values=column.values[known[i]], clock_s=clocks[i][known[i]])
            for i, end in pairwise([*times, len(columns)])
            for column in columns[i + 1 : end]
        ]
    if same:
        shown = ", ".join(columns[i].label for i in same)
        message = f"{shown}: the same times as {columns[best].label}, which is read"
        findings.append(Finding("times-agree", "note", message, len(same)))
    return [column for i, column in enumerate(columns) if i not in same]


def _agree(one: tuple[FloatArray, Stamps | None], other: tuple[FloatArray, Stamps | None]) -> bool:
    """Whether two times are the same; seconds and time stamps to the last digit of the coarser, from their first on."""
    (a, first), (b, second) = one, other
    if first is not None and second is not None:
        if next(iter(first.known), "") != next(iter(second.known), ""):
            return False
        a, b = first.absolute(), second.absolute()
    both = np.isfinite(a) & np.isfinite(b)
    if np.count_nonzero(both) < max(2, 0.99 * np.count_nonzero(np.isfinite(a) | np.isfinite(b))):
        return False
    a, b = a[both], b[both]
    steps = [float(np.median(moves[moves > 0])) if np.any(moves > 0) else 0.0 for moves in (np.diff(a), np.diff(b))]
    if (first is None) != (second is None):
        return bool(np.max(np.abs(a - a[0] - b + b[0])) <= 1.01 * max(steps))
    return bool(np.max(np.abs(a - b)) <= SAME_INSTANT * steps[0])


FORMATS = (Format("csv", (".csv", ".tsv", ".txt", ".dat", ".asc", ".lvm"), read_text, gzipped=True),)
