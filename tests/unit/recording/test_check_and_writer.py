import json

import numpy as np
import pytest

from shj_bayes.errors import RecordingError
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording, write_csv
from shj_bayes.recording.runs import blocks_of, check_recording, describe, to_dict


def test_written_files_read_back_to_the_stated_digits(tmp_path, small):
    path = write_csv(tmp_path / "run.csv", small, comment="SIMULATED\nnot measured", digits=17)
    again = read(path)
    for name in ("time_s", "displacement_mm", "force_kN"):
        np.testing.assert_array_equal(getattr(again, name), getattr(small, name))
    assert [f.code for f in again.findings] == ["simulated"]
    assert again.source.columns == {"time": "time_s", "displacement": "displacement_mm", "force": "force_kN"}
    short = read(write_csv(tmp_path / "short.csv", small))
    np.testing.assert_allclose(short.force_kN, small.force_kN, rtol=6e-7)
    assert short.findings == ()


def test_writer_refuses_what_it_cannot_do(tmp_path, small):
    with pytest.raises(RecordingError, match="digits = 2: allowed is 3 to 17"):
        write_csv(tmp_path / "run.csv", small, digits=2)
    with pytest.raises(RecordingError, match="cannot be written"):
        write_csv(tmp_path / "none" / "run.csv", small)


def test_blocks(clean):
    recording = Recording(clean.time, clean.displacement, clean.force)
    blocks = blocks_of(motion_of(recording))
    assert [round(b["amplitude_mm"]) for b in blocks] == [6, 12, 24, 48, 72, 95]
    assert [b["cycles"] for b in blocks] == [3, 3, 3, 3, 3, 5]
    assert blocks[0]["peak_speed_mm_s"] == pytest.approx(10.2, rel=0.1)


def test_description_and_dictionary_say_the_same(tmp_path, small):
    path = write_csv(tmp_path / "run.csv", small, comment="SIMULATED")
    recording = read(path)
    text = describe(recording, to_dict(recording))
    for words in (
        "run.csv: usable",
        "force_kN  [kN]",
        "20 Hz",
        "13 half-cycles",
        " mm x 3 at ",
        "note      simulated",
    ):
        assert words in text
    facts = json.loads(json.dumps(to_dict(recording)))
    assert facts["schema"] == "shj-bayes/check/1"
    assert facts["usable"] is True
    assert facts["motion"]["half_cycles"] == 13
    assert facts["n_samples"] == small.n_samples


def test_forces_of_a_small_device_are_told_in_newton_as_its_page_tells_them(tmp_path, small):
    def told(factor):
        weak = Recording(small.time_s, small.displacement_mm, factor * (small.force_kN + 20.0))
        path = write_csv(tmp_path / "weak.csv", weak, digits=8)
        [(facts, text)] = check_recording(path)
        return facts["force_kN"][1], text, read(path)._repr_html_()

    peak, text, table = told(0.002)
    assert f"{1000 * peak:.4g} N\n" in text
    assert "N off centre" in text
    assert "kN" not in text.replace("force_kN  [kN]", "")
    assert f"{1000 * peak:.4g} N<" in table
    peak, text, _ = told(1.0)
    assert f"{peak:.4g} kN\n" in text
    assert "kN off centre" in text


def test_description_without_motion_and_worst_first(tmp_path):
    path = tmp_path / "flat.csv"
    path.write_text("time_s,displacement_mm,force\n" + "".join(f"{i},0.0,{1e6 * (i % 3)}\n" for i in range(50)))
    recording = read(path)
    text = describe(recording, to_dict(recording))
    assert "NOT USABLE" in text
    assert text.index("unusable") < text.index("assumed")
    assert "motion" not in to_dict(recording)
    short = Recording([0, 1], [0, 1], [0, 1])
    assert "nothing to remark" in describe(short, to_dict(short))
