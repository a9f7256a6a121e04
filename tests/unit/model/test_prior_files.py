"""Priors: true densities in both spaces, one-to-one maps, and files refused in words."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import quad

from shj_bayes._util.files import shipped
from shj_bayes.errors import PriorError
from shj_bayes.model.parameters import base_parameters
from shj_bayes.model.priors import LAWS, SCHEMA, Prior, read_priors, shipped_families

EXAMPLES = [
    Prior("gamma", "s/mm", "normal", 0.0, 0.02, "test"),
    Prior("size", "1", "cauchy", 0.01, 0.03, "test"),
    Prior("K", "kN/mm", "lognormal", 18.0, 0.7, "test"),
    Prior("phi", "1", "uniform", -1.0, 1.0, "test"),
    Prior("beta", "1", "loguniform", 1.0, 500.0, "test"),
]
LAW = [p.law for p in EXAMPLES]


def scipy_law(prior: Prior) -> stats.rv_continuous:
    """The law by its definition, not by the code under test."""
    return {
        "normal": stats.norm(prior.a, prior.b),
        "cauchy": stats.cauchy(prior.a, prior.b),
        "lognormal": stats.lognorm(prior.b, scale=prior.a),
        "uniform": stats.uniform(prior.a, prior.b - prior.a),
        "loguniform": stats.loguniform(prior.a, prior.b),
    }[prior.law]


def test_every_law_is_covered() -> None:
    assert sorted(LAW) == sorted(LAWS)


@pytest.mark.parametrize("prior", EXAMPLES, ids=LAW)
def test_density_integrates_to_one_in_both_spaces(prior: Prior) -> None:
    free, _ = quad(lambda z: float(np.exp(prior.log_density_free(np.array(z)))), -40, 40, points=[0.0], limit=200)
    assert free == pytest.approx(1.0, abs=1e-8)
    low, middle, high = scipy_law(prior).ppf([1e-3, 0.5, 1 - 1e-3])
    natural, _ = quad(lambda x: float(np.exp(prior.log_density(np.array(x)))), low, high, points=[middle], limit=200)
    assert natural == pytest.approx(1.0 - 2e-3, abs=1e-8)


@pytest.mark.parametrize("prior", EXAMPLES, ids=LAW)
def test_free_density_is_the_natural_one_with_its_jacobian(prior: Prior) -> None:
    z = np.linspace(-4, 4, 81)
    step = 1e-5
    slope = (prior.from_free(z + step) - prior.from_free(z - step)) / (2 * step)
    expected = scipy_law(prior).logpdf(prior.from_free(z)) + np.log(slope)
    np.testing.assert_allclose(prior.log_density_free(z), expected, atol=1e-7)


@pytest.mark.parametrize("prior", EXAMPLES, ids=LAW)
def test_there_and_back(prior: Prior) -> None:
    x = scipy_law(prior).ppf(np.linspace(0.001, 0.999, 101))
    np.testing.assert_allclose(prior.from_free(prior.to_free(x)), x, rtol=1e-12, atol=1e-15)
    z = np.linspace(-5, 5, 101)  # further out the upper end of a bounded law is near 1 to double precision
    np.testing.assert_allclose(prior.to_free(prior.from_free(z)), z, rtol=1e-9, atol=1e-9)
    assert np.all(np.diff(prior.from_free(z)) > 0)


@pytest.mark.parametrize("prior", EXAMPLES, ids=LAW)
def test_draws_have_the_quantiles(prior: Prior) -> None:
    draws = prior.distribution.rvs(20_000, random_state=np.random.default_rng(3))
    assert stats.kstest(draws, scipy_law(prior).cdf).pvalue > 1e-3
    # and drawing in the free space is drawing from the same law
    z = np.random.default_rng(4).standard_normal(20_000)
    assert stats.kstest(prior.from_free(z), scipy_law(prior).cdf).pvalue > 1e-3


@pytest.mark.parametrize("prior", EXAMPLES, ids=LAW)
def test_parameters_stay_where_the_law_has_mass(prior: Prior) -> None:
    """Up to the edge of the free space that the posterior admits."""
    low, high = scipy_law(prior).support()
    x = prior.from_free(np.array([-29.9999, 29.9999]))
    assert low <= x[0] < x[1] <= high


@pytest.mark.parametrize(
    ("law", "a", "b", "message"),
    [
        ("levy", 0.0, 1.0, "law 'levy' is not known; choose one of normal, cauchy, lognormal, uniform, loguniform"),
        ("cauchy", 0.0, 0.0, "prior of K: scale = 0; it must be above 0"),
        ("normal", 0.0, 0.0, "prior of K: sd = 0; it must be above 0"),
        ("normal", np.nan, 1.0, "both must be finite numbers"),
        ("lognormal", -1.0, 1.0, "prior of K: median = -1; it must be above 0"),
        ("loguniform", 0.0, 1.0, "prior of K: low = 0; it must be above 0"),
        ("lognormal", 1e-320, 1.0, "prior of K: median = 9.99989e-321; 0 or 1e-30 and above is allowed"),
        ("normal", 1.0, 1e-25, "cannot be told apart in double precision"),
        ("lognormal", 1.0, 1e-20, "cannot be told apart in double precision"),
        ("uniform", 2.0, 1.0, "prior of K: high = 1 must be above low = 2"),
    ],
)
def test_laws_that_are_none(law: str, a: float, b: float, message: str) -> None:
    with pytest.raises(PriorError, match=re.escape(message)):
        Prior("K", "kN/mm", law, a, b, "test")


# ---- files ----

GOOD = f"""schema = "{SCHEMA}"
family = "mine"
statement = "test"
[K]
unit = "kN/mm"
law = "lognormal"
median = 18.0
spread = 0.5
source = "test"
[gamma]
unit = "s/mm"
law = "normal"
mean = 0.0
sd = 0.02
source = "test"
"""


def test_good_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD)
    priors = read_priors(path)
    assert priors.family == "mine"
    assert priors.of("K").a == 18.0
    assert priors.of("K_2") is priors.of("K")
    assert len(priors.sha256) == 64
    with pytest.raises(PriorError, match=r"priors 'mine' hold no law for ratio_3; add a table \[ratio\]"):
        priors.of("ratio_3")


OLD_NOISE = """[sigma]
unit = "kN"
law = "lognormal"
median = 1.2
spread = 0.9
source = "test"
"""


def test_a_file_with_one_noise_scale_serves_for_both_parts(tmp_path: Path) -> None:
    """Files written before the noise had two parts; what one says itself goes before that."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD + OLD_NOISE)
    priors = read_priors(path)
    for name in ("sigma_white", "sigma_slow"):
        law = priors.of(name)
        assert (law.name, law.unit, law.law, law.a, law.b) == (name, "kN", "lognormal", 1.2, 0.9)
    assert priors.of("tau_slow").unit == "s"
    assert read_priors("afc").of("tau_slow").a == priors.of("tau_slow").a
    path.write_text(GOOD + OLD_NOISE + OLD_NOISE.replace("sigma", "sigma_slow").replace("1.2", "0.3"))
    assert [read_priors(path).of(name).a for name in ("sigma_white", "sigma_slow")] == [1.2, 0.3]
    path.write_text(GOOD)
    with pytest.raises(PriorError, match=r"hold no law for sigma_white; add a table \[sigma_white\]"):
        read_priors(path).of("sigma_white")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (SCHEMA, "shj-bayes/priors/9", "mine.toml: schema is 'shj-bayes/priors/9'; this version reads"),
        ("[K]", "[stiffness]", "mine.toml: [stiffness] is not a parameter; known are K, Fy, beta"),
        ('"lognormal"', '"levy"', "mine.toml: [K] law = 'levy'; choose one of normal, cauchy, lognormal"),
        ('law = "lognormal"', "", "mine.toml: [K] law = None"),
        ('"kN/mm"', '"kN/m"', "mine.toml: [K] unit = 'kN/m'; it must be 'kN/mm'"),
        ("median = 18.0", 'median = "18"', "mine.toml: [K] median = '18'; a lognormal law needs a number there"),
        ("median = 18.0", "median = true", "mine.toml: [K] median = True"),
        ("median = 18.0", "", "mine.toml: [K] median = None"),
        ("median = 18.0", "median = -18.0", "mine.toml: prior of K: median = -18; it must be above 0"),
        (
            "spread = 0.5",
            "spread = nan",
            "mine.toml: prior of K: ('median', 'spread') = 18.0, nan; both must be finite",
        ),
        ("spread = 0.5", "spread = 5.1", "mine.toml: [K] spread = 5.1; at most 5 is allowed"),
        ('source = "test"\n[gamma]', "[gamma]", "mine.toml: [K] has no source; say in one line"),
        ("mean = 0.0", "mean = 0.01", "mine.toml: [gamma] must be symmetric about 0"),
        ("sd = 0.02", "sd = 1e12", "mine.toml: [gamma] sd = 1e+12 s/mm; at most 10 is allowed"),
        ("[gamma]", "[gamma", "mine.toml is not valid TOML"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    path = tmp_path / "mine.toml"
    path.write_text(GOOD.replace(old, new, 1))
    with pytest.raises(PriorError, match=re.escape(message)):
        read_priors(path)


@pytest.mark.parametrize(("low", "high", "fine"), [(-0.1, 0.1, True), (-0.1, 0.2, False), (0.0, 0.1, False)])
def test_gamma_must_be_symmetric_about_no_dependence(tmp_path: Path, low: float, high: float, fine: bool) -> None:
    text = (
        GOOD.replace('"normal"', '"uniform"')
        .replace("mean = 0.0", f"low = {low}")
        .replace("sd = 0.02", f"high = {high}")
    )
    path = tmp_path / "mine.toml"
    path.write_text(text)
    if fine:
        assert read_priors(path).of("gamma").law == "uniform"
    else:
        with pytest.raises(PriorError, match="symmetric about 0"):
            read_priors(path)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ('[beta]\nunit = "1"\nlaw = "lognormal"\nmedian = 20.0\nspread = 1.0\nsource = "test"', "[beta]"),
        ('[beta]\nunit = "1"\nlaw = "uniform"\nlow = 0.5\nhigh = 10.0\nsource = "test"', "[beta]"),
        ('[phi]\nunit = "1"\nlaw = "normal"\nmean = 0.5\nsd = 0.2\nsource = "test"', "[phi]"),
        ('[sigma]\nunit = "kN"\nlaw = "normal"\nmean = 1.0\nsd = 0.5\nsource = "test"', "[sigma]"),
        ('[tau_slow]\nunit = "s"\nlaw = "normal"\nmean = 2.0\nsd = 1.0\nsource = "test"', "[tau_slow]"),
        ('[Fy]\nunit = "kN"\nlaw = "uniform"\nlow = -5.0\nhigh = 90.0\nsource = "test"', "[Fy]"),
    ],
)
def test_laws_with_mass_where_the_model_has_none(tmp_path: Path, table: str, message: str) -> None:
    """Else the sampler would step there and stop with an error in the middle of a fit."""
    path = tmp_path / "mine.toml"
    path.write_text(GOOD + table + "\n")
    with pytest.raises(PriorError, match=re.escape(f"mine.toml: {message}")):
        read_priors(path)


def test_missing_and_broken_files(tmp_path: Path) -> None:
    with pytest.raises(PriorError, match=r"cannot read none\.toml: No such file"):
        read_priors(tmp_path / "none.toml")
    with pytest.raises(PriorError, match="priors 'steel' do not ship with shj-bayes; choose one of afc, general"):
        read_priors("steel")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PriorError, match=r"binary\.toml is not valid TOML"):
        read_priors(binary)
    big = tmp_path / "big.toml"
    big.write_bytes(b"#" * 1_000_001)
    with pytest.raises(PriorError, match="1000001 bytes"):
        read_priors(big)


@pytest.mark.parametrize("family", ["afc", "general"])
def test_shipped_families_hold_every_parameter(family: str) -> None:
    assert family in shipped_families()
    priors = read_priors(family)
    assert set(priors.priors) == set(base_parameters())
    assert priors.statement
    for name, prior in priors.priors.items():
        assert (prior.name, prior.unit) == (name, base_parameters()[name].unit)


def test_afc_priors_allow_the_published_devices() -> None:
    """Every printed value of Tables 3-7 lies inside the central 99.8 % of its law."""
    values: dict[str, set[float]] = {}
    for number in range(3, 8):
        with shipped("data", "published", f"table{number}.csv").open(newline="", encoding="utf-8") as file:
            sliding: dict[str, float] = {}
            for row in csv.DictReader(file):
                name, value = row["quantity"], float(row["value"])
                if name == "Fy" and row["run"] == "1":
                    sliding[row["row"]] = value
                if name == "Fy" and row["run"] == "2":
                    name, value = "ratio", value / sliding[row["row"]]
                if name == "dep":
                    name, value = "gamma", 1 / value
                values.setdefault(name, set()).add(value)
    assert sorted(values) == ["Fy", "K", "beta", "gamma", "ratio"]
    priors = read_priors("afc")
    for name, seen in values.items():
        low, high = priors.of(name).distribution.ppf([0.001, 0.999])
        assert low < min(seen), name
        assert max(seen) < high, name
