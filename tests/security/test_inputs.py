"""Nothing that is read may run, reach out, exhaust the machine or steer the terminal (docs/security.md)."""

import ast
import gzip
import io
import os
import socket
import stat
import struct
import subprocess
import sys
import time
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path

import h5py
import nptdms
import numpy as np
import openpyxl
import pytest
import scipy.io
from click.testing import CliRunner

from shj_bayes._util.files import file_digest, plain_name, read_bytes
from shj_bayes.app.manifest import read_manifest
from shj_bayes.cli import main
from shj_bayes.errors import (
    CampaignError,
    PlanError,
    PopulationError,
    PriorError,
    RecordingError,
    ShjError,
    system_words,
)
from shj_bayes.margins.history import from_file
from shj_bayes.model.priors import read_priors
from shj_bayes.planning.protocol import read_rig
from shj_bayes.recording import limits, rows
from shj_bayes.recording.formats import binary, text
from shj_bayes.recording.reader import read, read_table
from shj_bayes.results import store as store_file
from shj_bayes.results.fit import FitRecord

TOP = Path(__file__).resolve().parents[2]
SOURCES = [*(TOP / "src").rglob("*.py"), *(TOP / "validation").rglob("*.py")]
ROWS = "".join(f"{0.1 * i},{i % 7},{i % 5}\n" for i in range(60))


# ---- code that runs what it reads ----


def test_no_call_of_the_source_runs_what_is_read():
    """No eval, exec, pickle, YAML, shell; numpy without pickles."""
    modules = {"pickle", "marshal", "shelve", "dill", "joblib", "yaml", "cloudpickle", "xmlrpc", "urllib.request"}
    wrong = []
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            wrong += [(path.name, name) for name in names if name in modules or name.split(".")[0] in modules]
            if isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
                if called in {"eval", "exec", "compile", "os.system", "os.popen", "__import__"}:
                    wrong.append((path.name, called))
                if keywords.get("shell") == "True" or keywords.get("allow_pickle") == "True":
                    wrong.append((path.name, called))
                if called in {"np.load", "numpy.load"} and keywords.get("allow_pickle") != "False":
                    wrong.append((path.name, called))
    assert wrong == []


def test_formulas_are_never_evaluated(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time_s,displacement_mm,force_kN\n" + ROWS)
    for formula in ("__import__('os').system('id')", "().__class__", "open('/etc/passwd')", "#3 if 1 else 2", "#3**9"):
        with pytest.raises(RecordingError, match=r"--columns|no column"):
            read(path, columns=f"force={formula}")


@pytest.mark.parametrize("formula", ["#" + "9" * 5000, "9" * 5000, "#3 + #" + "9" * 5000, "#" + "9" * 390, "x" * 5000])
def test_a_column_number_of_thousands_of_digits_is_one_line(tmp_path, formula):
    (tmp_path / "run.csv").write_text("time_s,displacement_mm,force_kN\n" + ROWS)
    for arguments in (["check"], ["fit", "-o", str(tmp_path / "out")]):
        command = [*arguments, str(tmp_path / "run.csv"), "--columns", f"displacement={formula}"]
        result = CliRunner().invoke(main, command)
        assert result.exit_code == 1
        assert isinstance(result.exception, SystemExit)
        assert ("allowed are 1 to 3" if len(formula) < 400 else "allowed are 400") in result.output


def test_pickled_arrays_are_refused(tmp_path):
    class Bomb:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "ran"),)

    path = tmp_path / "run.h5"
    np.save(path.with_suffix(".npy"), np.array([Bomb()], dtype=object), allow_pickle=True)
    os.replace(path.with_suffix(".npy"), path)
    with pytest.raises(RecordingError):
        read_table(path)
    scipy.io.savemat(tmp_path / "run.mat", {"o": np.array([[1, "a"]], dtype=object)})
    with pytest.raises(RecordingError, match="no column of numbers"):
        read_table(tmp_path / "run.mat")
    assert not (tmp_path / "ran").exists()


# ---- files that are windows into other files ----


def test_links_out_of_an_hdf5_file_are_not_followed(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["numbers"] = np.arange(60.0)
    np.arange(60.0).tofile(tmp_path / "secret.bin")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time_s"] = np.arange(60.0)
        file["soft"] = h5py.SoftLink("/time_s")
        file["external"] = h5py.ExternalLink("secret.h5", "numbers")
        file.create_dataset("raw", (60,), "f8", external=[(str(tmp_path / "secret.bin"), 0, 480)])
        layout = h5py.VirtualLayout((60,), "f8")
        layout[:] = h5py.VirtualSource(tmp_path / "secret.h5", "numbers", (60,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("reference", (60,), h5py.ref_dtype)
    table = read_table(tmp_path / "run.h5")
    assert [column.name for column in table.columns] == ["time"]
    left_out = next(f.message for f in table.findings if f.code == "not-numbers")
    assert "raw" in left_out
    assert "virtual" in left_out


@pytest.mark.parametrize("body", ["import os; os.abort()", "import time; time.sleep(60)", "print('not an answer')"])
def test_a_file_that_kills_or_stops_the_hdf5_library_is_one_line(tmp_path, monkeypatch, body):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["time_s"] = np.arange(60.0)
    monkeypatch.setattr(binary, "_CHILD", body)
    monkeypatch.setattr(limits, "HDF5_SECONDS", 3)
    with pytest.raises(RecordingError, match=r"run\.h5.*cannot"):
        read_table(tmp_path / "run.h5")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes or devices in the file system")
@pytest.mark.parametrize(
    "name",
    ["run.csv", "run.xlsx", "run.mat", "run.h5", "run.tdms", "campaign.toml", "own.toml", "rig.toml", "drift.csv"],
)
@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_pipes_devices_and_folders_are_refused_at_once(tmp_path, name, kind):
    path = tmp_path / name
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    readers = {"campaign.toml": (read_manifest, CampaignError), "own.toml": (read_priors, PriorError)}
    readers |= {"rig.toml": (read_rig, PlanError), "drift.csv": (from_file, RecordingError)}
    reader, error = readers.get(name, (read, RecordingError))
    with pytest.raises(error, match=r"not an ordinary file|is a folder"):
        reader(path)
    if kind == "device":
        (tmp_path / "fit.json").symlink_to("/dev/zero")
        with pytest.raises(ShjError, match="not an ordinary file"):
            store_file.read(FitRecord, tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in the file system")
def test_a_pipe_in_the_place_of_a_recording_does_not_hang_what_only_compares_it(tmp_path):
    os.mkfifo(tmp_path / "run.csv")
    with pytest.raises(OSError, match="not an ordinary file") as told:
        file_digest(tmp_path / "run.csv")
    assert system_words(told.value) == "run.csv: it is not an ordinary file; it must be a file on the disk"


def test_a_file_that_grows_while_it_is_read_is_bounded(tmp_path, monkeypatch):
    (tmp_path / "x.json").write_bytes(b"1" * 100)
    monkeypatch.setattr(os, "fstat", lambda _: os.stat_result((stat.S_IFREG, 0, 0, 1, 0, 0, 10, 0, 0, 0)))
    with pytest.raises(ShjError, match="at most 50 are read"):
        read_bytes(tmp_path / "x.json", 50, ShjError)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty"),
        ("time_s,x_mm\n" + "1,inf\n" * 20, "no rows of two or more numbers"),
        ("time_s,x_mm\n" + "".join(f"{i},{i % 5}\n" for i in range(134)) + "ok,no\n" * 266 + "1,2\n", "266 of 401"),
        ("0,1\n1,2\n", "8 to 200000 rows"),
        ("time_s,x_mm\n" + "".join(f"{i},{i % 5}\n" for i in range(200_001)), "8 to 200000 rows"),
        ("time_s,x_mm\n" + "1,2\n" * 20, "time .s. that grows"),
        ("time_s\n" + "1\n2\n" * 20, "two or more"),
        ("time_s,x_kN\n" + "".join(f"{i},{i % 5}\n" for i in range(20)), "kN"),
    ],
)
def test_a_history_is_read_as_a_recording_is(tmp_path, text, words):
    (tmp_path / "drift.csv").write_text(text, encoding="utf-8")
    with pytest.raises((RecordingError, PopulationError), match=rf"drift\.csv.*{words}"):
        from_file(tmp_path / "drift.csv")


@pytest.mark.parametrize(("head", "factor"), [("", 1.0), ("t,drift\n", 1.0), ("time (ms),drift (m)\n", 1000.0)])
def test_a_history_has_units(tmp_path, head, factor):
    (tmp_path / "drift.csv").write_text(head + "".join(f"{i},{i % 5}\n" for i in range(40)), encoding="utf-8")
    asked = from_file(tmp_path / "drift.csv")
    assert asked.motion.displacement_mm.max() == pytest.approx(4.0 * factor)
    assert asked.time_s[-1] == pytest.approx(39.0 / factor)
    assert asked.found == ()
    with (tmp_path / "drift.csv").open("a", encoding="utf-8") as stream:
        stream.write("ok,no\n" * 266)
    assert "266 lines below the numbers left out" in from_file(tmp_path / "drift.csv").found[0]


# ---- bombs ----


def workbook(path, **parts):
    """A small good workbook with some parts replaced."""
    book = openpyxl.Workbook()
    book.active.append(["time_s", "displacement_mm", "force_kN"])
    for line in ROWS.splitlines():
        book.active.append([float(cell) for cell in line.split(",")])
    stream = io.BytesIO()
    book.save(stream)
    with zipfile.ZipFile(stream) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            new.writestr(name, parts.pop(name, old.read(name)))
        for name, content in parts.items():
            new.writestr(name, content)
    return path


LAUGHS = (
    b'<?xml version="1.0"?><!-- x --><!DOCTYPE a [<!ENTITY b "ha"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">'
    b'<!ENTITY d "&c;&c;&c;&c;&c;&c;&c;&c;">]><sst><si><t>&d;</t></si></sst>'
)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_entities_in_a_workbook_are_refused(tmp_path, encoding):
    content = (
        LAUGHS if encoding == "utf-8" else LAUGHS.decode().replace('"1.0"', '"1.0" encoding="UTF-16"').encode(encoding)
    )
    path = workbook(tmp_path / "run.xlsx", **{"xl/sharedStrings.xml": content})
    with pytest.raises(RecordingError, match=r"sharedStrings\.xml declares a document type"):
        read_table(path)
    assert read_table(workbook(tmp_path / "good.xlsx")).columns[0].values.size == 60


def test_a_workbook_that_unpacks_out_of_proportion_is_refused(tmp_path):
    path = workbook(tmp_path / "run.xlsx", **{"xl/media/image1.png": bytes(50_000_000)})
    with pytest.raises(RecordingError, match="times its size"):
        read_table(path)


@pytest.mark.parametrize("row", [1_048_576, 99_999_999_999])
def test_a_cell_in_the_last_row_costs_no_time(tmp_path, row):
    lines = [zip("ABC", line.split(","), strict=True) for line in ROWS.splitlines()]
    rows = ["".join(f'<c r="{c}{i}"><v>{v}</v></c>' for c, v in line) for i, line in enumerate(lines, start=1)]
    cells = "".join(f'<row r="{i}">{row}</row>' for i, row in enumerate(rows, start=1))
    far = f'<row r="{row}"><c r="XFD{row}"><v>1</v></c></row>'
    space = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
    sheet = f'<worksheet xmlns="{space}"><sheetData>{cells}{far}</sheetData></worksheet>'
    path = workbook(tmp_path / "run.xlsx", **{"xl/worksheets/sheet1.xml": sheet.encode()})
    begin = time.process_time()
    assert read_table(path).columns[0].values.size in (60, 61)
    assert time.process_time() - begin < 8


@pytest.mark.parametrize("nested", [False, True])
def test_a_compressed_mat_file_is_counted_before_it_is_unpacked(tmp_path, monkeypatch, nested):
    """What lies in structs is in no listing; where the memory of a process cannot be bounded, the count alone holds."""
    path = tmp_path / "run.mat"
    zeros = {"time_s": np.zeros(400_000)}
    scipy.io.savemat(path, {"test": zeros} if nested else zeros, do_compression=True)
    monkeypatch.setattr(limits, "MAX_BYTES", 1_000_000)
    monkeypatch.setattr(limits, "CHUNK_BYTES", 300_000)
    monkeypatch.setattr(scipy.io, "loadmat", None)
    with pytest.raises(RecordingError, match="MiB of numbers"):
        binary.from_mat(path)
    assert len(zlib.compress(bytes(3_200_000))) < path.stat().st_size < 100_000


def test_chunks_that_unpack_beyond_the_bound_are_not_opened(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("time_s", (60,), "f8", chunks=(2**27,), maxshape=(None,))
    with pytest.raises(RecordingError, match=r"chunks of \(134217728,\) values; save it again with smaller ones"):
        read_table(tmp_path / "run.h5")


def test_datasets_that_claim_more_than_they_hold(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.create_dataset("time_s", (10**12,), "f8", chunks=(10**6,))
    with pytest.raises(RecordingError, match="MiB of numbers"):
        read_table(tmp_path / "run.h5")


@pytest.mark.parametrize("character", ["9", "a", ",", '"', "[", "_", "1,", " \t", "1e"])
def test_one_endless_line_costs_neither_time_nor_memory(tmp_path, character):
    path = tmp_path / "run.csv"
    path.write_text("time_s,displacement_mm,force_kN\n" + character * (5_000_000 // len(character)) + "\n" + ROWS)
    begin = time.process_time()
    with pytest.raises(RecordingError, match=r"line 2 has more than 65536 characters"):
        read_table(path)
    path.write_text("\n".join(character * (60_000 // len(character)) for _ in range(20)) + "\n" + ROWS)
    with suppress(RecordingError):
        read_table(path)
    assert time.process_time() - begin < 8


HEAD = "time_s,displacement_mm,force_kN\n"


@pytest.mark.parametrize("before", ["", HEAD + ROWS])
@pytest.mark.parametrize("line", ["\r", "\n", "\r\n", " \n", "#\n"])
def test_empty_lines_are_not_read_without_end(tmp_path, before, line):
    path = tmp_path / "run.csv"
    path.write_bytes((before + line * (20_000_000 // len(line)) + ROWS).encode())
    begin = time.process_time()
    with pytest.raises(RecordingError, match="100000 more empty lines and comments than rows"):
        read_table(path)
    assert time.process_time() - begin < 5


def test_packed_empty_lines_are_not_unpacked_line_by_line(tmp_path):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(b"\r" * (496 * 1024**2), 6))
    assert path.stat().st_size < 600_000
    begin = time.process_time()
    with pytest.raises(RecordingError, match="more empty lines"):
        read_table(path)
    assert time.process_time() - begin < 10


def test_an_empty_line_behind_every_row_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(text, "MAX_EMPTY", 10)
    path = tmp_path / "run.csv"
    path.write_bytes((HEAD + ROWS).replace("\n", "\r\r\n").encode())
    assert read_table(path).columns[0].values.size == 60


def test_columns_of_words_are_not_read_to_their_end(tmp_path, monkeypatch):
    monkeypatch.setattr(rows, "MAX_WORDS", 500)
    monkeypatch.setattr(rows, "BLOCK_ROWS", 1000)
    looked = []
    look = rows.TextColumn._from_text
    monkeypatch.setattr(rows.TextColumn, "_from_text", lambda self, cells: (looked.append(0), look(self, cells))[1])
    path = tmp_path / "run.csv"
    states = "".join(f"{0.1 * i:g},{i % 7},{i % 5},ok\n" for i in range(10_000))
    path.write_text("time_s,displacement_mm,force_kN,state\n" + states)
    table = read_table(path)
    assert len(looked) == 1
    assert np.all(np.isnan(table.columns[3].values))
    assert table.columns[3].values.size == table.columns[0].values.size == 10_000
    assert any("10000 cells hold text" in finding.message for finding in table.findings)
    path.write_text(HEAD + ROWS + "a,b,c\n" * 10_000)
    with pytest.raises(RecordingError, match=r"column time hold text, and fewer than two columns hold numbers"):
        read_table(path)
    monkeypatch.setattr(rows, "MAX_SPECIAL", 900)
    path.write_text(HEAD + ROWS + "1D1,2,3\n" * 10_000)
    with pytest.raises(RecordingError, match=r"more than 900 numbers have groups"):
        read_table(path)


@pytest.mark.parametrize(
    "text", ["a = " + "[" * 100_000, "a" + ".a" * 100_000 + " = 1", "a = " + "9" * 100_000, "\ufeffa"]
)
def test_toml_that_would_exhaust_the_parser(tmp_path, text):
    path = tmp_path / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CampaignError, match=r"campaign\.toml"):
        read_manifest(path)


# ---- files that are not what they seem ----


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="links need rights on this system")
def test_a_ring_of_links_is_called_so(tmp_path):
    for name in ("run.csv", "campaign.toml"):
        (tmp_path / name).symlink_to(tmp_path / name)
    with pytest.raises(RecordingError, match=r"run\.csv: too many levels of symbolic links; check"):
        read_table(tmp_path / "run.csv")
    with pytest.raises(CampaignError, match=r"campaign\.toml: Too many levels of symbolic links"):
        read_manifest(tmp_path / "campaign.toml")
    with pytest.raises(RecordingError, match=r"x\.csv: file name too long"):
        read_table(tmp_path / ("x" * 300 + "x.csv"))


@pytest.mark.parametrize(("at", "size"), [(132, 2**32 - 16), (132, 5), (188, 2**31 - 16), (188, 16), (188, 0)])
def test_a_mat_file_whose_elements_lie_about_their_size(tmp_path, at, size):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {name: np.arange(60.0) for name in ("time_s", "displacement_mm", "force_kN")})
    raw = bytearray(path.read_bytes())
    assert struct.unpack_from("<I", raw, at)[0] in (480, 536)
    struct.pack_into("<I", raw, at, size)
    path.write_bytes(raw)
    with pytest.raises(RecordingError, match=r"run\.mat: the (element at byte \d+ claims|MAT file is damaged)"):
        read_table(path)


WARN = """
import warnings, logging, sys
import shj_bayes.recording.runs as room
from shj_bayes.cli import main
def check(path, **_):
    import numpy
    numpy.log(-numpy.ones(1))
    warnings.warn("of a library")
    return [({"usable": True}, "text")]
room.check_recording = check
main()
"""


def test_warnings_of_libraries_stay_off_the_terminal(tmp_path):
    (tmp_path / "run.csv").write_text("", encoding="utf-8")
    command = [sys.executable, "-c", WARN, "check", str(tmp_path / "run.csv")]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("text\n", "")
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        for _ in range(3):
            writer.write_segment([nptdms.ChannelObject("g", n, np.arange(60.0)) for n in ("time", "disp", "force")])
    raw = (tmp_path / "run.tdms").read_bytes()
    (tmp_path / "run.tdms").write_bytes(raw[:-100])
    command = [sys.executable, "-c", "from shj_bayes.cli import main; main()", "check", str(tmp_path / "run.tdms")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (1, "")
    assert "different lengths" in done.stdout
    assert [f.code for f in read_table(tmp_path / "run.tdms").findings] == ["cut-short"]


# ---- the terminal, and the network ----


def test_control_characters_do_not_reach_the_terminal(tmp_path, hostile):
    name = "run\x1b]0;t\x07\u202e.csv"
    (tmp_path / name).write_bytes(
        f"time_s,displacement_mm,force_kN,{hostile}\n".encode() + ROWS.replace("\n", ",1\n").encode()
    )
    for arguments in (["check"], ["check", "--json"], ["check", "--columns", "force=\x1b[2J"], ["fit", "-o", "out"]):
        result = CliRunner().invoke(main, [*arguments, str(tmp_path / name)])
        assert not set(result.output) & {"\x1b", "\x07", "\u202e"}, arguments


def test_names_that_are_not_utf8_can_be_shown_and_written(tmp_path):
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/caf\xe9.csv"))
    try:
        path.write_text("time_s,displacement_mm,force_kN\n" + ROWS)
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    recording = read(path)
    recording.source.name.encode("utf-8")
    assert CliRunner().invoke(main, ["check", str(path)]).exit_code in (0, 1)


def test_letters_of_names_outlive_a_locale_that_has_none():
    name = "D\u00e4mpfer \u0416"
    assert plain_name(name.encode().decode("ascii", "surrogateescape")) == name
    assert plain_name("D\xe4mpfer".encode("latin-1").decode("utf-8", "surrogateescape")) == "D mpfer"
    assert plain_name("a\ud800b") == "a b"


def test_reading_opens_no_connection(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise AssertionError("a connection was opened")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "create_connection", refuse)
    path = tmp_path / "run.csv"
    path.write_text("time_s,displacement_mm,force_kN\n" + ROWS)
    read(path)
    read_table(workbook(tmp_path / "run.xlsx"))


def test_lengths_of_columns_are_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "MAX_COLUMNS", 4)
    path = tmp_path / "run.csv"
    path.write_text("\n".join(",".join("123456") for _ in range(50)))
    with pytest.raises(RecordingError, match="6 columns; allowed are"):
        read_table(path)


assert sys.flags.optimize == 0, "these tests need their asserts"
