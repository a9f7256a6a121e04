"""Text tables as laboratories leave them, each made of one device: the same readings, or a refusal with the cause."""

import datetime as dt
import gzip
import time
from itertools import pairwise

import numpy as np
import openpyxl
import pytest
from one_device import plain

from shj_bayes.errors import RecordingError
from shj_bayes.recording.reader import read

P = plain()
T, X, F = P.time_s, P.displacement_mm, P.force_kN
N, HALF = T.size, T.size // 2
INCH, KIP, TONNE = 25.4, 4.4482216152605, 9.80665
HEAD = "Time (s),Displacement (mm),Force (kN)"
START = dt.datetime(2024, 5, 3, 23, 59)


def rows(*columns, separator=",", digits=5):
    """Lines of columns of numbers or words."""
    texts = [[c if isinstance(c, str) else f"{c:.{digits}f}" for c in column] for column in columns]
    return [separator.join(row) for row in zip(*texts, strict=True)]


def stamped(form):
    """A time stamp for each reading."""
    return [form(START + dt.timedelta(seconds=float(second))) for second in T]


def millis(moment, form):
    """Date and time with three decimals."""
    return moment.strftime(form) + f".{moment.microsecond // 1000:03d}"


def file(tmp_path, lines, name="run.csv"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def same(recording, at=slice(None)):
    """The readings of the device, at their times."""
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], T[at] - T[at][0], atol=1e-6)
    np.testing.assert_allclose(recording.displacement_mm, X[at], atol=2e-4)
    np.testing.assert_allclose(recording.force_kN, F[at], atol=2e-3)
    assert recording.run_starts == {}
    return {finding.code: finding for finding in recording.findings}


# --- heads -------------------------------------------------------------------------------------------------------
BODY = rows(T, X, F)
MTS = "Running Time\tAxial Displacement\tAxial Force"
DAQ = ["Data Acquisition\t\t\tTime:\t8.0\tSec\t5/3/2024 10:00:00 AM"]
TABBED = rows(T, X, F, separator="\t")
PAIRS = rows(T, X, T, F)
PAIR_HEAD = ["Timestamp,2024-05-03 10:00:00,Timestamp,2024-05-03 10:00:00", "Interval,0.05,Interval,0.05"]
LVM = ["LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "***End_of_Header***\t", "\t", "Channels\t2\t\t"]


def lvm(x0="0.0\t0.0", delta="0.05\t0.05", times="10:00:00\t10:00:00"):
    """Head of a LabVIEW file of two channels."""
    dates = "Date\t2024/05/03\t2024/05/03"
    values = ["Y_Unit_Label\tmm\tkN", "X_Dimension\tTime\tTime", f"X0\t{x0}", f"Delta_X\t{delta}"]
    return [
        *LVM,
        dates,
        f"Time\t{times}",
        *values,
        "***End_of_Header***\t\t\t",
        "X_Value\tDisplacement\tForce\tComment",
    ]


HEADS = {
    "the same every 20 rows": [
        line for k in range(0, N, 20) for line in (*DAQ, MTS, "Sec\tmm\tkN", *TABBED[k : k + 20])
    ],
    "another order": [
        *(*DAQ, MTS, "Sec\tmm\tkN", *TABBED[:HALF], *DAQ, "Running Time\tAxial Force\tAxial Displacement"),
        *("Sec\tkN\tmm", *rows(T[HALF:], F[HALF:], X[HALF:], separator="\t")),
    ],
    "other units": [
        *(*DAQ, MTS, "Sec\tmm\tkN", *TABBED[:HALF], *DAQ, MTS, "Sec\tin\tkip"),
        *rows(T[HALF:], X[HALF:] / INCH, F[HALF:] / KIP, separator="\t", digits=7),
    ],
    "order, units and a further channel at once": [
        *(HEAD, *BODY[:HALF], "Force (N),Temperature (degC),Time (ms),Displacement (cm)"),
        *rows(1e3 * F[HALF:], 20 + X[HALF:], 1e3 * T[HALF:], X[HALF:] / 10),
    ],
    "units in the first head alone": [HEAD, *BODY[:HALF], "Time,Displacement,Force", *BODY[HALF:]],
    "units alone come again": ["Time,Displacement,Force", "s,mm,kN", *BODY[:HALF], "s,mm,kN", *BODY[HALF:]],
    "a further channel that ends": [
        *("Time (s),Temperature (degC),Displacement (mm),Force (kN)", *rows(T[:HALF], X[:HALF], X[:HALF], F[:HALF])),
        *(HEAD, *BODY[HALF:]),
    ],
    "remarks between the rows": [HEAD, *BODY[:HALF], "Pause", "Operator: A. B.", *BODY[HALF:]],
    "units two lines above": ["Time,Displacement,Force", "s,mm,kN", "AI0,AI1,AI2", *BODY],
    "units three lines above, in inches and pounds": [
        *("Versuch 3", "Time,Stroke,Load", "sec,in,lbf", "AI0,AI1,AI2", "1.2.24 cal,none,none"),
        *rows(T, X / INCH, F / KIP * 1e3, digits=7),
    ],
    "TOA5": [
        *(
            '"TOA5","lab","CR6","1234"',
            '"TIMESTAMP","RECORD","Disp","Load"',
            '"TS","RN","mm","kN"',
            '"","","Smp","Smp"',
        ),
        *rows(stamped(lambda m: f'"{millis(m, "%Y-%m-%d %H:%M:%S")}"'), T, X, F),
    ],
    "catman": [
        *("Datei erzeugt von catmanAP", "Zeit  1 - Standardmessrate\tWeg_LVDT\tKraft_MTS"),
        *("T0= 03.05.2024 10:00:00\tMX840 CH 1\tMX840 CH 2", "s\tmm\tkN"),
        *(line.replace(".", ",") for line in TABBED),
    ],
    "names of several words between blanks": ["Running Time   Axial Displacement   Axial Force", "s   mm   kN"]
    + [line.replace("\t", "   ") for line in TABBED],
    "units written out": ["Time,Displacement,Force", "Seconds,Millimeters,KILONEWTONS", *BODY],
    "pairs with one time": [*PAIR_HEAD, "Channel name,Displacement,Channel name,Force", "Unit,mm,Unit,kN", *PAIRS],
    "pairs in inches and kip": [
        *(*PAIR_HEAD, "Channel name,Displacement,Channel name,Force", "Unit,in,Unit,kip"),
        *rows(T, X / INCH, T, F / KIP, digits=7),
    ],
    "LabVIEW without times": [*lvm(), *("\t" + line.partition("\t")[2] for line in TABBED)],
    "LabVIEW with times": [*lvm(), *TABBED],
    "LabVIEW, again for each segment": [
        *(*lvm(), *("\t" + line.partition("\t")[2] for line in TABBED[:HALF])),
        *(*lvm(x0=f"{T[HALF]}\t{T[HALF]}")[5:], *("\t" + line.partition("\t")[2] for line in TABBED[HALF:])),
    ],
    "LabVIEW, a time for each channel": [
        *(*LVM, "Y_Unit_Label\tmm\t\tkN", "X_Dimension\tTime\t\tTime", "***End_of_Header***"),
        *("X_Value\tDisplacement\tX_Value\tForce\tComment", *rows(T, X, T, F, separator="\t")),
    ],
}
MENTIONED = {
    "another order": "head-changes", "other units": "head-changes", "the same every 20 rows": "heads",
    "remarks between the rows": "notes", "pairs with one time": "times-agree",
    "LabVIEW without times": "time-from-step",
}  # fmt: skip


@pytest.mark.parametrize("kind", HEADS)
def test_heads(tmp_path, kind):
    found = same(read(file(tmp_path, HEADS[kind], "run.lvm" if "LabVIEW" in kind else "run.dat")))
    assert MENTIONED.get(kind, "time-stamps" if kind == "TOA5" else "") in {*found, ""}
    assert "unit-assumed" not in found or "pairs" in kind
    assert {"broken-rows", "text-cells", "empty-cells"}.isdisjoint(found)


def test_rows_of_lost_readings_are_no_remarks(tmp_path):
    """They count as text, of which a channel may hold 5 %."""
    for n_lost, unusable in ((30, False), (300, True)):
        lines = [HEAD, *BODY[:HALF], *["OVER,OVER,OVER"] * n_lost, *BODY[HALF:]]
        found = read(file(tmp_path, lines)).findings
        assert sum(f.count for f in found if f.code == "text-cells" and f.severity == "note") == 3 * n_lost
        assert any(f.severity == "unusable" for f in found) == unusable


REFUSED = {
    "volts": (
        ["Time,Displacement,Force", "s,V,V", "AI0,AI1,AI2", *BODY],
        "unit 'V' is a unit, but not of displac.*calib",
    ),
    "volts of pairs": (
        [*PAIR_HEAD, "Channel name,Displacement,Channel name,Force", "Unit,mm,Unit,V", *PAIRS],
        "unit 'V' is a unit, but not of force.*calibration",
    ),
    "a channel is lost": (
        [HEAD, *BODY[:HALF], "Time (s),Displacement (mm),Strain", *BODY[HALF:]],
        f"head in line {HALF + 2} lacks 'Force'",
    ),
    "another quantity": ([HEAD, *BODY[:HALF], "Time (s),Displacement (mm),Force (V)", *BODY[HALF:]], "in V, the first"),
    "a table of results below": (
        [HEAD, *BODY, "Cycle,Peak,Energy", "1,2.0,3.0", "2,2.0,3.0", "3,2.0,3.0"],
        "lacks 'Time'",
    ),
    "a unit only later": (
        ["Time,Displacement,Force", *BODY[:HALF], HEAD, *BODY[HALF:]],
        f"head in line {HALF + 2} states 'Time' in s, the first head no unit",
    ),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_heads_that_cannot_be_brought_together(tmp_path, kind):
    lines, words = REFUSED[kind]
    with pytest.raises(RecordingError, match=words):
        read(file(tmp_path, lines))


UNTIMED = ["\t" + line.partition("\t")[2] for line in TABBED]
APART = {
    "force at half the rate": (
        ["X_Value,Displacement,X_Value,Force", "s,mm,s,kN"]
        + [f"{T[k]},{X[k]}," + (f"{T[2 * k]},{F[2 * k]}" if k < HALF else ",") for k in range(N)],
        slice(0, None, 2),
    ),
    "a card that starts two samples later": (
        [*lvm(x0="0.0\t0.1"), *rows([""] * (N - 2), X[: N - 2], F[2:], separator="\t")],
        slice(2, N - 2),
    ),
    "a card that starts later by the clock": (
        [*lvm(times="10:00:00.5\t10:00:00.6"), *rows([""] * (N - 2), X[: N - 2], F[2:], separator="\t")],
        slice(2, N - 2),
    ),
}


@pytest.mark.parametrize("kind", APART)
def test_channels_with_times_of_their_own_are_laid_on_one_axis(tmp_path, kind):
    lines, at = APART[kind]
    recording = read(file(tmp_path, lines, "run.lvm" if "card" in kind else "run.csv"))
    assert "own-times" in same(recording, at)
    assert recording.usable


def test_time_stamps_that_differ_from_channel_to_channel_are_refused(tmp_path):
    later = CLOCKS["ISO"][2:]
    head = "Timestamp,Displacement (mm),Timestamp,Force (kN)"
    with pytest.raises(RecordingError, match=r"time stamps of their own .*Timestamp for Displacement.*for Force"):
        read(file(tmp_path, [head, *rows(CLOCKS["ISO"][:-2], X[:-2], later, F[2:])]))
    same(read(file(tmp_path, [head, *rows(CLOCKS["ISO"], X, CLOCKS["ISO"], F)])))


def test_a_comment_behind_the_first_sample_does_not_cost_it(tmp_path):
    same(read(file(tmp_path, [*lvm(), TABBED[0] + "\tbegin of test", *TABBED[1:]], "run.lvm")))


# --- time --------------------------------------------------------------------------------------------------------
def clock(second, form="{h:02d}:{m:02d}:{s:06.3f}"):
    second = round(float(second), 3)
    return form.format(h=int(second // 3600), m=int(second // 60 % 60), s=second % 60)


CLOCKS = {
    "ISO": stamped(lambda m: millis(m, "%Y-%m-%d %H:%M:%S")),
    "ISO with T and zone": stamped(lambda m: millis(m, "%Y-%m-%dT%H:%M:%S") + "+02:00"),
    "as Python prints it, without zeros": stamped(str),
    "German": stamped(lambda m: millis(m, "%d.%m.%Y %H:%M:%S")),
    "US, over midnight": stamped(lambda m: millis(m, "%m/%d/%Y %I:%M:%S") + m.strftime(" %p")),
    "month in letters": stamped(lambda m: millis(m, "%d-%b-%Y %H:%M:%S")),
    "clock over midnight": stamped(lambda m: millis(m, "%H:%M:%S")),
    "12 hours without half": stamped(lambda m: millis(m + dt.timedelta(hours=1), "%I:%M:%S")),
    "milliseconds behind a colon": stamped(lambda m: millis(m, "%H:%M:%S").replace(".", ":")),
    "mm:ss": [clock(t, "{m:02d}:{s:06.3f}") for t in T],
    "h:mm:ss": [clock(t, "{h:d}:{m:02d}:{s:06.3f}") for t in T],
    "mm:ss over the hour": [clock(t + 3550, "{m:02d}:{s:06.3f}") for t in T],
    "as pandas prints durations": [f"0 days {clock(t)}" for t in T],
}


WRAPS = {"clock over midnight", "12 hours without half", "milliseconds behind a colon", "mm:ss over the hour"}


@pytest.mark.parametrize("kind", CLOCKS)
def test_time_stamps(tmp_path, kind):
    found = same(read(file(tmp_path, ["Timestamp,Displacement (mm),Force (kN)", *rows(CLOCKS[kind], X, F)])))
    assert "time-stamps" in found
    assert ("time-wraps" in found) == (kind in WRAPS)
    assert ("time-minutes" in found) == kind.startswith("mm:ss")
    assert "unit-assumed" not in found


@pytest.mark.parametrize("separator", [",", ";", "  "])
def test_date_and_time_in_columns_of_their_own(tmp_path, separator):
    body = rows(stamped(lambda m: m.strftime("%d/%m/%Y")), CLOCKS["clock over midnight"], X, F, separator=separator)
    head = separator.join(("Date", "Time", "Displacement_mm", "Force_kN"))
    assert "time-wraps" not in same(read(file(tmp_path, [head, *body])))


def test_seconds_are_read_where_time_stamps_stand_beside_them(tmp_path):
    body = rows(CLOCKS["ISO"], T, X, F)
    found = same(read(file(tmp_path, ["Timestamp,Time (s),Displacement (mm),Force (kN)", *body])))
    assert "Timestamp" in found["times-agree"].message


def test_two_numbers_of_a_clock_are_not_guessed(tmp_path):
    """Each option of the refusal gives what it says."""
    path = file(tmp_path, [HEAD.replace(" (s)", ""), *rows([f"{k // 60:02d}:{k % 60:02d}" for k in range(N)], X, F)])
    with pytest.raises(RecordingError, match=r"hours and minutes or minutes and seconds.*time=h.*time=min"):
        read(path)
    for option, step in (("time=min", 1.0), ("time=h", 60.0)):
        np.testing.assert_allclose(np.diff(read(path, units=option).time_s), step)


@pytest.mark.parametrize("kind", ["datetime", "time", "timedelta"])
def test_dates_of_workbooks(tmp_path, kind):
    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    sheet.append(["Time", "Displacement (mm)", "Force (kN)"])
    n = 600
    for second, x, f in zip(T[:n].tolist(), X.tolist(), F.tolist(), strict=False):
        past = dt.timedelta(seconds=round(second, 3))
        moment = {"datetime": START + past, "time": (START.replace(hour=9) + past).time(), "timedelta": past}[kind]
        sheet.append([moment, x, f])
    book.save(tmp_path / "run.xlsx")
    assert "time-stamps" in same(read(tmp_path / "run.xlsx"), slice(n))


@pytest.mark.parametrize("headed", [True, False])
@pytest.mark.parametrize("doubled", [True, False])
def test_time_that_begins_again_with_each_cycle(tmp_path, headed, doubled):
    """One run; the first sample of a cycle may be the last of the one before."""
    edges = [0, 400, 777, 1200, 1630, 2100, 2500, 2900, N]
    lines = [] if headed else [HEAD]
    for a, b in pairwise(edges):
        lines += ["Cycle", HEAD] if headed else []
        begin = a - 1 if doubled and a else a
        lines += rows(T[begin:b] - T[begin], X[begin:b], F[begin:b])
    assert same(read(file(tmp_path, lines)))["time-cycles"].count == 7


def test_runs_with_heads_of_their_own_are_runs(tmp_path):
    lines = [line for k in (1, 2) for line in (f"Run {k}", HEAD, *BODY)]
    recording = read(file(tmp_path, lines))
    assert list(recording.run_starts) == [N]


def test_a_run_column_is_believed_where_the_device_moves_on(tmp_path):
    body = rows(np.r_[T[:HALF], T[: N - HALF]], X, F, np.repeat(["1", "2"], HALF).tolist())
    assert list(read(file(tmp_path, [HEAD + ",Run", *body])).run_starts) == [HALF]


# --- numbers and units -------------------------------------------------------------------------------------------
WAYS = {
    "quoted decimal commas": ['"Zeit (s)","Weg (mm)","Kraft (kN)"']
    + [",".join(f'"{cell}"'.replace(".", ",") for cell in line.split(",")) for line in BODY],
    "quoted, between semicolons": ['"Zeit";"Weg";"Kraft"', '"s";"mm";"kN"']
    + [";".join(f'"{cell}"'.replace(".", ",") for cell in line.split(",")) for line in BODY],
    "units in a quoted row": ['"Zeit","Weg","Kraft"', '"(s)","(mm)","(kN)"']
    + [",".join(f'"{cell}"'.replace(".", ",") for cell in line.split(",")) for line in BODY],
    **{
        f"minus U+{ord(sign):04X}": [HEAD, *(line.replace("-", sign) for line in BODY)]
        for sign in "\u2212\u2013\u2010\uff0d"
    },
    "minus in exponents": [HEAD, *rows(*([f"{v:.8e}".replace("-", "\u2212") for v in c] for c in (T, X, F)))],
    "marks without width": ["\u200b" + HEAD, *("\u200b" + line for line in BODY)],
    "thin spaces for blanks": ["Time_s Displacement_mm Force_kN", *(line.replace(",", "\u2009") for line in BODY)],
}


@pytest.mark.parametrize("kind", WAYS)
def test_signs_of_typesetters_and_quotes(tmp_path, kind):
    assert "text-cells" not in same(read(file(tmp_path, WAYS[kind])))


@pytest.mark.parametrize(
    ("header", "kn"),
    [
        *(
            ("Load (t)", TONNE),
            ("Load [tonnes]", TONNE),
            ("Force_kg", TONNE / 1e3),
            ("Load t", TONNE),
            ("Force (tf)", TONNE),
        ),
        *(("Load (kgf)", TONNE / 1e3), ("Load (klbs)", KIP), ("Force (short ton)", 2 * KIP), ("Load (tonf)", TONNE)),
    ],
)
def test_weights(tmp_path, header, kn):
    found = same(read(file(tmp_path, [f"Time (s),Displacement (mm),{header}", *rows(T, X, F / kn, digits=7)])))
    assert ("unit-weight" in found) == (not any(word in header for word in ("(tf)", "kgf", "klbs")))


def test_a_ton_is_not_guessed(tmp_path):
    """Each option of the refusal gives what it says."""
    path = file(tmp_path, ["Time (s),Displacement (mm),Load (ton)", *rows(T, X, F / TONNE, digits=7)])
    with pytest.raises(
        RecordingError, match=r"metric ton .*short one.*long one.*force=tf.*force=short ton.*force=long"
    ):
        read(path)
    for option, kn in (("force=tf", TONNE), ("force=short ton", 2 * KIP), ("force=long ton", 2.24 * KIP)):
        np.testing.assert_allclose(read(path, units=option).force_kN, F * kn / TONNE, atol=2e-3)


@pytest.mark.parametrize("content", [" ".join("a" * 32767), ",".join("a" * 32767), '"1",' * 16000])
def test_many_cells_in_a_line_cost_no_time(tmp_path, content):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(f"{content}\n".encode() * 400, mtime=0))
    begin = time.process_time()
    with pytest.raises(RecordingError, match=r"no rows of two or more numbers|16001 columns; allowed are 512"):
        read(path)
    assert time.process_time() - begin < 10.0
