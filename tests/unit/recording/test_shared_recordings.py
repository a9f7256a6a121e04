"""Every public recording is read, or refused for a clear reason; known numbers are found."""

import numpy as np
import pytest

from shj_bayes.errors import RecordingError
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.runs import settle

SEALS = {"columns": "time=1,displacement=5,force=#7 - 49.0874*#6", "units": "ms,mm,N"}
EMPS = {"columns": "time=t,displacement=qm,force=gtau*vir", "units": "s,m,N"}
DAMPER = {"columns": "time=Ts,displacement=dist,force=forc", "units": "s,mm,N"}
PLATE = {"columns": "displacement=1,force=2", "units": "mm,kN", "rate_Hz": 1.0}
# file: options, half-cycles, force range in kN (of the published numbers, converted by hand where they are not in kN)
KNOWN = {
    "brfd-lehigh/ds1_0.5Hz20lb.csv.gz": ({}, 17),
    "brfd-lehigh/ds1_0.5Hz25lb.csv.gz": ({}, 17),
    "brfd-lehigh/ds1_0.5Hz80lb.csv.gz": ({}, 17),
    "brfd-lehigh/ds2_0.25Hz36lb1in.csv.gz": ({}, 15),
    "brfd-lehigh/ds2_0.5Hz30lb0.5in.csv.gz": ({}, 15),
    "brfd-lehigh/ds2_0.5Hz30lb1in.csv.gz": ({}, 15),
    "brfd-lehigh/ds2_0.5Hz36lb0.5in.csv.gz": ({}, 15),
    "brfd-lehigh/ds2_0.5Hz36lb1in.csv.gz": ({}, 15),
    "brfd-lehigh/ds2_1Hz36lb1in.csv.gz": ({}, 15),
    "brfd-lehigh/ds2_eq_ImperialValleyMCE.csv.gz": ({}, None),
    "brfd-lehigh/ds4_harmonic0.03ea1forward.csv.gz": ({}, 15),
    "brfd-lehigh/ds4_step0.03ea1forward.csv.gz": ({}, 15),
    "seals-tud/KDN_1bar.txt.gz": (SEALS, 20),
    "seals-tud/KDN_3bar.txt.gz": (SEALS, 20),
    "seals-tud/KDN_7bar.txt.gz": (SEALS, 20),
    "seals-tud/O-ring_1bar.txt.gz": (SEALS, 20),
    "seals-tud/O-ring_7bar.txt.gz": (SEALS, 20),
    "seals-tud/PK_1bar.txt.gz": (SEALS, 20),
    "seals-tud/PK_5bar.txt.gz": (SEALS, 20),
    "seals-tud/PK_7bar.txt.gz": (SEALS, 20),
    "emps/DATA_EMPS.mat": (EMPS, 8),
    "mr-damper-utfpr/ensaio.B.5.mat": (DAMPER, None),
    "mr-damper-utfpr/ensaio5.1.mat": (DAMPER, None),
    "mr-damper-utfpr/ensaio5.2.mat": (DAMPER, None),
    "quasistatic/Chan_Albermani_slit_damper_digitised.csv": (PLATE, 14),
    "quasistatic/Ganey2015_UFP_damper.csv": (PLATE, 21),
}
LOUD = {"repaired", "warning", "unusable"}
# Exchanged at their full rate; all others are thinned, since a turning point is sought in every wiggle of the noise.
FULL = ("brfd-lehigh/ds2_0.5Hz36lb1in.csv.gz", "seals-tud/PK_1bar.txt.gz")
MOST = 1500  # rows of a thinned one


@pytest.mark.parametrize("name", KNOWN)
def test_recordings_are_read_without_a_false_alarm(shared, name):
    options, n_half = KNOWN[name]
    recording = read(shared / name, **options)
    loud = [f.code for f in recording.findings if f.severity in LOUD]
    # The seals' laser drops by 0.4 mm for single samples, some 50 to 80 times in each file: that is no false alarm.
    assert loud == (["spikes"] if "seals" in name else [])
    assert np.count_nonzero(~recording.used) <= (0.011 * recording.n_samples if loud else 0)
    assert settle([recording]) == [recording]
    motion = motion_of(recording)
    assert n_half is None or motion.n_half == n_half
    # No half-cycle shorter than the shortest possible real one: noise would make many of a few samples.
    assert np.median(np.diff(motion.start)) > 0.02 * recording.n_samples / motion.n_half


@pytest.mark.parametrize("name", [name for name in KNOWN if "quasistatic" not in name])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_exchanged_columns_are_refused_and_a_wrong_sign_is_turned(shared, tmp_path, name, sign):
    """A force taken for the displacement turns hundreds of times; a loop turned round would hide that."""
    recording = read(shared / name, **KNOWN[name][0])
    every = 1 if name in FULL else max(1, recording.n_samples // MOST)
    channels = (recording.time_s, recording.displacement_mm, sign * recording.force_kN)
    t, x, f = (values[::every] for values in channels)
    path = tmp_path / "run.csv"
    wide = np.ptp(x) / np.ptp(f)  # both channels of a usual size, so that nothing else refuses them
    np.savetxt(
        path, np.column_stack([t, f * wide, x]), header="time_s,displacement_mm,force_kN", delimiter=",", comments=""
    )
    assert "swapped-columns" in {f.code for f in read(path).findings if f.severity == "unusable"}
    np.savetxt(
        path, np.column_stack([t, x, f * wide]), header="time_s,displacement_mm,force_kN", delimiter=",", comments=""
    )
    codes = {f.code for f in read(path).findings}
    assert "swapped-columns" not in codes
    assert ("force-sign" in codes) == (sign < 0)


@pytest.mark.parametrize(
    "name",
    [
        "steel-coupons/RESSPyLab_example_1.csv",
        "steel-coupons/RESSPyLab_example_2.csv",
        "quasistatic/Chan_Albermani_slit_damper_digitised.csv",
        "quasistatic/Ganey2015_UFP_damper.csv",
    ],
)
def test_recordings_without_time_are_refused_clearly(shared, name):
    with pytest.raises(RecordingError, match=r"no time column.*--columns.*--rate"):
        read(shared / name)
    with pytest.raises(RecordingError, match="'MPa' is a unit, but not of force"):
        read(shared / name, columns="displacement=1,force=2", units="mm,force=MPa", rate_Hz=1.0)


def test_units_of_the_lehigh_damper(shared):
    recording = read(shared / "brfd-lehigh/ds1_0.5Hz80lb.csv.gz")
    assert recording.rate_Hz == pytest.approx(1024.0, rel=1e-4)
    assert recording.displacement_mm[0] == pytest.approx(-0.07219407 * 25.4, rel=1e-9)
    assert recording.force_kN[0] == pytest.approx(-0.2117032 * 4.4482216152605, rel=1e-9)
    offset = next(f for f in recording.findings if f.code == "displacement-offset")
    assert "-1.8" in offset.message  # the publication of ds1 says about -2 mm


def test_step_of_the_clock_of_a_seal(shared):
    recording = read(shared / "seals-tud/PK_1bar.txt.gz", **SEALS)
    assert np.flatnonzero(recording.restarts).tolist() == [0, 1]
    assert "0.279 s" in next(f for f in recording.findings if f.code == "gaps").message
