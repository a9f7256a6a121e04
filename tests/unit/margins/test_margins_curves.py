"""Whether two sets have the same curve over a coordinate."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.margins.curves import compare_curves, content, log_factors
from shj_bayes.margins.specimen import Belief, Specimen
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.history import histories
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import NO_TAGS
from shj_bayes.population.hierarchy import DeviceSet, PopulationResult
from shj_bayes.recording.motion import exact_motion, table_1
from shj_bayes.report.figures.population import apart
from shj_bayes.report.sets import curve_words

TIME, MOTION = exact_motion(table_1(), 10.0)
HISTORIES = histories([TIME], [MOTION])
DRAWS = 16


def specimen(set_name, name, gamma=0.0, seed=0, **effects):
    """Make a device of 80 kN with gamma known to 0.0005 s/mm, and effects of a size that is known to 2 %."""
    model = DeviceModel(1, read_priors(), effects=effects_named(tuple(effects)))
    rng = np.random.default_rng(seed)
    values = {"K": 18.0, "Fy": 80.0, "beta": 15.0, **{f"{e}.size": size for e, size in effects.items()}}
    theta = np.array([[values.get(n, 1.0) for n in model.names]] * DRAWS)
    theta[:, model.names.index("gamma")] = gamma + 0.0005 * rng.standard_normal(DRAWS)
    for effect in effects:
        theta[:, model.names.index(f"{effect}.size")] *= 1.0 + 0.02 * rng.standard_normal(DRAWS)
    return Specimen(name, set_name, (Belief(model, theta),), HISTORIES, (0.0,))


def population(*names):
    groups = tuple(DeviceSet(name, ("1", "2", "3"), NO_TAGS, {}) for name in names)
    return PopulationResult(groups, {}, {}, {}, {}, 1)


def test_factors_are_those_of_the_law_and_of_what_was_found():
    at = np.array([0.5, 5.0, 9.5])
    one = specimen("a", "1", 0.02, wear=0.06)
    gamma = one.beliefs[0].theta[:, one.beliefs[0].model.names.index("gamma")]
    assert log_factors(one, coordinate_named("speed"), at) == pytest.approx(np.log1p(gamma[:, None] * at))
    size = one.beliefs[0].theta[:, one.beliefs[0].model.names.index("wear.size")]
    slid, worn = at / 5, -size[:, None] * at / 5
    assert log_factors(one, coordinate_named("travel"), slid) == pytest.approx(worn, rel=5e-3, abs=1e-5)
    assert np.all(log_factors(specimen("a", "1", 0.02), coordinate_named("travel"), at) == 0)


def test_curves_that_differ_and_curves_that_do_not():
    """+0.02 s/mm against -0.01 s/mm: 1.204 / 0.898 - 1 = 34 % at 10.2 mm/s, from 0."""
    devices = [
        specimen(set_name, str(i), level + 0.001 * i, seed=i)
        for set_name, level in (("coated", 0.018), ("bare", -0.012), ("other", -0.012))
        for i in (1, 2, 3)
    ]
    result = population("coated", "bare", "other")
    (found,) = compare_curves(result, devices, "coated", "bare", rope=0.1)
    assert (found.coordinate, found.n_a, found.n_b) == ("speed", 3, 3)
    assert found.at == pytest.approx([2.6, 5.2, 7.7, 10.2], abs=0.05)
    low, middle, high = found.percent[-1]
    assert middle == pytest.approx(34.1, abs=2.5)
    assert low < middle < high
    assert found.probability_other > 0.95
    assert found.probability_rope < 0.05
    (same,) = compare_curves(result, devices, "other", "bare", rope=0.1)
    assert same.probability_other < 0.5
    assert same.probability_rope > 0.9
    assert all(low < 0 < high for low, _, high in same.percent)
    assert compare_curves(result, devices, "coated", "bare", rope=0.1) == (found,)
    assert [row["at"] for row in found.rows()] == list(found.at)
    assert "coated over bare along the speed" in curve_words(found)
    assert apart(found).startswith("data:image/svg")


def test_a_coordinate_is_compared_where_both_sides_hold_it():
    devices = [specimen(s, str(i), wear=0.06) for s in ("a", "b") for i in (1, 2, 3)]
    found = compare_curves(population("a", "b"), devices, "a", "b", rope=0.1)
    assert [c.coordinate for c in found] == ["speed", "travel"]
    alone = [d if d.set_name == "a" else specimen("b", d.name) for d in devices]
    assert [c.coordinate for c in compare_curves(population("a", "b"), alone, "a", "b", rope=0.1)] == ["speed"]
    assert compare_curves(population("a", "b"), devices[:3], "a", "b", rope=0.1) == ()


def test_ranges_that_do_not_meet_are_not_compared():
    later = histories([TIME] * 2, [MOTION] * 2)[1]
    devices = [specimen(s, str(i), wear=0.06) for s in ("a", "b") for i in (1, 2, 3)]
    devices = [replace(d, histories=(later,)) if d.set_name == "b" else d for d in devices]
    assert [c.coordinate for c in compare_curves(population("a", "b"), devices, "a", "b", rope=0.1)] == ["speed"]


def test_content_of_the_region_that_leaves_no_difference_out():
    """Two values that go together: normal, mean m, standard deviation 1; beyond m = 1.645 lies 0 in 10 %."""
    one = np.random.default_rng(1).standard_normal(40_000)
    assert content(np.column_stack([one, one]) + 1.645) == pytest.approx(0.90, abs=0.01)
    assert content(np.column_stack([one, one])) < 0.02
