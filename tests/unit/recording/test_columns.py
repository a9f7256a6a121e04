import numpy as np
import pandas as pd
import pytest

from shj_bayes.errors import RecordingError
from shj_bayes.recording.columns import choose, parse_columns
from shj_bayes.recording.reader import read, read_frame
from shj_bayes.recording.recording import Column
from shj_bayes.recording.rows import split_header
from shj_bayes.recording.tables import Table, evaluate

N = 6


def table(*headers, scalars=None, has_header=True):
    columns = []
    for i, header in enumerate(headers):
        name, unit = split_header(header)
        columns.append(Column(name if has_header else f"#{i + 1}", np.arange(N) * (i + 1.0), unit, header))
    return Table("run.csv", tuple(columns), has_header, scalars or {})


def test_header_names_and_units_are_found():
    found = choose(table("Time (ms)", "Displacement (in)", "Force (kip)", "Band force 1 (lb)"))
    np.testing.assert_allclose(found.time_s, np.arange(N) * 1e-3)
    np.testing.assert_allclose(found.displacement_mm, np.arange(N) * 2 * 25.4)
    np.testing.assert_allclose(found.force_kN, np.arange(N) * 3 * 4.4482216152605)
    assert found.units == {"time": "ms", "displacement": "in", "force": "kip"}
    assert [f.code for f in found.findings] == ["columns-ignored"]


def test_a_unit_that_nobody_gave_is_assumed_aloud():
    found = choose(table("time", "displacement", "force"))
    assert [(f.code, f.severity) for f in found.findings] == [("unit-assumed", "assumed")] * 3
    assert not choose(table("time", "displacement", "force"), units="s,mm,kN").findings


def test_an_option_that_contradicts_the_header_wins_with_a_warning():
    found = choose(table("time_s", "displacement_mm", "force_kN"), units="force=N")
    np.testing.assert_allclose(found.force_kN, np.arange(N) * 3e-3)
    assert [(f.code, f.severity) for f in found.findings] == [("unit-overruled", "warning")]
    assert not choose(table("time_s", "disp_in", "force_kN"), units='displacement="').findings


def test_a_header_that_contains_the_word_is_taken_and_said():
    found = choose(table("Test time (s)", "LVDT 1 (mm)", "Actuator load (kN)"))
    assert [f.code for f in found.findings] == ["column-by-word"] * 2


@pytest.mark.parametrize(
    ("headers", "words"),
    [
        (
            ("Time (s)", "LVDT 1 (mm)", "LVDT 2 (mm)", "Force (kN)"),
            ["2 columns", "LVDT 1", "LVDT 2", "--columns displ"],
        ),
        (("time", "Force (kN)", "Load (kN)", "disp"), ["2 columns could be force"]),
        (("e_true", "Sigma_true"), ["no time column", "e_true", "--columns", "--rate"]),
        (("time", "force"), ["no displacement column"]),
        (("time", "displacement (V)", "force"), ["'V'", "displacement", "calibration"]),
        (("time", "displacement", "force (MPa)"), ["'MPa'", "not of force"]),
    ],
)
def test_missing_and_ambiguous_columns(headers, words):
    with pytest.raises(RecordingError) as caught:
        choose(table(*headers))
    for word in words:
        assert word in str(caught.value)


def test_a_missing_column_is_suggested_by_its_unit():
    with pytest.raises(RecordingError, match=r"perhaps --columns displacement=2,force=3$"):
        choose(table("Zeit (ms)", "Ankerplatte (mm)", "Dose (kN)"))
    with pytest.raises(RecordingError) as caught:
        choose(table("time (s)", "left (mm)", "right (mm)", "load (kN)"))
    assert "perhaps" not in str(caught.value)


def test_a_misspelt_column_is_answered_with_the_nearest():
    with pytest.raises(RecordingError, match="did you mean 'Weg Traverse'"):
        choose(table("Zeit (ms)", "Weg Traverse (mm)", "Kraft (kN)"), "displacement=Weg Travers")


def test_a_unit_of_another_channel_asks_for_the_true_one():
    with pytest.raises(RecordingError, match="say what the numbers are with --units displacement=mm"):
        choose(table("time (s)", "force (kN)", "displacement (mm)"), "displacement=2,force=3")


def test_numbers_formulas_and_steps():
    plain = table(*"abcdefg", has_header=False)
    found = choose(plain, "time=1,displacement=5,force=#7 - 49.087*#6", "ms,mm,N")
    np.testing.assert_allclose(found.force_kN, np.arange(N) * (7 - 49.087 * 6) * 1e-3)
    assert found.columns["force"] == "#7 - 49.087*#6"
    mat = table("vir", "qm", scalars={"gtau": 35.0, "Ts": 10.0})
    found = choose(mat, "time=Ts,displacement=qm,force=gtau*vir", "ms,m,N")
    np.testing.assert_allclose(found.time_s, np.arange(N) * 0.01)
    np.testing.assert_allclose(found.force_kN, np.arange(N) * 35e-3)
    assert [f.code for f in found.findings] == ["time-from-step"]


def test_names_with_blanks_commas_and_brackets():
    columns = table("Time, elapsed (s)", "Displacement (in)", "Axial force, total (kip)")
    found = choose(columns, "time=Time, elapsed (s),displacement=displacement,force=Axial force, total")
    np.testing.assert_allclose(found.force_kN, np.arange(N) * 3 * 4.4482216152605)
    np.testing.assert_array_equal(evaluate("2*'Displacement (in)' + 1/4", columns).values, np.arange(N) * 4 + 0.25)
    np.testing.assert_array_equal(evaluate("- #1 + -#2", columns).values, np.arange(N) * -3.0)
    np.testing.assert_array_equal(evaluate("2*(#2 - #1)/4", columns).values, np.arange(N) * 0.5)


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("#1*#2", "multiplies or divides two columns"),
        ("2/#1", "multiplies or divides two columns"),
        ("#1/0", "divides by zero"),
        ("#9", "no column 9; allowed are 1 to 3"),
        ("#1 +", "cannot read"),
        ("#1 * * 2", "cannot read"),
        ("#1 2", "cannot read"),
        ("nothing", "no column named 'nothing'"),
        ("__import__('os').system('x')", "cannot read|no column named"),
        ("a" * 500, "no column|500 characters"),
        ("#1 ** 2", "cannot read"),
        ("#1 # 2", "cannot read"),
        ("(" * 300 + "#1", "cannot read"),
    ],
)
def test_formulas_that_are_refused(formula, words):
    with pytest.raises(RecordingError, match=words):
        evaluate(formula, table("time", "displacement", "force"))


def test_a_rate_against_the_time_of_the_file_is_refused():
    headers = ("time (ms)", "displacement (mm)", "force (kN)")  # 1 ms from row to row
    assert choose(table(*headers), rate_Hz=1000.0).time_s[1] == pytest.approx(1e-3)
    with pytest.raises(RecordingError, match=r"column 'time \(ms\)' says 1000 Hz, --rate 100 Hz; leave --rate out"):
        choose(table(*headers), rate_Hz=100.0)
    with pytest.raises(RecordingError, match="wf_increment says 4 Hz, --rate 100 Hz"):
        choose(table("displacement (mm)", "force (kN)", scalars={"wf_increment": 0.25}), rate_Hz=100.0)
    few_digits = table(*headers)
    few_digits.columns[0].values[:] = [0, 0, 2, 2, 4, 5]  # the mean says what the steps do not
    assert choose(few_digits, rate_Hz=1000.0).time_s[1] == pytest.approx(1e-3)


def test_rate_makes_the_time_and_says_so():
    found = choose(table("a", "b", has_header=False), "displacement=1,force=2", "mm,kN", 4.0)
    np.testing.assert_array_equal(found.time_s, np.arange(N) / 4)
    assert [(f.code, f.severity) for f in found.findings] == [("rate-given", "assumed")]
    with pytest.raises(RecordingError, match="both --rate 4 and --columns time=1"):
        choose(table("a", "b"), "time=1,displacement=1,force=2", None, 4.0)
    with pytest.raises(RecordingError, match="allowed is 1e-6 to 1e7 Hz"):
        choose(table("a", "b"), "displacement=1,force=2", None, -1.0)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("forse=3", "'forse' is no channel of the law; did you mean 'force'"),
        (f"{'x' * 41}=3", "cannot read"),
        (",".join(f"channel{i}=1" for i in range(16)), "names 16 channels; allowed are 3 and 12 more"),
        ("time", "cannot read 'time'"),
        ("time=1,time=2", "time twice"),
        ("force=", "cannot read"),
    ],
)
def test_bad_columns_option(option, words):
    with pytest.raises(RecordingError, match=words):
        parse_columns(option)


def test_columns_of_different_lengths_and_single_numbers():
    short = Column("x", np.arange(3.0), "mm", "x")
    uneven = Table("a.mat", (*table("t (s)", "f (kN)").columns, short), scalars={"k": 2.0})
    with pytest.raises(RecordingError, match="different lengths"):
        choose(uneven)
    with pytest.raises(RecordingError, match="single number"):
        choose(uneven, "force=k")
    with pytest.raises(RecordingError, match="adds columns of"):
        evaluate("t + x", uneven)


def test_further_channels_come_along_through_repairs_and_splits(tmp_path):
    """Any number, by names of one's own; a tension in N is held in kN, anything else in the unit of its header."""
    t = np.arange(400) / 20.0
    x, f = 30 * np.sin(t), 40 * np.sign(np.cos(t))
    rows = np.column_stack([t, x, f, 1e5 - 100 * t, 20 + t])
    rows[7, 1] = np.nan  # filled in
    rows = np.delete(rows, 9, axis=0)
    path = tmp_path / "run.csv"
    header = "time (s),displacement (mm),force (kN),bolt (N),plate (degC)"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9g")
    recording = read(path, columns="tension=bolt,temperature=plate")
    assert [(e.name, e.unit) for e in recording.extras] == [("tension", "kN"), ("temperature", "degC")]
    np.testing.assert_allclose(recording.extras[0].values, 100 - 0.1 * recording.time_s, atol=1e-9)
    np.testing.assert_allclose(recording.extras[1].values, 20 + recording.time_s, atol=1e-9)
    assert "columns-ignored" not in {f.code for f in recording.findings}
    with pytest.raises(RecordingError, match="no column named 'valve'"):
        read(path, columns="temperature=valve")


def test_a_data_frame_is_read_like_a_file():
    t = np.arange(400) / 20.0
    frame = pd.DataFrame({"time (ms)": 1e3 * t, "stroke [in]": np.sin(t), "load (N)": 9e3 * np.cos(t), "note": "a"})
    recording = read_frame(frame, "made here", columns="tension=load (N)")
    np.testing.assert_allclose(recording.time_s, t)
    np.testing.assert_allclose(np.ptp(recording.displacement_mm), 2 * 25.4, rtol=1e-3)
    np.testing.assert_allclose(np.abs(recording.force_kN).max(), 9.0, rtol=1e-6)
    assert (recording.source.format, recording.extras[0].name) == ("dataframe", "tension")
    with pytest.raises(RecordingError, match="no column holds numbers"):
        read_frame(pd.DataFrame({"note": ["a"]}))
