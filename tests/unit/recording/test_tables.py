import gzip
import hashlib
import json
import os
import re
import zipfile
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pytest
import scipy.io
from nptdms import ChannelObject, TdmsWriter

from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.formats import records, text
from shj_bayes.recording.reader import by_ending, read, read_table

HEAD = "time_s,displacement_mm,force_kN"


def rows(recording, n=None):
    return np.column_stack([recording.time_s, recording.displacement_mm, recording.force_kN])[:n]


def lines(recording, separator=",", decimal=".", n=None):
    out = [separator.join(f"{value!r}".replace(".", decimal) for value in row) for row in rows(recording, n).tolist()]
    return "\n".join(out) + "\n"


def same(left, right):
    for name in ("time_s", "displacement_mm", "force_kN"):
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name))


@pytest.mark.parametrize(
    ("separator", "decimal", "head"),
    [
        (",", ".", HEAD),
        ("\t", ".", HEAD.replace(",", "\t")),
        (";", ".", "Time [s];Disp. [mm];Load [kN]"),
        (";", ",", "Time [s];Displacement [mm];Force [kN]"),
        ("\t", ",", "Time (s)\tDisplacement (mm)\tForce (kN)"),
        ("   ", ".", "time_s  displacement_mm  force_kN"),
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_text_dialects(tmp_path, small, separator, decimal, head, encoding):
    path = tmp_path / "run.csv"
    path.write_bytes((f"Prüfung 7, n°3\n{head}\n" + lines(small, separator, decimal)).encode(encoding))
    recording = read(path)
    for name in ("time_s", "displacement_mm", "force_kN"):
        np.testing.assert_allclose(getattr(recording, name), getattr(small, name), rtol=1e-14, atol=1e-13)
    assert recording.usable
    assert ("decimal-comma" in {f.code for f in recording.findings}) == (decimal == ",")


@pytest.mark.parametrize("first", ["0.0,,", "0.0,nan,OVERLOAD"])
def test_a_first_sample_with_its_readings_lost_is_no_header(tmp_path, small, first):
    path = tmp_path / "run.csv"
    path.write_text(f"{HEAD}\n{first}\n" + "".join(line + "\n" for line in lines(small).splitlines()[1:]))
    recording = read(path)
    assert recording.time_s[0] == small.time_s[1]
    np.testing.assert_array_equal(recording.force_kN, small.force_kN[1:])


def test_units_row_preamble_and_trailing_notes(tmp_path, small):
    path = tmp_path / "run.txt"
    path.write_text(
        "Machine X\nOperator: A. B.\n\nTime\tDisplacement\tForce\n(s)\t(mm)\t(kN)\n"
        + lines(small, "\t")
        + "End of test\nchecked by C. D.\n"
    )
    recording = read(path)
    same(recording, small)
    assert recording.source.units == {"time": "s", "displacement": "mm", "force": "kN"}
    assert [f.count for f in recording.findings if f.code == "notes"] == [2]


@pytest.mark.parametrize(
    "units", ["s,mm,kN,degC,V,bar,%", "[s],[mm],[kN],[\u00b0C],[mV],[-],[m/s^2]", "sec,mm,kN,C,N/mm2,1/s,"]
)
def test_units_of_columns_that_nobody_needs_may_be_anything(tmp_path, small, units):
    others = np.ones((small.n_samples, 4))
    path = tmp_path / "run.csv"
    np.savetxt(
        path,
        np.column_stack([rows(small), others]),
        delimiter=",",
        fmt="%.17g",
        header=f"Elapsed,Stroke,Load,Temperature,Valve,Pressure,Level\n{units}",
        comments="",
        encoding="utf-8",
    )
    recording = read(path, columns="time=Elapsed")
    same(recording, small)
    assert recording.source.units == {"time": units.split(",")[0].strip("[]"), "displacement": "mm", "force": "kN"}
    ignored = next(f for f in recording.findings if f.code == "columns-ignored")
    assert "Temperature" in ignored.message


def test_names_below_a_title_are_no_units(tmp_path, small):
    path = tmp_path / "run.csv"
    path.write_text("Test 7,Rig B,June\ntime,stroke,load\n" + lines(small), encoding="utf-8")
    same(read(path), small)


def test_a_refusal_shows_the_first_row(tmp_path, small):
    path = tmp_path / "run.csv"
    path.write_text("a,b,c\n0.5,-3.25,17\n0.6,1,2\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"columns are 1: a, 2: b, 3: c; the first row is 0\.5, -3\.25, 17"):
        read(path)


def test_header_in_quotes_and_header_as_a_comment(tmp_path, small):
    path = tmp_path / "run.csv"
    path.write_text('"Time, s","Displacement, total (mm)","Force (kN)"\n' + lines(small))
    same(read(path, columns="displacement=Displacement, total"), small)
    np.savetxt(path, rows(small), header=HEAD, delimiter=",", fmt="%.17g")
    same(read(path), small)


def test_gzip_and_digest(tmp_path, small):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(f"# SIMULATED for this test\n{HEAD}\n{lines(small)}".encode()))
    recording = read(path)
    same(recording, small)
    assert recording.source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert len(recording.source.sha256) == 64
    assert "simulated" in {f.code for f in recording.findings}


def test_text_cells_are_counted_and_named(tmp_path, small):
    body = lines(small).splitlines()
    for i in (100, 200):
        cells = body[i].split(",")
        body[i] = f"{cells[0]},{cells[1]},OVERLOAD"
    body[300] = body[300].split(",")[0] + ",,"
    path = tmp_path / "run.csv"
    path.write_text(HEAD + "\n" + "\n".join(body) + "\n")
    recording = read(path)
    assert recording.n_samples == small.n_samples
    assert np.flatnonzero(~recording.used).tolist() == [100, 200, 300]
    cell = next(f for f in recording.findings if f.code == "text-cells")
    assert cell.count == 2
    assert "OVERLOAD" in cell.message
    assert "row 101" in cell.message


def test_a_channel_that_is_mostly_text_is_refused(tmp_path, small):
    """A decimal comma from the hundredth row on: what is left would pass for a short recording."""
    body = lines(small, ";").splitlines()
    path = tmp_path / "run.csv"
    path.write_text(
        HEAD.replace(",", ";") + "\n" + "\n".join([*body[:100], *(b.replace(".", ",") for b in body[100:])])
    )
    recording = read(path)
    assert not recording.usable
    refused = [f.message for f in recording.findings if f.severity == "unusable"]
    assert any("force" in said and "allowed are 5%" in said and "one decimal sign" in said for said in refused)


def test_numbers_that_are_taken_apart_at_their_decimal_commas_are_refused(tmp_path, small):
    path = tmp_path / "run.csv"
    path.write_text(HEAD + "\n" + "\n".join(",".join(f"{v:.3f}".replace(".", ",") for v in row) for row in rows(small)))
    with pytest.raises(RecordingError, match=r"header has 3 cells and the rows of numbers 6.*export with semicolons"):
        read(path)


def test_workbook(tmp_path, small):
    book = openpyxl.Workbook()
    book.active.title = "Notes"
    book.active["A1"] = "nothing here"
    sheet = book.create_sheet("Data")
    sheet.append(["Elapsed time (s)", "Displacement (mm)", "Force (kN)"])
    for row in rows(small).tolist():
        sheet.append(row)
    path = tmp_path / "run.xlsx"
    book.save(path)
    recording = read(path)
    np.testing.assert_allclose(rows(recording), rows(small), rtol=1e-14)  # workbooks store 16 digits
    assert any(f.code == "sheet" and "Data" in f.message for f in recording.findings)


def shapes(recording):
    columns = dict(zip(HEAD.split(","), rows(recording).T.tolist(), strict=True))
    records = [dict(zip(columns, row, strict=True)) for row in rows(recording).tolist()]
    return {
        "records": records,
        "columns": columns,
        "records under a key": {"device": "A1", "gain": 2, "data": records},
        "columns under a key": {"channels": columns, "operator": "C. D."},
    }


@pytest.mark.parametrize("shape", ["records", "columns", "records under a key", "columns under a key"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_json(tmp_path, small, shape, encoding):
    path = tmp_path / "run.json"
    path.write_bytes(json.dumps(shapes(small)[shape]).encode(encoding))
    recording = read(path)
    same(recording, small)
    assert recording.source.format == "json"
    assert recording.source.units == {"time": "s", "displacement": "mm", "force": "kN"}


def test_json_rows_units_scalars_and_empty_cells(tmp_path, small):
    path = tmp_path / "run.json"
    path.write_text(json.dumps(rows(small).tolist()), encoding="utf-8")
    same(read(path, columns="time=1,displacement=2,force=3"), small)
    content = shapes(small)["columns"] | {
        "gain": 2,
        "note": "SIMULATED",
        "units": {"volts": "N"},
        "operator": ["C", "D"],
    }
    content["volts"] = [500.0 * f for f in content.pop("force_kN")]
    content["volts"][100] = None
    content["volts"][200] = "OVERLOAD"
    path.write_text(json.dumps(content), encoding="utf-8")
    recording = read(path, columns="force=gain*volts", units="force=N")
    np.testing.assert_allclose(recording.force_kN[:100], small.force_kN[:100], rtol=1e-12)
    assert np.flatnonzero(~recording.used).tolist() == [100, 200]
    assert {"simulated", "text-cells", "not-numbers", "empty-cells"} <= {f.code for f in recording.findings}
    assert read(path, columns="force=volts").source.units["force"] == "N"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "cannot be read as json"),
        ("[" * 100_000, "cannot be read as json"),
        ('{"truth": {"K": 18.0}}', "no table of numbers in this JSON"),
        ("[1, 2, 3]", "no table of numbers in this JSON"),
        ('[{"time_s": 1}, {"time_s": 2}]', "no displacement column"),
        (f"[[{'1,' * 600}1], [2, 3]]", "601 columns; allowed are 512"),
        (f"[[{'9' * 5000}, 1, 2], [2, 3, 4]]", "name it with --columns"),
    ],
)
def test_json_that_holds_no_recording_is_refused(tmp_path, content, words):
    path = tmp_path / "run.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(RecordingError, match=re.escape(words)):
        read(path)


def test_json_is_bounded(tmp_path, monkeypatch):
    path = tmp_path / "run.json"
    path.write_text("[[1, 2, 3], [2, 3, 4]]", encoding="utf-8")
    monkeypatch.setattr(records, "MAX_JSON_BYTES", 20)
    with pytest.raises(RecordingError, match=r"of JSON at most 0 MiB.*export CSV or HDF5"):
        read(path)


def test_mat_v5(tmp_path, small):
    path = tmp_path / "run.mat"
    scipy.io.savemat(
        path,
        {
            "t": small.time_s[:, None],
            "x": small.displacement_mm[None, :] / 1e3,
            "volts": small.force_kN / 2.5,
            "gain": 2.5,
            "cells": np.array([[1, "a"]], dtype=object),
            "info": {"a": 1},
        },
    )
    recording = read(path, columns="force=gain*volts", units="s,m,kN")
    np.testing.assert_allclose(rows(recording), rows(small), rtol=1e-12)
    assert any(f.code == "not-numbers" and "cells" in f.message for f in recording.findings)


@pytest.mark.parametrize("ending", ["h5", "mat"])
def test_hdf5_and_mat_v73(tmp_path, small, ending, monkeypatch):
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)  # where it is set, numpy writes in another way
    path = tmp_path / f"run.{ending}"
    with h5py.File(path, "w", userblock_size=512 if ending == "mat" else 0) as file:
        for name, values, unit in (("time", small.time_s, "s"), ("force", small.force_kN, "kN")):
            file.create_dataset(name, data=values[None, :]).attrs["units"] = unit
        group = file.create_group("rig")
        group.create_dataset("both", data=np.vstack([small.displacement_mm, small.force_kN]))
        file["link"] = h5py.ExternalLink("elsewhere.h5", "/secret")
        file.create_dataset("words", data="abc")
    if ending == "mat":
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(512))
    recording = read(path, columns="displacement=rig/both[1]", units="displacement=mm")
    same(recording, small)


def test_tdms_with_channels_and_with_a_waveform(tmp_path, small):
    path = tmp_path / "run.tdms"
    step = {"wf_increment": 0.05, "unit_string": "mm"}
    with TdmsWriter(path) as writer:
        writer.write_segment(
            [
                ChannelObject("rig", "Displacement", small.displacement_mm, properties=step),
                ChannelObject("rig", "Force", small.force_kN, properties={"wf_increment": 0.05, "unit_string": "kN"}),
            ]
        )
    recording = read(path, units="time=s")
    np.testing.assert_allclose(rows(recording), rows(small), atol=1e-12)
    assert any(f.code == "time-from-step" and f.severity == "assumed" for f in recording.findings)


# --- what is refused, and in which words ---


def test_missing_folder_empty_device(tmp_path):
    with pytest.raises(RecordingError, match="there is no such file"):
        read_table(tmp_path / "none.csv")
    with pytest.raises(RecordingError, match="is a folder"):
        read_table(tmp_path)
    (tmp_path / "empty.csv").touch()
    with pytest.raises(RecordingError, match=r"empty \(0 bytes\)"):
        read_table(tmp_path / "empty.csv")
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(RecordingError, match="not an ordinary file"):
        read_table(tmp_path / "pipe.csv")


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("run.pkl", b"x", r"'.pkl' is not supported; allowed are .csv"),
        ("run.xlsx.gz", b"x", "is not supported"),
        ("run.xlsx", b"no workbook", "is not an XLSX workbook"),
        ("run.h5", b"no hdf5", "is not an HDF5 file"),
        ("run.mat", b"no mat file at all, but long enough to hold a header" * 9, "is not a MAT file"),
        ("run.mat", b"x", "is not a MAT file"),
        ("run.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(99), "is not a MAT file"),
        ("run.mat", b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\x0e\0\0\0", "MAT file is damaged"),
        ("run.mat", b"\0\0\0\0\x09" + bytes(99), "MAT file is damaged"),
        ("run.tdms", b"no tdms", "is not a TDMS file"),
        ("run.csv.gz", b"\x1f\x8b damaged", "gzip file is damaged"),
        ("run.csv", b"just words\nand more words\n", "no rows of two or more numbers"),
        ("run.csv", b"\x00\x01\x02\x03" * 50 + b"abc" * 200, "is not text"),
        ("run.csv", HEAD.encode() + b"\n", "no rows of two or more numbers"),
    ],
)
def test_refusals_name_the_file_and_the_reason(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=words) as caught:
        read_table(path)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_archives_that_unpack_beyond_the_bound_are_stopped(tmp_path, monkeypatch, small):
    monkeypatch.setattr(text, "MAX_BYTES", 2000)
    monkeypatch.setattr(text, "CHUNK_BYTES", 500)
    monkeypatch.setattr(limits, "MAX_BYTES", 2000)
    bomb = tmp_path / "run.csv.gz"
    bomb.write_bytes(gzip.compress(b"1,2,3\n" * 100_000))
    with pytest.raises(RecordingError, match="unpacks to more than"):
        read_table(bomb)
    book = tmp_path / "run.xlsx"
    with zipfile.ZipFile(book, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/worksheets/sheet1.xml", b"0" * 100_000)
    with pytest.raises(RecordingError, match="unpacks to"):
        read_table(book)


def test_mat_objects_are_never_loaded(tmp_path):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"cells": np.array([[1, "a"]], dtype=object), "s": {"by": "C. D."}})
    with pytest.raises(RecordingError, match="no column of numbers"):
        read_table(path)


def test_the_documents_list_every_ending():
    page = (Path(__file__).resolve().parents[3] / "docs" / "recordings.md").read_text(encoding="utf-8")
    table = page.partition("## Formats")[2].partition("\n## ")[0]
    assert [ending for ending in by_ending() if f"`{ending}`" not in table] == []
