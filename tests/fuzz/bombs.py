"""Small files that would take minutes, gigabytes or the process, if nothing were counted before it is built."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np

_XML = '<?xml version="1.0" encoding="UTF-8"?>'
_TYPES = "http://schemas.openxmlformats.org/package/2006/content-types"
_LINKS = "http://schemas.openxmlformats.org/package/2006/relationships"
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_KIND = "application/vnd.openxmlformats-officedocument.spreadsheetml"
_MAT = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + b"\x00\x01IM"
_ROW = "<row><c><v>1</v></c><c><v>2</v></c></row>"

# What is said of each: its words tell that the bound was met, and not the memory.
SAID = {
    "text.xlsx": "no sheet holds rows of two or more numbers",
    "sheets.xlsx": "names more than 200 sheets",
    "names.xlsx": "names more than 200 sheets",
    "row.xlsx": "a row or text of more than 16 MiB",
    "ragged.json": "allowed are 10000000 cells",
    "twice.json": "stands twice in one object",
    "empty.mat": "no column of numbers found",
    "wide.mat": "no column of numbers found",
    "deep.mat": "the library of its format cannot read it and gave up",
    "chain.mat": "the library of its format cannot read it and gave up",
    "small.mat": "of numbers; allowed are 512 MiB",
    "chunk.h5": "cannot be read (OSError",
    "deep.h5": "cannot be read (RecursionError",
    "many.h5": "no column of numbers found",
}


def bombs(folder: Path) -> dict[str, bytes]:
    """All of them, by file name."""
    cells = '<c t="s"><v>0</v></c>' * 512
    files = {
        "text.xlsx": _workbook(1, 1, f"<row>{cells}</row>" * 2, "a" * 4_000_000),
        "sheets.xlsx": _workbook(1900, 1900, _ROW),
        "names.xlsx": _workbook(20_000, 1, _ROW * 2000),
        "row.xlsx": _workbook(1, 1, f"<row>{'<c/>' * 4_500_000}</row>", filling=100_000),
        "ragged.json": f"[{json.dumps([0] * 512)}{',[0]' * 60_000}]".encode(),
        "twice.json": b'{"time_s":[0,1],"force_kN":[1,2],"displacement_mm":[1,2],"force_kN":[3,4]}',
        "empty.mat": (struct.pack("<5i", 0, 0, 0, 0, 2) + b"a\x00") * 20_000,
        "wide.mat": _packed(_cell(_cell(b"", 0) * 200_000, 200_000)),
        "deep.mat": _packed(_deep(20_000)),
        "chain.mat": _packed(_cell(_cell(b"", 1) * 40_000, 1)),
        "small.mat": _packed(_cell(_element(14, _head(6, 70_000_000) + _element(2, bytes(70_000_000))), 1)),
    }
    with h5py.File(folder / "chunk.h5", "w") as file:
        setup = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        setup.set_chunk((1000,))
        setup.set_deflate(9)
        setup.set_deflate(9)
        one = h5py.h5d.create(file.id, b"time", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((1000,)), setup)
        packer = zlib.compressobj(9)
        first = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
        again = packer.compress(bytes(2**24)) + packer.flush(zlib.Z_FULL_FLUSH)
        one.write_direct_chunk((0,), zlib.compress(first + 199 * again + packer.flush(), 9))  # 3.2 GB
    with h5py.File(folder / "deep.h5", "w", libver="latest") as file:
        group: h5py.Group = file
        for _ in range(1000):
            group = group.create_group("g")
        group["time"] = np.arange(60.0)
    with h5py.File(folder / "many.h5", "w", libver="latest") as file:
        for number in range(3000):
            file.create_group(str(number))
    return files | {name: (folder / name).read_bytes() for name in ("chunk.h5", "deep.h5", "many.h5")}


def _workbook(names: int, sheets: int, rows: str, text: str = "", filling: int = 0) -> bytes:
    """A workbook of so many names for so many sheets of the same rows; `filling` bytes of noise keep its ratio low."""
    stream = io.BytesIO()
    over = "".join(
        f'<Override PartName="/xl/sheet{i}.xml" ContentType="{_KIND}.worksheet+xml"/>' for i in range(sheets)
    )
    over += f'<Override PartName="/xl/text.xml" ContentType="{_KIND}.sharedStrings+xml"/>'
    links = "".join(
        f'<Relationship Id="r{i}" Type="{_OFFICE}/worksheet" Target="sheet{i}.xml"/>' for i in range(sheets)
    )
    listed = "".join(f'<sheet name="s{i}" sheetId="{i + 1}" r:id="r{i % sheets}"/>' for i in range(names))
    parts = {
        "[Content_Types].xml": f'{_XML}<Types xmlns="{_TYPES}"><Default Extension="xml" ContentType="application/xml"/>'
        f'<Override PartName="/xl/workbook.xml" ContentType="{_KIND}.sheet.main+xml"/>{over}</Types>',
        "_rels/.rels": f'{_XML}<Relationships xmlns="{_LINKS}"><Relationship Id="r" Type="{_OFFICE}/officeDocument" '
        'Target="xl/workbook.xml"/></Relationships>',
        "xl/_rels/workbook.xml.rels": f'{_XML}<Relationships xmlns="{_LINKS}">{links}</Relationships>',
        "xl/workbook.xml": f'{_XML}<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>{listed}</sheets></workbook>',
        "xl/text.xml": f'{_XML}<sst xmlns="{_MAIN}"><si><t>{text}</t></si></sst>',
    }
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
        for i in range(sheets):
            content = f'{_XML}<worksheet xmlns="{_MAIN}"><sheetData>{rows}</sheetData></worksheet>'
            archive.writestr(f"xl/sheet{i}.xml", content)
        archive.writestr("xl/media/noise.bin", np.random.default_rng(1).bytes(filling))
    return stream.getvalue()


def _element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content


def _head(kind: int, size: int) -> bytes:
    """Class, size and name of a matrix of MATLAB."""
    return _element(6, struct.pack("<II", kind, 0)) + _element(5, struct.pack("<ii", 1, size)) + _element(1, b"a" * 8)


def _cell(content: bytes, claimed: int) -> bytes:
    return _element(14, _head(1, claimed) + content)


def _deep(levels: int) -> bytes:
    """Cells in one another."""
    head = _head(1, 1)
    sizes = [len(head) * (i + 1) + 8 * i for i in range(levels)]
    return b"".join(struct.pack("<II", 14, size) + head for size in reversed(sizes))


def _packed(matrix: bytes) -> bytes:
    return _MAT + _element(15, zlib.compress(matrix))
