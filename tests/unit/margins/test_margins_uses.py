"""What a designer does with the force of one connection, against numbers worked out by hand."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from shj_bayes.app.design import card_lines
from shj_bayes.errors import PopulationError
from shj_bayes.margins.basis import NONE, Bounds, DesignBasis, Environment, SlidingForceBounds
from shj_bayes.margins.codes.code import Given
from shj_bayes.margins.files import card_of, facts_of, write_margins
from shj_bayes.margins.sheet import agreement, margins
from shj_bayes.margins.spread import HIGH, LOW, MIDDLE
from shj_bayes.margins.uses import (
    BATCH_PASSES,
    FRICTION,
    LARGEST,
    MOMENT,
    PASSES,
    PER_BOLT,
    STOREY,
    SUM,
    TIGHTENED,
    WANTED_BOLTS,
    WANTED_CAPACITY,
    WANTED_CLAMPING,
    uses,
)
from shj_bayes.margins.virtual_test import over_amplitude
from shj_bayes.options import PLAIN, MarginOptions
from shj_bayes.population.device import NO_TAGS
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.predict import NewDevice
from shj_bayes.population.quantities import population_prior
from shj_bayes.population.readings import read_off
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.results.campaign import Connection

FORCE = SlidingForceBounds(72.0, 80.0, 90.0, 66.0, 52.0, 51.0, 97.0, Bounds(0.7, 1.2), 0.82, 97.0, 84.0)
BASIS = DesignBasis(80.0, "typical device", FORCE, Environment(NONE, NONE, "not tested"))
TESTED = Connection(bolts=2, surfaces=2, clamping_kN=95.0)
N = 40_000


def population_of(level_sd, spread):
    """Six devices of one set whose level (80 kN) is known to `level_sd` and which scatter by `spread` about it."""
    rng = np.random.default_rng(4)
    fits, draws = {}, {}
    for name in ("lowest", "highest", "third"):
        mu = np.log(80.0) + level_sd * rng.standard_normal((N, 1))
        tau = np.full((N, 1), spread)
        fits[name] = QuantityPosterior(name, mu, tau, np.ones((N, 4)), (6,))
        draws[name] = np.exp(mu[:, 0] + spread * rng.standard_normal(N))
    group = DeviceSet("A", tuple("123456"), NO_TAGS, {q: (math.log(80.0),) * 6 for q in fits})
    priors = {q: population_prior(q) for q in fits}
    return PopulationResult((group,), fits, {}, priors, {}, 5), {"default": NewDevice("A", 6, draws)}


def rows(request=PLAIN, level_sd=0.0, spread=0.1, connection=TESTED):
    result, devices = population_of(level_sd, spread)
    given = Given("A", {}, {}, dict.fromkeys(("lowest", "highest", "third"), 6), BASIS, request)
    return {(row.kind, row.side): row for row in uses(given, result, devices, connection)}


def test_connections_share_the_level_of_their_set_and_scatter_on_their_own():
    """Scatter alone, 0.1 about 80 kN: mean 80 exp(0.005) = 80.401, sd 80.401 sqrt(exp(0.01) - 1) = 8.060 kN.

    5 % of the sum of 20: 1608.0 - 1.6449 sqrt(20) 8.060 = 1548.7 kN. Largest: 0.95^(1/20) = 0.99744 of one device lie
    below, z = 2.7990: 80 exp(0.27990) = 105.84 kN; of one 80 exp(0.16449) = 94.30 kN. Level alone, 0.1: all devices of
    a delivery are alike, so the sum is 20 x 80 exp(-0.16449) = 1357.3 kN and the largest of 20 that of one.
    """
    asked = MarginOptions(connections=20)
    own, common = rows(asked), rows(asked, level_sd=0.1, spread=1e-6)
    assert own[SUM, LOW].value == pytest.approx(1548.7, rel=0.003)
    assert own[LARGEST, HIGH].value == pytest.approx(105.84, rel=0.006)
    assert rows(MarginOptions(connections=1))[LARGEST, HIGH].value == pytest.approx(94.30, rel=0.006)
    assert common[SUM, LOW].value == pytest.approx(1357.3, rel=0.006)
    assert common[LARGEST, HIGH].value == pytest.approx(94.30, rel=0.006)
    for row in (*own.values(), *common.values()):
        assert row.unit != "kN" or row.kind not in (SUM, LARGEST) or 0 < row.monte_carlo_error < 0.01 * row.value


def test_a_reliability_stands_in_the_place_of_95_per_cent():
    """EN 1990 beta = 1.5 is Phi(1.5) = 0.93319; of two connections 0.93319 of sums lie below 160.80 + 1.5 x 11.399."""
    asked = MarginOptions(connections=2, reliability="beta=1.5")
    assert asked.probability == pytest.approx(0.933193, abs=1e-6)
    row = rows(asked)[SUM, HIGH]
    assert row.value == pytest.approx(160.80 + 1.5 * 11.399, rel=0.006)
    assert MarginOptions(reliability="0.99").probability == 0.99


def test_a_tightening_tolerance_is_averaged_over_the_bolts():
    """V = 0.1 of one of two bolts: sqrt(ln(1 + 0.01 / 2)) = 0.07062 of a connection.

    With a scatter of 0.1: sqrt(0.1^2 + 0.07062^2) = 0.12242, 5 % at 80 exp(-1.6449 x 0.12242) = 65.41 kN.
    """
    found = rows(MarginOptions(clamping_cov=0.1))
    assert found[TIGHTENED, LOW].value == pytest.approx(65.41, rel=0.006)
    with pytest.raises(PopulationError, match="--clamping-cov needs the number of bolts of A"):
        rows(MarginOptions(clamping_cov=0.1), connection=Connection())


def test_force_of_a_bolt_friction_and_the_bolts_that_a_force_needs():
    """51 and 97 kN, 80 typical: over 2 x 2 12.75, 20, 24.25 kN; over 4 x 95 kN 0.1342, 0.2105, 0.2553.

    100 kN need 100 / 25.5 = 3.92, 4 bolts, which bring up to 4 x 48.5 = 194 kN, or 95 x 100 / 51 = 186.3 kN a bolt.
    """
    found = rows(MarginOptions(force_wanted_kN=100.0))
    per_bolt = [found[PER_BOLT, side].value for side in (LOW, MIDDLE, HIGH)]
    assert per_bolt == pytest.approx([12.75, 20.0, 24.25])
    assert [found[FRICTION, s].value for s in (LOW, MIDDLE, HIGH)] == pytest.approx(
        [0.13421, 0.21053, 0.25526], rel=1e-4
    )
    assert found[WANTED_BOLTS, LOW].value == 4
    assert found[WANTED_CAPACITY, HIGH].value == pytest.approx(194.0)
    assert found[WANTED_CLAMPING, LOW].value == pytest.approx(186.27, rel=1e-4)
    of_options = rows(MarginOptions(bolts=4, clamping_kN=95.0))
    assert of_options[PER_BOLT, LOW].value == pytest.approx(51.0 / 8.0)
    assert not {kind for kind, _ in rows(connection=Connection())} & {PER_BOLT, FRICTION}


def test_moment_and_storey_force():
    """Arm 0.6 m: 30.6, 48, 58.2 kNm. Brace at 35 deg, cos 0.81915: 41.78, 65.53, 79.46 kN."""
    moment, brace = rows(MarginOptions(lever_arm=600)), rows(MarginOptions(brace_angle_deg=35.0))
    assert [moment[MOMENT, s].value for s in (LOW, MIDDLE, HIGH)] == pytest.approx([30.6, 48.0, 58.2])
    assert [brace[STOREY, s].value for s in (LOW, MIDDLE, HIGH)] == pytest.approx([41.777, 65.532, 79.458], rel=1e-4)


def test_share_of_good_devices_and_deliveries_that_are_accepted():
    """Within 15 % of 80 kN, scatter 0.1: Phi(ln 1.15 / 0.1) - Phi(ln 0.85 / 0.1) = 0.91888 - 0.05206 = 0.8668.

    Four at once: 0.8668^4 = 0.5646; where only the level is unknown, all four or none.
    """
    asked = MarginOptions(connections=4)
    own, common = rows(asked), rows(asked, level_sd=0.1, spread=1e-6)
    assert own[PASSES, LOW].value == pytest.approx(0.8668, abs=0.006)
    assert own[BATCH_PASSES, LOW].value == pytest.approx(0.5646, abs=0.01)
    assert common[BATCH_PASSES, LOW].value == pytest.approx(0.8668, abs=0.006)


def test_stiffness_and_damping_over_the_amplitude(trials):
    """Elastic-plastic, 80 kN and 16 kN/mm: at 50 mm k = 1.6 kN/mm, E = 4 x 80 (50 - 5) = 14.4 kJ.

    Damping 14400 / (2 pi 1.6 x 50^2) = 0.5730; at 20 mm k = 4, E = 4.8 kJ, 4800 / (2 pi 4 x 400) = 0.4775.
    """
    blocks = tuple(Block(a, 0.02, 3) for a in (20.0, 50.0))
    _, motion = exact_motion(blocks, 200.0)
    x, force = motion.displacement_mm, np.zeros(motion.displacement_mm.size)
    for i in range(1, x.size):
        force[i] = np.clip(force[i - 1] + 16.0 * (x[i] - x[i - 1]), -80.0, 80.0)
    own = read_off(force[None], motion, motion.travel_mm / 1000.0)
    points = over_amplitude([replace(trials[0], own=(own, own))])
    assert [(p.run, round(p.amplitude_mm)) for p in points] == [(1, 20), (1, 50), (2, 20), (2, 50)]
    assert [p.stiffness_kN_mm[1] for p in points[:2]] == pytest.approx([4.0, 1.6], rel=0.01)
    assert [p.damping[1] for p in points[:2]] == pytest.approx([0.4775, 0.5730], rel=0.02)


@pytest.fixture(scope="module")
def sheet(design, trials):
    asked = MarginOptions(sets=("Zinc 70",), connections=4, lever_arm=0.6, reliability="0.9")
    return margins(design, trials, asked, connections={"Zinc 70": replace(TESTED, slot_mm=220.0, bolt_mm=16.0)})


def test_the_card_says_what_it_is_what_it_holds_for_and_which_row_serves_which_clause(sheet):
    (name,) = sheet.spoken
    facts = dict(facts_of(sheet, name))
    assert facts["ONE connection"].startswith("2 bolts M16, 2 sliding surfaces, clamped with 95 kN a bolt, slot 220 mm")
    assert facts["tested"].startswith("slip of 5.94 to 95 mm, cycles of 9.8 to 10.2 mm/s")
    assert facts["holds for"].startswith("90 % of new devices at every speed from standstill to 10.2 mm/s")
    lines = {use: values for use, _, values in card_of(sheet, name)}
    assert next(iter(lines)) == "all events: use these two"
    assert lines["second event"][LOW].value == sheet.by_key["Zinc 70", "force", "in a second event", LOW].value
    assert lines["ASCE 7: two analyses"][HIGH].kind == "ASCE 7 upper bound force"
    assert lines["EN 15129: LBDP, UBDP"][LOW].kind == "EN 15129 LBDP, importance class II"
    assert lines["EN 1990: X_k"][LOW].quantity == "lowest"
    text = "\n".join(card_lines(sheet))
    assert "slip amplitude, mm" in text
    assert "90 % of new devices" in text


def test_bounds_of_another_reliability_lie_on_their_side_of_the_bands(design, trials, sheet):
    """90 % is nearer than 95 %, 99 % farther; nothing contradicts either way, and a wrong one is still found."""
    by_level = [
        margins(design, trials, MarginOptions(sets=("Zinc 70",), reliability=p)).by_key for p in ("0.9", "0.95", "0.99")
    ]
    for kind, side, sign in (("for drift and displacement", LOW, 1), ("for capacity design", HIGH, -1)):
        values = [sign * found["Zinc 70", "force", kind, side].value for found in by_level]
        assert values == sorted(values, reverse=True)
    assert "None contradict" in agreement(sheet.rows, 0.9)[0]
    wrong = [replace(r, value=4 * r.value) if r.kind == "for drift and displacement" else r for r in sheet.rows]
    assert agreement(wrong, 0.9)[1]


def test_the_first_sheet_of_the_workbook_is_the_card_with_the_factors_of_the_codes(sheet, tmp_path):
    write_margins(sheet, tmp_path)
    book = pd.read_excel(tmp_path / "margins.xlsx", sheet_name=None)
    assert next(iter(book)) == "Cards"
    card = book["Cards"]
    assert {"4 connections together", "moment at the joint", "lambda_test,min", "nominal"} <= set(card["use"])
    record = json.loads((tmp_path / "margins.json").read_text(encoding="utf-8"))
    assert record["reliability"] == 0.9
    assert record["cards"][0]["use"] == "all events: use these two"
    curve = pd.read_csv(tmp_path / "margins-amplitude.csv")
    assert set(curve["run"]) == {1, 2}
    assert (curve["damping_q50"] < 1).all()
