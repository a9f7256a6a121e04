"""The exported scripts: run by OpenSees itself where it is installed, read back everywhere."""

import csv
import runpy

import numpy as np
import pytest
from scipy.integrate import trapezoid

from shj_bayes.margins.export import (
    HELP,
    Bound,
    draws_script,
    exponent_of_steel02,
    link_csv,
    links_script,
    python_script,
    tcl_script,
)
from shj_bayes.model.law import force
from shj_bayes.recording.motion import Block, exact_motion

HOSTILE = 'brass"; import os #\n[exec rm] {$x}'
BOUNDS = tuple(
    Bound(name, bound, K, F, beta, F / 95, 0.6, 2, slip)
    for name, beta, slip in (("zinc", 10.0, 60.0), ("bare", 100.0, None), (HOSTILE, 10.0, None))
    for bound, K, F in (("lower", 9.0, 50.0), ("middle", 12.0, 80.0), ("upper", 18.0, 110.0))
)
AMPLITUDE_MM = 95.0
POINT, MEAN_SQUARE, ENERGY = 0.075, 0.02, 0.005
"""What opensees.py says of the difference, as shares of the sliding force and of the energy."""


def opensees():
    return pytest.importorskip(
        "openseespy.opensees",
        reason="openseespy is not installed (see tests/requirements-reference.txt)",
        exc_type=Exception,
    )


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
    ops = opensees()
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


def test_the_slot_ends_in_opensees(script):
    """Beyond 60 mm of free slip a bearing of 200 kN/mm adds 10 x 200 = 2000 kN at 70 mm, to either side."""
    ops = opensees()
    x = 70.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 2001))
    free = np.array(script["loop"](ops, "zinc", "lower", x))
    ops.wipe()
    script["define_in_slot"](ops, 1, "zinc", "lower", 200.0)
    ops.testUniaxialMaterial(1)
    stopped = []
    for value in x:
        ops.setStrain(float(value))
        stopped.append(ops.getStress())
    added = np.array(stopped) - free
    assert added[500] == pytest.approx(2000.0, rel=1e-3)
    assert added[1500] == pytest.approx(-2000.0, rel=1e-3)
    assert np.abs(added[np.abs(x) < 60.0]).max() < 1e-6


@pytest.mark.parametrize("program", ["sap2000", "etabs"])
def test_links_of_the_csi_programs_are_defined_in_their_units(tmp_path, program):
    """Plastic (Wen) links along U1; a stated bearing adds a gap and a hook where the free slip is known."""
    path = tmp_path / "connection_links.py"
    path.write_text(
        links_script(BOUNDS, program, "tést\nimport os", ("Stiffness of zinc is that of the device.",)), "utf-8"
    )
    script = runpy.run_path(str(path))
    calls = []

    class Model:
        PropLink = property(lambda self: self)

        def __getattr__(self, name):
            return lambda *given: calls.append((name, *given)) or (3 if name == "GetPresentUnits" else [given, 0])

    script["define"](Model(), bearing=200.0)
    assert calls[:2] == [("GetPresentUnits",), ("SetPresentUnits", 5)]
    assert calls[-1] == ("SetPresentUnits", 3)
    wen = next(call for call in calls if call[1:2] == ("1 zinc, upper",))
    on = [True, False, False, False, False, False]
    assert wen[0] == "SetPlasticWen"
    assert wen[2:5] == (on, [False] * 6, on)
    assert [values[0] for values in wen[5:11]] == pytest.approx([110 / 95, 0.0, 18.0, 110.0, 1e-5, 9.0], abs=0.9)
    stops = [call for call in calls if call[0] in ("SetGap", "SetHook")]
    assert len(stops) == 2 * 3  # of zinc alone
    assert stops[0][7:9] == ([200.0, 0, 0, 0, 0, 0], [60.0, 0, 0, 0, 0, 0])
    assert "# - Stiffness of zinc is that of the device." in path.read_text("utf-8")
    with pytest.raises(SystemExit, match="refuses"):
        script["done"]([1], "zinc")


DRAWN = {
    "zinc": np.array([[12.0, 80.0, 64.0, exponent_of_steel02(10.0), 0.9]]),
    HOSTILE: np.array([[18.0, 60.0, 60.0, exponent_of_steel02(30.0), 1.2]]),
}
SPEED = 10.0


@pytest.fixture
def drawn_script(tmp_path):
    path = tmp_path / "connection_draws.py"
    path.write_text(draws_script(DRAWN, AMPLITUDE_MM, SPEED, "tést\nimport os"), encoding="utf-8")
    return runpy.run_path(str(path))


def test_a_drawn_device_carries_its_speed_law(drawn_script):
    """0.9 of 80 kN at rest is 72; 8 kN more at the tested speed, 8 / (1 - 1/e) = 12.656 at any speed: 84.656 kN.

    The plateau force of a sine of 10 mm/s belongs to 9.566 mm/s, so the rate is 1/9.566 = 0.10454 s/mm.
    """
    calls = []

    class Recorder:
        def frictionModel(self, *arguments):
            calls.append(arguments)

        def uniaxialMaterial(self, *arguments):
            calls.append(arguments)

    drawn_script["define_friction"](Recorder(), 3, "zinc", 1)
    drawn_script["define"](Recorder(), 4, "zinc", 1, run=2)
    assert calls[0] == ("VelDependent", 3, pytest.approx(72.0), pytest.approx(84.656, abs=1e-3), 0.104536)
    assert calls[1][:4] == ("Steel02", 4, 64.0, 12.0)
    slow, fast, rate = calls[0][2:]
    assert fast - (fast - slow) * np.exp(-rate * 9.5661) == pytest.approx(80.0, abs=1e-3)
    assert "os" not in drawn_script


def test_opensees_slides_a_drawn_device_at_its_speed(drawn_script):
    ops = opensees()
    for name, ((_, force_kN, _, _, at_rest),) in DRAWN.items():
        assert max(drawn_script["loop"](ops, name, 1, np.linspace(0, 60, 600))) == pytest.approx(force_kN, rel=0.02)
        for speed, share in ((9.5661, 1.0), (1e-3, at_rest)):
            assert slid(ops, drawn_script, name, speed) == pytest.approx(share * force_kN, rel=0.01)


def slid(ops, script, name, speed):
    """Force of a bearing element with the friction model, slid 30 mm at a speed under a normal force of 1 kN."""
    ops.wipe()
    ops.model("basic", "-ndm", 2, "-ndf", 3)
    for node in (1, 2):
        ops.node(node, 0.0, 0.0)
    ops.fix(1, 1, 1, 1)
    ops.fix(2, 0, 0, 1)
    script["define_friction"](ops, 1, name, 1)
    for material in (1, 2):
        ops.uniaxialMaterial("Elastic", material, 1e6)
    stiffness = script["DEVICES"][name, 1][2]
    ops.element("flatSliderBearing", 1, 1, 2, 1, stiffness, "-P", 1, "-Mz", 2, "-orient", 0, 1, 0, -1, 0, 0)
    ops.mass(2, 1e-9, 1e-9, 1e-9)
    steps, stroke = 300, 30.0
    step = stroke / speed / steps
    ops.timeSeries("Constant", 1)
    ops.pattern("Plain", 1, 1)
    ops.load(2, 0.0, -1.0, 0.0)
    ops.timeSeries("Linear", 2, "-factor", speed)
    ops.pattern("Plain", 2, 2)
    ops.sp(2, 1, 1.0)
    ops.setNodeVel(2, 1, speed, "-commit")
    ops.constraints("Penalty", 1e9, 1e9)
    ops.numberer("Plain")
    ops.system("BandGeneral")
    ops.test("NormDispIncr", 1e-8, 100)
    ops.algorithm("Newton")
    ops.integrator("Newmark", 0.5, 0.25)
    ops.analysis("Transient")
    assert ops.analyze(steps, step) == 0
    return abs(ops.eleForce(1)[0])
