"""The exported scripts: run by OpenSees itself where it is installed, read back everywhere."""

import csv
import runpy

import numpy as np
import pytest
from scipy.integrate import trapezoid

from shj_bayes.margins.bounds import Bound
from shj_bayes.margins.link_elements import HELP, link_csv
from shj_bayes.margins.opensees import exponent_of_steel02, python_script, tcl_script
from shj_bayes.model.law import force
from shj_bayes.recording.protocol import Block, exact_motion

HOSTILE = 'brass"; import os #\n[exec rm] {$x}'
BOUNDS = tuple(
    Bound(name, bound, K, F, beta, F / 95, 0.6, 2)
    for name, beta in (("zinc", 10.0), ("bare", 100.0), (HOSTILE, 10.0))
    for bound, K, F in (("lower", 9.0, 50.0), ("middle", 12.0, 80.0), ("upper", 18.0, 110.0))
)
AMPLITUDE_MM = 95.0
POINT, MEAN_SQUARE, ENERGY = 0.075, 0.02, 0.005
"""What opensees.py says of the difference, as shares of the sliding force and of the energy."""


@pytest.fixture
def script(tmp_path):
    path = tmp_path / "connection_materials.py"
    path.write_text(python_script(BOUNDS, AMPLITUDE_MM, "tést\nimport os"), encoding="utf-8")
    return runpy.run_path(str(path))


def test_the_python_script_holds_the_materials_and_runs_nothing_else(script):
    assert set(script["MATERIALS"]) == {(b.set_name, b.bound) for b in BOUNDS}
    calls = []

    class Recorder:
        def uniaxialMaterial(self, *arguments):
            calls.append(arguments)

    script["define"](Recorder(), 7, "zinc", "upper")
    assert calls == [("Steel02", 7, 110.0, 18.0, 1e-5, pytest.approx(exponent_of_steel02(10.0), rel=1e-5), 0.0, 0.15)]
    assert "os" not in script


def test_the_tcl_script_holds_no_foreign_code():
    text = tcl_script(BOUNDS, "x\n[exec rm]")
    code = [line for line in text.splitlines() if not line.startswith("#")]
    assert sum(line.startswith("set frictionMaterial(") for line in code) == len(BOUNDS)
    assert "exec" not in "".join(code)
    assert not any("[" in line or "\\" in line for line in text.splitlines() if line.startswith("#"))
    assert "set frictionMaterial(1,upper) {110 18 " in text
    assert "speed" in text


def test_the_link_table_explains_every_column(tmp_path):
    text = link_csv(BOUNDS, "95 mm at 10 mm/s")
    lines = text.splitlines()
    help_lines = [line for line in lines if line.startswith("#")]
    assert [line.split(":")[0][2:] for line in help_lines[:-1]] == list(HELP)
    rows = list(csv.DictReader(text.split("\n", len(help_lines))[-1].splitlines()))
    assert float(rows[2]["yield_force_kN"]) == 110.0
    assert float(rows[2]["stiffness_kN_per_m"]) == 18000.0
    assert float(rows[3]["wen_exponent"]) == 20.0


@pytest.mark.parametrize("amplitude", [24.0, 95.0])
def test_opensees_draws_our_loop(script, amplitude):
    ops = pytest.importorskip(
        "openseespy.opensees",
        reason="openseespy is not installed (see tests/requirements-reference.txt)",
        exc_type=Exception,
    )
    _, motion = exact_motion((Block(amplitude, 10 / (2 * np.pi * amplitude), 2),), 800 * 10 / (2 * np.pi * amplitude))
    x = motion.displacement_mm
    steady = slice(int(motion.start[1]), int(motion.start[4]))
    for b in BOUNDS[:6]:
        theirs = np.array(script["loop"](ops, b.set_name, b.bound, x))
        ours = force(motion, K=b.K_kN_mm, Fy=b.force_kN, beta=b.beta)
        apart = (theirs - ours) / b.force_kN
        assert np.abs(apart).max() < POINT
        assert np.sqrt(np.mean(apart**2)) < MEAN_SQUARE
        energy = [trapezoid(f[steady], x[steady]) for f in (theirs, ours)]
        assert energy[0] == pytest.approx(energy[1], rel=ENERGY)
