"""Never a silent wrong answer: damage that the reader says it repairs, repaired, is compared with the original."""

import gzip

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shj_bayes.errors import RecordingError
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block
from shj_bayes.recording.reader import read

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
ORIGINAL = simulate_device(Truth(sigma=0.5, phi=0.3), seed=4, rate_Hz=8.0, blocks=BLOCKS)[0]
CHANNELS = np.column_stack([ORIGINAL.time_s, ORIGINAL.displacement_mm, ORIGINAL.force_kN])
ROWS = np.array([[float(f"{v:.7g}") for v in row] for row in CHANNELS.tolist()])
N = len(ROWS)
# The same examples everywhere: a test must not fail by the luck of a draw; `make fuzz` looks for new ones.
QUICK = settings(
    max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
HEADS = (
    {"s": 1.0, "ms": 1e3, "min": 1 / 60},
    {"mm": 1.0, "in": 1 / 25.4, "m": 1e-3},
    {"kN": 1.0, "N": 1e3, "kip": 1 / 4.4482216152605},
)
WAYS = (
    *((";", ".", ","), ("\t", ".", ","), (";", ",", "."), (";", ".", "'")),
    *((";", ",", "\u00a0"), (";", ",", " "), ("\t", ".", "\u202f")),
)


def grouped(value: float, sign: str, decimal: str, digits: int = 5) -> str:
    """A number with groups of thousands, as spreadsheets print it."""
    return f"{value:,.{digits}f}".replace(",", "\0").replace(".", decimal).replace("\0", sign)


def written(tmp_path, rows, *, separator=",", decimal=".", head="time_s,displacement_mm,force_kN", number=repr, **how):
    """A text file of rows; `how` has encoding, ending, before, after, packed."""
    head = head.replace(",", separator)
    shown = [[cell if isinstance(cell, str) else number(cell).replace(".", decimal) for cell in row] for row in rows]
    body = [separator.join(row) for row in shown]
    ending = how.get("ending", "\n")
    text = ending.join([*how.get("before", ()), head, *body, *how.get("after", ())]) + ending
    raw = text.encode(how.get("encoding", "utf-8"))
    path = tmp_path / ("run.csv.gz" if how.get("packed") else "run.csv")
    path.write_bytes(gzip.compress(raw) if how.get("packed") else raw)
    return path


def compared(recording, rows=ROWS, rtol=1e-9):
    """Every sample that is evidence is one of the original, at its own time."""
    at = np.searchsorted(0.5 * (rows[1:, 0] + rows[:-1, 0]), recording.time_s)  # the nearest
    np.testing.assert_allclose(rows[at, 0], recording.time_s, rtol=rtol, atol=1e-9)
    used = np.asarray(recording.used)
    np.testing.assert_allclose(recording.displacement_mm[used], rows[at[used], 1], rtol=rtol, atol=1e-9)
    np.testing.assert_allclose(recording.force_kN[used], rows[at[used], 2], rtol=rtol, atol=1e-9)


def codes(recording):
    return {finding.code for finding in recording.findings}


@QUICK
@given(
    separator=st.sampled_from([";", "\t", ",", "  "]),
    decimal=st.sampled_from([".", ","]),
    encoding=st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252", "utf-32"]),
    ending=st.sampled_from(["\n", "\r\n", "\r"]),
    units=st.tuples(*(st.sampled_from(sorted(choice)) for choice in HEADS)),
    units_row=st.booleans(),
    before=st.lists(st.sampled_from(["Prüfung 7", "Operator: A. B.", "# remark", "Date;21.11.2026", ""]), max_size=4),
    after=st.lists(st.sampled_from(["End of test", "checked by C. D.", "max;min", ""]), max_size=3),
    packed=st.booleans(),
)
def test_every_way_of_writing_gives_the_same_numbers(
    tmp_path, separator, decimal, encoding, ending, units, units_row, before, after, packed
):
    """Separators, decimal signs, encodings, line ends, units in the header or in a row below it, remarks."""
    if separator == "," and decimal == ",":
        return  # nobody can read that
    rows = ROWS * [choice[unit] for choice, unit in zip(HEADS, units, strict=True)]
    names = ("Time", "Displacement", "Force")
    head = ",".join(names if units_row else [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)])
    body = rows.tolist()
    if units_row:
        body = [list(units), *body]
    if separator == "  " and not units_row:
        head = ",".join(f"{name}_{unit}" for name, unit in zip(names, units, strict=True))
    path = written(
        tmp_path, body, separator=separator, decimal=decimal, head=head, encoding=encoding, ending=ending,
        before=before, after=after, packed=packed,
    )  # fmt: skip
    recording = read(path)
    assert recording.n_samples == N
    compared(recording)
    assert recording.source.units == dict(zip(("time", "displacement", "force"), units, strict=True))
    assert ("decimal-comma" in codes(recording)) == (decimal == ",")


@QUICK
@given(way=st.sampled_from(WAYS))
def test_groups_of_thousands(tmp_path, way):
    """1,234.5 and 1.234,5 and 1'234.5 in newtons."""
    separator, decimal, sign = way
    rows = [[a, b, grouped(1e3 * c, sign, decimal)] for a, b, c in ROWS.tolist()]
    head = "time_s,displacement_mm,force_N"
    recording = read(written(tmp_path, rows, separator=separator, decimal=decimal, head=head))
    compared(recording, rtol=1e-7)
    assert np.asarray(recording.used).all()
    assert "thousands" in codes(recording)


@pytest.mark.parametrize(("decimal", "sign"), [(".", "."), (",", ",")])
def test_a_thousand_or_about_one_is_refused(tmp_path, decimal, sign):
    """998 and 1,002 newtons in whole numbers: read as 1.002 it would be a silent wrong answer."""
    rows = [[a, b, grouped(round(25 * c), sign, decimal, 0)] for a, b, c in ROWS.tolist()]
    path = written(tmp_path, rows, separator=";", decimal=decimal, head="time_s,displacement_mm,force_N")
    with pytest.raises(RecordingError, match=r"column force holds both .* may be a thousand or about one"):
        read(path)


@QUICK
@given(data=st.data())
def test_rows_doubled_moved_and_lost(tmp_path, data):
    """Rows repeated, moved and cut out: what is left is the original at its own times."""
    rows = ROWS.tolist()
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, N - 20))
        kind = data.draw(st.sampled_from(["double", "swap", "lose"]))
        if kind == "double":
            rows.insert(at, rows[at])
        elif kind == "swap":
            rows[at], rows[at + 1] = rows[at + 1], rows[at]
        else:
            del rows[at]
    recording = read(written(tmp_path, rows))
    compared(recording)
    assert recording.n_samples >= N - 6


@QUICK
@given(data=st.data())
def test_empty_and_broken_cells(tmp_path, data):
    """Cells that are empty or hold words, or a row with too many: bridged or left out, never evidence."""
    rows = [list(row) for row in ROWS.tolist()]
    wrong = ["", "nan", "OVERLOAD", "#N/A", "1e400", "=A1", "--", "0x1F", "1_000", "12:00"]
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, N - 1))
        rows[at][data.draw(st.integers(1, 2))] = data.draw(st.sampled_from(wrong))
    recording = read(written(tmp_path, rows))
    compared(recording)
    assert np.count_nonzero(np.asarray(recording.used)) >= N - 20


@QUICK
@given(exponent=st.sampled_from(["e", "E", "D", "d"]))
def test_fortran_exponents(tmp_path, exponent):
    number = lambda v: f"{v:.9e}".replace("e", exponent)  # noqa: E731
    recording = read(written(tmp_path, ROWS.tolist(), separator="\t", number=number))
    compared(recording)
    assert np.asarray(recording.used).all()


@QUICK
@given(data=st.data())
def test_dropouts_of_the_displacement(tmp_path, data):
    """Single samples far off: bridged, and not used as evidence."""
    rows = ROWS.copy()
    places = data.draw(st.lists(st.integers(5, N - 6), min_size=1, max_size=2, unique=True))
    if len(places) == 2 and abs(places[0] - places[1]) < 5:
        return
    for at in places:
        rows[at, 1] += data.draw(st.sampled_from([-200.0, 150.0, 500.0]))
    recording = read(written(tmp_path, rows.tolist()))
    compared(recording)
    assert not np.asarray(recording.used)[places].any()
    assert "spikes" in codes(recording)


@pytest.mark.parametrize("sign", [(1, -1), (-1, 1), (-1, -1)])
def test_signs(tmp_path, sign):
    """A force of the wrong sign is turned round, which exchanges push and pull; both turned is another device."""
    recording = read(written(tmp_path, (ROWS * [1, *sign]).tolist()))
    expected = ROWS * [1, sign[0], sign[0]]
    compared(recording, expected)
    assert ("force-sign" in codes(recording)) == (sign[0] != sign[1])


@pytest.mark.parametrize("turn", [1.0, -1.0])
@pytest.mark.parametrize("seed", range(5))
def test_swapped_columns_are_refused_whatever_the_sign(tmp_path, turn, seed):
    one = simulate_device(Truth(beta=(2, 10, 50, 100, 10)[seed]), seed=seed, rate_Hz=10.0)[0]
    rows = np.column_stack([one.time_s, turn * one.force_kN, one.displacement_mm])
    recording = read(written(tmp_path, rows.tolist()))
    assert "swapped-columns" in codes(recording)
    assert not recording.usable
    right = read(written(tmp_path, rows.tolist()), columns="displacement=force_kN,force=displacement_mm", units="mm,kN")
    assert right.usable
    np.testing.assert_array_equal(right.displacement_mm, one.displacement_mm)


@pytest.mark.parametrize(
    ("scale", "role"), [((1, 1e-3, 1), "displacement"), ((1, 1, 1e-3), "force"), ((1e3, 1, 1), "time")]
)
def test_an_unlikely_size_in_an_assumed_unit_is_refused_until_the_unit_is_stated(tmp_path, scale, role):
    """Metres read as mm, MN as kN, milliseconds as seconds: refused only where nobody said the unit."""
    path = written(tmp_path, (ROWS * scale).tolist(), head="time,displacement,force")
    recording = read(path)
    assert not recording.usable
    finding = next(f for f in recording.findings if f.code == "unit-unlikely")
    assert f"unit of the {role}" in finding.message
    assert "--units" in finding.message
    stated = {"displacement": "m", "force": "MN", "time": "ms"}[role]
    right = read(path, units=f"{role}={stated}")
    assert right.usable
    compared(right, rtol=1e-6)
    assert read(path, units="s,mm,kN").usable  # said to be so: then it is so


def test_milliseconds_stated_as_seconds_are_mentioned(tmp_path):
    """A stated unit is believed, but hours of a device that hardly moves are worth a word."""
    long = read(written(tmp_path, (ROWS * (1e3, 1, 1)).tolist()), units="time=s")
    assert long.time_s[-1] > 36_000
    assert [f.severity for f in long.findings if f.code == "time-long"] == ["warning"]
    assert "time-long" not in {f.code for f in read(written(tmp_path, ROWS.tolist())).findings}
