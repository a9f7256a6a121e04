import subprocess
import sys

import pytest

from shj_bayes.errors import RecordingError
from shj_bayes.recording.rows import split_header
from shj_bayes.recording.units import factor, parse_units, role_of


@pytest.mark.parametrize(
    ("unit", "role", "expected"),
    [
        ("in", "displacement", 25.4),
        ('"', "displacement", 25.4),
        ("inch", "displacement", 25.4),
        ("Inches", "displacement", 25.4),
        ("m", "displacement", 1000.0),
        ("cm", "displacement", 10.0),
        ("MM", "displacement", 1.0),
        ("\u00b5m", "displacement", 1e-3),
        ("microns", "displacement", 1e-3),
        ("ft", "displacement", 304.8),
        ("dm", "displacement", 100.0),
        ("Millimetres", "displacement", 1.0),
        ("thou", "displacement", 0.0254),
        ("daN", "force", 0.01),
        ("KILONEWTONS", "force", 1.0),
        ("kip", "force", 4.4482216152605),
        ("kips", "force", 4.4482216152605),
        ("lb", "force", 4.4482216152605e-3),
        ("lbf", "force", 4.4482216152605e-3),
        ("N", "force", 1e-3),
        ("KN", "force", 1.0),
        ("kn", "force", 1.0),
        ("MN", "force", 1e3),
        ("kgf", "force", 9.80665e-3),
        ("tonf", "force", 9.80665),
        ("s", "time", 1.0),
        ("Sec", "time", 1.0),
        ("ms", "time", 1e-3),
        ("min", "time", 60.0),
        ("h", "time", 3600.0),
    ],
)
def test_factors(unit, role, expected):
    assert factor(unit, role) == pytest.approx(expected, rel=1e-12)
    assert role_of(unit) == role


@pytest.mark.parametrize(
    ("unit", "role", "words"),
    [
        ("V", "force", ["'V'", "force", "kN", "calibration"]),
        ("MPa", "force", ["'MPa'", "not of force", "N, kN"]),
        ("N/mm\u00b2", "force", ["not of force"]),
        ("RN", "force", ["no known unit"]),
        ("mn", "force", ["no known unit"]),
        ("mm", "force", ["'mm'", "not of force"]),
        ("kNn", "force", ["'kNn'", "no known unit", "did you mean 'kN'"]),
        ("__import__('os')", "time", ["no known unit of time"]),
        ("mN" * 20, "force", ["no known unit"]),
    ],
)
def test_refused_units_say_what_is_allowed(unit, role, words):
    with pytest.raises(RecordingError) as caught:
        factor(unit, role)
    for word in words:
        assert word in str(caught.value)


def test_units_option_takes_any_order_and_pairs():
    assert parse_units("kN, s,mm") == {"force": "kN", "time": "s", "displacement": "mm"}
    assert parse_units("time=ms,force=lb") == {"time": "ms", "force": "lb"}
    assert parse_units(None) == {}
    assert parse_units("") == {}


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("mm,in", ["displacement twice", "'mm'", "'in'"]),
        ("mm,kM,s", ["'kM'", "did you mean", "mm,kN,s"]),
        ("load=kN", ["'load'", "time, displacement, force"]),
        ("force=s", ["'s'", "not of force"]),
        ("bananas", ["'bananas'"]),
    ],
)
def test_bad_units_option(option, words):
    with pytest.raises(RecordingError) as caught:
        parse_units(option)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Displacement (in)", "Displacement", "in"),
        ("Force [kip]", "Force", "kip"),
        ("time_s", "time", "s"),
        ("force_kN", "force", "kN"),
        ("Load / kN", "Load", "kN"),
        ("Load, kN", "Load", "kN"),
        ("Stroke mm", "Stroke", "mm"),
        ("e_true", "e_true", None),
        ("Sigma_true", "Sigma_true", None),
        ("Velocity (as published; wrong scale)", "Velocity (as published; wrong scale)", None),
        ("Force", "Force", None),
        ("LVDT_a", "LVDT_a", None),
        ("Load t", "Load", "t"),
        ("Shift t", "Shift t", None),
        ('Stroke (")', "Stroke", '"'),
    ],
)
def test_headers(header, name, unit):
    assert split_header(header) == (name, unit)


def test_pandas_is_not_imported_before_it_is_needed():
    code = "import sys, shj_bayes.recording.reader; sys.exit('pandas' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
