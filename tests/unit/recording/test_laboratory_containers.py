"""Files that hold more than one table: what is read is the plain one, or they are refused with the cause."""

import json

import h5py
import numpy as np
import openpyxl
import pandas as pd
import pytest
import scipy.io
from click.testing import CliRunner
from nptdms import ChannelObject, TdmsWriter
from one_device import N_ROWS, RATE_HZ, plain

from shj_bayes.app.device import read_device
from shj_bayes.app.manifest import read_manifest
from shj_bayes.cli import main
from shj_bayes.errors import RecordingError
from shj_bayes.options import FitOptions
from shj_bayes.recording.formats import binary
from shj_bayes.recording.formats.binary import flat, from_hdf5
from shj_bayes.recording.reader import read
from shj_bayes.recording.runs import check_recording, split

START = np.datetime64("2024-03-05T10:00:00", "us")
STEP = 1.0 / RATE_HZ
ALL = slice(None)


def frame(rows=ALL):
    one = plain()
    columns = {"time_s": one.time_s, "displacement_mm": one.displacement_mm, "force_kN": one.force_kN}
    return pd.DataFrame({name: values[rows] for name, values in columns.items()})


def same(recording, rows=ALL, shift_s=0.0):
    one = plain()
    np.testing.assert_allclose(recording.time_s, one.time_s[rows] - shift_s, atol=1e-6)
    np.testing.assert_allclose(recording.displacement_mm, one.displacement_mm[rows], atol=1e-6)
    np.testing.assert_array_equal(recording.force_kN, one.force_kN[rows])
    assert recording.usable
    assert np.asarray(recording.used).all()


def said(recording, code):
    return [finding.message for finding in recording.findings if finding.code == code]


def wave(name, unit, values, step=STEP, late=0.0, group="DAQ", **more):
    begin = START + np.timedelta64(round(1e6 * late), "us")
    stated = {"wf_increment": step, "wf_start_offset": 0.0, "wf_start_time": begin, "unit_string": unit}
    return ChannelObject(group, name, values, properties=stated | more)


def tdms(tmp_path, *channels):
    path = tmp_path / "run.tdms"
    with TdmsWriter(path) as writer:
        writer.write_segment(list(channels))
    return path


# --- times of their own ---


@pytest.mark.parametrize("late", [1, 10])
@pytest.mark.parametrize("stated", ["start", "offset"])
def test_a_card_that_starts_later_is_laid_on_the_same_axis(tmp_path, late, stated):
    one = plain()
    start = {"late": late * STEP} if stated == "start" else {"wf_start_offset": late * STEP}
    force = wave("Force", "kN", one.force_kN[late:], **start)
    recording = read(tdms(tmp_path, wave("Displacement", "mm", one.displacement_mm), force))
    same(recording, slice(late, None))
    (words,) = said(recording, "own-times")
    assert "displacement has 20 Hz from 0 to 169.95 s" in words
    assert f"force 20 Hz from {late * STEP:g} to 169.95 s" in words


@pytest.mark.parametrize(("x_every", "f_every"), [(4, 1), (1, 4), (2, 1), (6, 4)])
def test_channels_of_two_rates_meet_where_both_were_read(tmp_path, x_every, f_every):
    """Every force is a reading, and none counts twice."""
    one = plain()
    channels = (
        wave("Displacement", "mm", one.displacement_mm[::x_every], x_every * STEP),
        wave("Force", "kN", one.force_kN[::f_every], f_every * STEP),
    )
    recording = read(tdms(tmp_path, *channels))
    slower = max(x_every, f_every)
    assert recording.n_samples == pytest.approx(N_ROWS / slower, abs=1)
    if slower % min(x_every, f_every) == 0:
        same(recording, slice(None, None, slower))
    at = np.round(recording.time_s * RATE_HZ).astype(int)
    np.testing.assert_array_equal(recording.force_kN, one.force_kN[at])
    assert np.max(np.abs(recording.displacement_mm - one.displacement_mm[at])) < 0.3
    with pytest.raises(RecordingError, match=r"leave --rate and time=\.\.\. out"):
        read(tmp_path / "run.tdms", rate_Hz=20.0)


def test_cards_half_a_step_apart_keep_their_forces(tmp_path):
    one = plain()
    between = 0.5 * (one.displacement_mm[1:] + one.displacement_mm[:-1])
    channels = wave("Displacement", "mm", between, late=0.5 * STEP), wave("Force", "kN", one.force_kN)
    recording = read(tdms(tmp_path, *channels))
    np.testing.assert_array_equal(recording.force_kN, one.force_kN[1:-1])
    np.testing.assert_allclose(recording.time_s, one.time_s[1:-1], atol=1e-6)
    assert np.max(np.abs(recording.displacement_mm - one.displacement_mm[1:-1])) < 0.3


def test_the_same_times_are_read_as_one_interval(tmp_path):
    one = plain()
    path = tdms(tmp_path, wave("Displacement", "mm", one.displacement_mm), wave("Force", "kN", one.force_kN))
    recording = read(path)
    same(recording)
    assert said(recording, "time-from-step")
    assert not said(recording, "own-times")
    same(read(path, rate_Hz=20.0))


def test_a_slow_further_channel_changes_nothing(tmp_path):
    one = plain()
    slow = wave("Plate", "degC", 20.0 + 0.1 * one.time_s[::20], 20 * STEP)
    channels = wave("Displacement", "mm", one.displacement_mm), wave("Force", "kN", one.force_kN), slow
    recording = read(tdms(tmp_path, *channels), columns="temperature=Plate")
    same(recording)
    known = recording.time_s < 169.0
    np.testing.assert_allclose(recording.extras[0].values[known], 20.0 + 0.1 * recording.time_s[known])


def test_channels_of_different_days_are_refused_with_both_times(tmp_path):
    one = plain()
    channels = wave("Displacement", "mm", one.displacement_mm), wave("Force", "kN", one.force_kN, late=86_400.0)
    with pytest.raises(RecordingError, match=r"displacement has 20 Hz from 0 to 169\.95 s, force 20 Hz from 86400 to"):
        read(tdms(tmp_path, *channels))


def test_a_start_that_is_not_stated_is_assumed_aloud(tmp_path):
    one = plain()
    bare = ChannelObject("DAQ", "Force", one.force_kN, properties={"wf_increment": STEP, "unit_string": "kN"})
    recording = read(tdms(tmp_path, wave("Displacement", "mm", one.displacement_mm), bare))
    same(recording)
    assert "no start is stated for Force" in said(recording, "start-unknown")[0]


def test_time_stamps_are_a_time(tmp_path):
    one = plain()
    stamps = START + (one.time_s * 1e6).round().astype("timedelta64[us]")
    channels = [ChannelObject("DAQ", "Time", stamps)]
    channels += [
        ChannelObject("DAQ", name, values, properties={"unit_string": unit})
        for name, unit, values in (("Displacement", "mm", one.displacement_mm), ("Force", "kN", one.force_kN))
    ]
    same(read(tdms(tmp_path, *channels)))


# --- groups ---


def group_of(name, rows, late=0.0):
    one = plain()
    return [
        ChannelObject(name, title, values, properties={"unit_string": unit})
        for title, unit, values in (
            ("Time", "s", one.time_s[rows] - late),
            ("Displacement", "mm", one.displacement_mm[rows]),
            ("Force", "kN", one.force_kN[rows]),
        )
    ]


HALVES = slice(None, 1700), slice(1700, None)


def test_groups_with_numbers_are_runs_in_the_order_of_the_numbers(tmp_path):
    path = tdms(tmp_path, *group_of("Run 10", HALVES[1], 85.0), *group_of("Run 9", HALVES[0]))
    recording = read(path)
    first, second = split(recording)
    same(first, HALVES[0])
    same(second, HALVES[1], 85.0)
    assert "groups Run 9, Run 10" in said(recording, "groups")[0]
    same(read(path, sheet="Run 10"), HALVES[1], 85.0)
    with pytest.raises(RecordingError, match=r"'Run 8' is no group of it; its groups are Run 10, Run 9"):
        read(path, sheet="Run 8")


def test_runs_of_waveforms_without_a_time_column(tmp_path):
    one = plain()
    channels = []
    for number, rows in enumerate(HALVES, start=1):
        late = {"late": 3600.0 * number}
        channels.append(wave("Displacement", "mm", one.displacement_mm[rows], group=f"Run {number}", **late))
        late["late"] += 2 * STEP
        channels.append(wave("Force", "kN", one.force_kN[rows][2:], group=f"Run {number}", **late))
    first, second = split(read(tdms(tmp_path, *channels)))
    np.testing.assert_array_equal(first.force_kN, one.force_kN[2:1700])
    np.testing.assert_array_equal(second.force_kN, one.force_kN[1702:])
    np.testing.assert_allclose(second.displacement_mm, one.displacement_mm[1702:], atol=1e-6)


@pytest.mark.parametrize("names", [("Raw", "Filtered"), ("Specimen 1", "Specimen 2")])
def test_groups_that_need_not_be_runs_are_refused_and_one_can_be_taken(tmp_path, names):
    path = tdms(tmp_path, *group_of(names[0], HALVES[0]), *group_of(names[1], HALVES[1], 85.0))
    with pytest.raises(RecordingError, match=rf"{names[0]}/Displacement.*--sheet '({'|'.join(names)})'"):
        read(path)
    same(read(path, sheet=names[0]), HALVES[0])


@pytest.mark.parametrize("ending", ["tdms", "h5"])
def test_groups_of_one_channel_each_with_its_time(tmp_path, ending):
    """Two cards, each with a time column of its own."""
    one = plain()
    rows = slice(7, None, 2)
    content = {
        "Sensors": {"Time": one.time_s, "Displacement": one.displacement_mm},
        "Cell": {"Time": one.time_s[rows], "Force": one.force_kN[rows]},
    }
    if ending == "tdms":
        path = tdms(tmp_path, *(ChannelObject(g, c, v) for g, own in content.items() for c, v in own.items()))
    else:
        path = tmp_path / "run.h5"
        with h5py.File(path, "w") as file:
            for group, own in content.items():
                for name, values in own.items():
                    file[f"{group}/{name}"] = values
    same(read(path), rows)


def test_groups_of_hdf5_are_runs(tmp_path):
    path = tmp_path / "run.h5"
    with h5py.File(path, "w") as file:
        for number, rows in (("2", HALVES[0]), ("10", HALVES[1])):
            for name, values in frame(rows).items():
                file[f"test {number}/{name}"] = values - (85.0 if number == "10" and name == "time_s" else 0.0)
    first, second = split(read(path))
    same(first, HALVES[0])
    same(second, HALVES[1], 85.0)


# --- structs and cells of MATLAB ---


def matlab():
    """The plain table in the ways of MATLAB, by name."""
    one = plain()
    t, x, f = one.time_s, one.displacement_mm, one.force_kN
    names = np.array(["time", "disp", "force"], dtype=object)
    vectors, table = np.empty(3, dtype=object), np.empty((N_ROWS + 1, 3), dtype=object)
    vectors[:] = [t, x, f]
    table[0], table[1:] = names, np.column_stack([t, x, f]).astype(object)
    kind = [("name", "O"), ("unit", "O"), ("data", "O")]
    channels = np.array([("time", "s", t), ("disp", "mm", x), ("force", "kN", f)], dtype=kind)
    return {
        "struct": {"test": {"specimen": "A1", "data": {"time": t, "disp": x, "force": f}}},
        "pairs": {"disp": {"Time": t, "Data": x}, "force": {"Time": t, "Data": f}},
        "named pair": {
            "a": {"Time": t, "Data": x, "Name": "Stroke", "Units": "mm"},
            "b": {"Time": t, "Data": f, "Name": "Load", "Units": "kN"},
        },
        "matrix and names": {"data": np.column_stack([t, x, f]), "colheaders": names},
        "cells of vectors": {"data": vectors, "names": names},
        "cells of numbers": {"data": table[1:3000], "names": names},
        "cells with titles": {"raw": table[:3000]},
        "array of channels": {"channel": channels},
        "signals": {
            "out": {"time": t, "signals": np.array([(x, "disp"), (f, "force")], [("values", "O"), ("label", "O")])}
        },
    }


@pytest.fixture
def here(monkeypatch):
    """Structs and HDF5 are read in this process, not in one of their own, which takes most of the time."""

    def apart(path, mark):
        return flat((from_hdf5 if binary.is_hdf5(path) else binary.from_mat)(path), mark)

    monkeypatch.setattr(binary, "apart", apart)


def test_structs_and_groups_are_read_in_a_process_of_their_own(tmp_path):
    scipy.io.savemat(tmp_path / "run.mat", matlab()["pairs"], do_compression=True)
    same(read(tmp_path / "run.mat"))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("way", list(matlab()))
def test_ways_of_matlab(tmp_path, way):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, matlab()[way], do_compression=True)
    same(read(path), slice(None, 2999) if way in ("cells of numbers", "cells with titles") else ALL)


@pytest.mark.usefixtures("here")
def test_fields_are_named_with_dots(tmp_path):
    path = tmp_path / "run.mat"
    one = plain()
    other = {"a": one.time_s, "b": one.displacement_mm, "c": 2 * one.force_kN, "gain": 0.5}
    scipy.io.savemat(path, {"test": {"data": other, "info": {"a": one.time_s[:9]}}})
    with pytest.raises(RecordingError, match=r"test\.data\.a, 2: test\.data\.b, 3: test\.data\.c"):
        read(path)
    columns = "time=test.data.a,displacement=test.data.b,force=test.data.gain*test.data.c"
    same(read(path, columns=columns, units="s,mm,kN"))


@pytest.mark.usefixtures("here")
def test_pairs_with_different_times_are_laid_on_one_axis(tmp_path):
    path = tmp_path / "run.mat"
    one = plain()
    force = {"Time": one.time_s[5::2], "Data": one.force_kN[5::2]}
    scipy.io.savemat(path, {"disp": {"Time": one.time_s, "Data": one.displacement_mm}, "force": force})
    recording = read(path)
    same(recording, slice(5, None, 2))
    assert said(recording, "own-times")


@pytest.mark.usefixtures("here")
def test_times_of_pairs_in_milliseconds(tmp_path):
    """No unit is stated, so seconds are assumed aloud, and refused as unlikely, until the option says more."""
    path = tmp_path / "run.mat"
    one = plain()
    pairs = {
        name: {"Time": 1e3 * one.time_s, "Data": v}
        for name, v in (("disp", one.displacement_mm), ("force", one.force_kN))
    }
    scipy.io.savemat(path, pairs)
    recording = read(path)
    assert not recording.usable
    assert any("time" in words for words in said(recording, "unit-assumed"))
    same(read(path, units="time=ms"))
    with pytest.raises(RecordingError, match=r"the time of the channels says 0\.02 Hz, --rate 20 Hz"):
        read(path, rate_Hz=20.0)


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("clock", [np.zeros(N_ROWS), np.full(N_ROWS, np.nan), -plain().time_s])
@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("options", [{}, {"rate_Hz": 20.0}])
def test_times_that_are_none_end_in_words(tmp_path, clock, both, options):
    path = tmp_path / "run.mat"
    one = plain()
    disp = {"Time": clock if both else one.time_s, "Data": one.displacement_mm}
    scipy.io.savemat(path, {"disp": disp, "force": {"Time": clock, "Data": one.force_kN}})
    (facts, text), *_ = check_recording(path, **options)
    assert facts["usable"] == (both and bool(options))  # the same times for both, which are wrong: the rate holds
    assert facts["usable"] or "time" in text


@pytest.mark.usefixtures("here")
def test_two_times_in_one_place_are_not_chosen_from(tmp_path):
    path = tmp_path / "run.mat"
    one = plain()
    data = {"time": one.time_s, "t": 2 * one.time_s, "disp": one.displacement_mm, "force": one.force_kN}
    scipy.io.savemat(path, {"test": data})
    with pytest.raises(RecordingError, match=r"2 columns could be time: test\.time, test\.t"):
        read(path)
    same(read(path, columns="time=test.time"))


@pytest.mark.usefixtures("here")
def test_a_curve_over_the_displacement_is_no_channel_with_times(tmp_path):
    path = tmp_path / "run.mat"
    one = plain()
    scipy.io.savemat(path, {"loop": {"x": one.displacement_mm, "y": one.force_kN}})
    with pytest.raises(RecordingError, match=r"loop\.x, 2: loop\.y"):
        read(path)
    same(read(path, columns="displacement=loop.x,force=loop.y", units="mm,kN", rate_Hz=20.0))


@pytest.mark.usefixtures("here")
def test_an_array_of_structs_is_runs(tmp_path):
    one = plain()
    kind = [("time", "O"), ("disp", "O"), ("force", "O")]
    runs = [(one.time_s[r] - one.time_s[r][0], one.displacement_mm[r], one.force_kN[r]) for r in HALVES]
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"test": np.array(runs, dtype=kind)})
    first, second = split(read(path))
    same(first, HALVES[0])
    same(second, HALVES[1], 85.0)
    same(read(path, sheet="test(2)"), HALVES[1], 85.0)


@pytest.mark.usefixtures("here")
def test_what_is_no_recording_lists_its_fields(tmp_path):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"test": {"specimen": "A1", "K": 18.0, "note": {"by": "C. D."}}})
    with pytest.raises(
        RecordingError, match=r"no column of numbers.*test\.K; .*test\.specimen, test\.note\.by.*ts\.Time"
    ):
        read(path)


def put(file, name, values, kind="double"):
    """A variable as MATLAB writes it into v7.3."""
    if isinstance(values, str):
        values, kind = np.array([[ord(letter)] for letter in values], dtype=np.uint16), "char"
    if isinstance(values, dict):
        group = file.create_group(name)
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, value in values.items():
            put(group, key, value)
        return
    file.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_(kind)


def references(file, values):
    """Cells lie in a group of their own."""
    out = np.empty((len(values), 1), dtype=h5py.ref_dtype)
    for i, value in enumerate(values):
        name = f"#refs#/{len(file.require_group('#refs#'))}"
        put(file, name, value)
        out[i, 0] = file[name].ref
    return out


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("way", ["struct", "pairs", "cells", "array", "objects"])
def test_ways_of_matlab_in_hdf5(tmp_path, way):
    path = tmp_path / "run.mat"
    one = plain()
    columns = {"time": one.time_s[None], "disp": one.displacement_mm[None], "force": one.force_kN[None]}
    with h5py.File(path, "w", userblock_size=512) as file:
        if way == "struct":
            put(file, "test", {"specimen": "A1", "data": columns})
        elif way == "pairs":
            for name in ("disp", "force"):
                put(file, name, {"Time": columns["time"], "Data": columns[name]})
        elif way == "cells":
            put(file, "names", references(file, list(columns)), "cell")
            put(file, "data", references(file, list(columns.values())), "cell")
        elif way == "array":
            group = file.create_group("test")
            group.attrs["MATLAB_class"] = np.bytes_("struct")
            for name, values in columns.items():
                low = float(values[0, 1700]) if name == "time" else 0.0
                group[name] = references(file, [values[:, :1700], values[:, 1700:] - low])
        else:
            put(file, "tt", np.arange(6, dtype=np.uint32)[None], "timetable")
    if way == "objects":
        with pytest.raises(RecordingError, match=r"no column of numbers.*: tt; .*timetable only MATLAB can open"):
            read(path)
        return
    recording = read(path)
    if way == "array":
        first, second = split(recording)
        same(first, HALVES[0])
        same(second, HALVES[1], 85.0)
    else:
        same(recording)


# --- workbooks ---

HEAD = ["Time (s)", "Displacement (mm)", "Force (kN)"]


def workbook(tmp_path, **sheets):
    book = openpyxl.Workbook(write_only=True)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title.replace("_", " "))
        for row in rows:
            sheet.append(row)
    book.save(tmp_path / "run.xlsx")
    return tmp_path / "run.xlsx"


def rows_of(rows=ALL, late=0.0):
    table = frame(rows)
    return [HEAD, *(table - [late, 0.0, 0.0]).to_numpy().tolist()]


def test_the_sheet_that_holds_the_recording_is_read(tmp_path):
    peaks = [
        ["Cycle", "Max displacement (mm)", "Max force (kN)", "Time (s)"],
        *([i, 6.0, 80.0 + i, 3.0 * i] for i in range(40)),
    ]
    path = workbook(tmp_path, Summary=peaks, Data=rows_of(slice(1000)))
    recording = read(path)
    same(recording, slice(1000))
    assert said(recording, "sheet") == [
        "sheet 'Data' is read, whose header names the channels; not read: Summary; --sheet NAME takes another"
    ]
    with pytest.raises(RecordingError, match=r"no sheet 'Dat'.*sheets are Summary, Data"):
        read(path, sheet="Dat")
    assert read(path, sheet="summary").n_samples == 40


def test_sheets_with_numbers_are_runs(tmp_path):
    path = workbook(tmp_path, Run_1=rows_of(slice(1000)), Run_2=rows_of(slice(1000, 2000), 50.0))
    first, second = split(read(path))
    same(first, slice(1000))
    same(second, slice(1000, 2000), 50.0)


def test_two_sheets_that_may_both_be_it_are_refused(tmp_path):
    path = workbook(tmp_path, Raw=rows_of(slice(1000)), Filtered=rows_of(slice(1000, 2000)))
    with pytest.raises(RecordingError, match=r"sheets Raw, Filtered all hold.*--sheet 'Raw'"):
        read(path)
    same(read(path, sheet="Raw"), slice(1000))


def test_the_option_reaches_every_command(tmp_path):
    path = workbook(tmp_path, Raw=rows_of(slice(1000)), Filtered=rows_of(slice(1000, 2000)))
    result = CliRunner().invoke(main, ["check", str(path), "--sheet", "Raw"])
    assert result.exit_code == 0
    assert "1000 at 20 Hz" in result.output
    assert "--sheet" in CliRunner().invoke(main, ["check", str(path)]).output
    (recording,) = read_device([path], FitOptions(sheet="Raw"))
    same(recording, slice(1000))
    manifest = tmp_path / "campaign.toml"
    text = 'schema = "shj-bayes/campaign/1"\nname = "A"\n[[set]]\nname = "S"\noptions = {sheet = "Raw"}\n'
    manifest.write_text(f'{text}[[set.device]]\nname = "D"\nrecordings = ["run.xlsx"]\n')
    assert read_manifest(manifest).devices[0].options.sheet == "Raw"
    (tmp_path / "run.csv").write_text("time_s,displacement_mm,force_kN\n0,1,2\n")
    with pytest.raises(RecordingError, match="has no sheets or groups; leave --sheet out"):
        read(tmp_path / "run.csv", sheet="Raw")


# --- JSON ---


@pytest.mark.parametrize("orient", ["columns", "index", "split", "records", "values", "table"])
def test_ways_of_pandas(tmp_path, orient):
    path = tmp_path / "run.json"
    frame().to_json(path, orient=orient, double_precision=10)
    recording = read(path, columns="time=1,displacement=2,force=3" if orient == "values" else None)
    same(recording)
    assert not said(recording, "columns-ignored")


def test_columns_by_index_beside_other_things(tmp_path):
    path = tmp_path / "run.json"
    columns = json.loads(frame().to_json(double_precision=10))
    path.write_text(json.dumps({"device": "A1", "about": {"by": "C. D.", "rig": "B"}, **columns}))
    same(read(path))
    frame().set_axis([0, 1, 2], axis=1).to_json(path, double_precision=10)
    same(read(path, columns="time=1,displacement=2,force=3"))


@pytest.mark.parametrize("ending", ["json", "jsonl", "ndjson"])
def test_a_record_on_each_line(tmp_path, ending):
    path = tmp_path / f"run.{ending}"
    frame().to_json(path, orient="records", lines=True, double_precision=10)
    same(read(path))


@pytest.mark.parametrize("orient", ["columns", "split"])
def test_an_index_that_does_not_count_can_be_the_time(tmp_path, orient):
    path = tmp_path / "run.json"
    frame().set_index("time_s").to_json(path, orient=orient, double_precision=10)
    with pytest.raises(RecordingError, match=r"no time column found; columns are .*: index"):
        read(path)
    same(read(path, columns="time=index", units="time=s"))


@pytest.mark.parametrize("place", ["columns", "record"])
def test_a_name_that_stands_twice_is_refused(tmp_path, place):
    path = tmp_path / "run.json"
    columns = json.dumps(frame().to_dict("list"))
    twice = f'{{"force_kN": [1, 2, 3], {columns[1:]}'
    path.write_text(twice if place == "columns" else f'[{{"time_s": 0, "time_s": 1}}, {twice}]')
    (facts, text), *_ = check_recording(path)
    assert not facts["usable"]
    assert "stands twice in one object" in text
