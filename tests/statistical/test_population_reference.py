"""The hierarchy against a joint fit with NUTS in numpyro; device values are sampled too, except rounded ones."""

import numpy as np
import pytest

from shj_bayes.population.hierarchy import fit_quantity
from shj_bayes.population.quantities import QuantityLikelihood, population_prior, quantity, rounded, to_step

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
FY = quantity("Fy")
PRIOR = population_prior("Fy")
LEVELS = (0.05, 0.5, 0.95)


def rounded_pairs():
    """The published pairs: 10 sets of two forces printed to 5 kN, six of them identical to the digit."""
    pairs = ((95, 95), (90, 90), (50, 75), (90, 90), (90, 50), (65, 60), (55, 55), (85, 22), (72, 72), (75, 75))
    return [[rounded("Fy", to_step(v, 5.0)) for v in pair] for pair in pairs]


def known_devices():
    """Five sets of three devices, each known to 5 %, spreads between 0.1 and 0.4."""
    rng = np.random.default_rng(71)
    centres = rng.normal(np.log(80), 0.3, 5)[:, None] + np.geomspace(0.1, 0.4, 5)[:, None] * rng.standard_normal((5, 3))
    return [[QuantityLikelihood(False, np.array([c]), np.array([0.05]), np.ones(1)) for c in row] for row in centres]


def unequal_numbers():
    """Sets of one, two, four and eight devices, some known badly."""
    rng = np.random.default_rng(72)
    out = []
    for n in (1, 2, 4, 8):
        values = rng.normal(np.log(70), 0.2) + 0.15 * rng.standard_normal(n)
        out.append(
            [
                QuantityLikelihood(False, np.array([v]), np.array([s]), np.ones(1))
                for v, s in zip(values, rng.uniform(0.02, 0.3, n), strict=True)
            ]
        )
    return out


def joint_fit(sets):
    """Quantiles of a new device of every set from NUTS on the joint model."""
    numpyro = pytest.importorskip("numpyro", reason="numpyro is not installed (pip install -e .[nuts])")
    jax = pytest.importorskip("jax")
    import jax.numpy as jnp  # noqa: PLC0415
    from jax.scipy.special import log_ndtr  # noqa: PLC0415
    from numpyro import distributions as dist  # noqa: PLC0415
    from numpyro.infer import MCMC, NUTS  # noqa: PLC0415

    numpyro.enable_x64()
    owner = np.repeat(np.arange(len(sets)), [len(s) for s in sets])
    devices = [d for s in sets for d in s]
    first, second = (np.array([getattr(d, name)[0] for d in devices]) for name in ("first", "second"))
    uniform = devices[0].pieces

    def model():
        level = numpyro.sample("level", dist.Normal(PRIOR.centre, PRIOR.centre_sd))
        between = numpyro.sample("between", dist.FoldedDistribution(dist.StudentT(4.0, 0.0, PRIOR.between_scale)))
        log_tau0 = numpyro.sample("log_tau0", dist.Normal(np.log(PRIOR.spread_median), PRIOR.spread_log_sd))
        omega = numpyro.sample("omega", dist.HalfNormal(PRIOR.unequal_scale))
        with numpyro.plate("sets", len(sets)):
            mu = level + between * numpyro.sample("mu_z", dist.Normal())
            tau = jnp.exp(log_tau0 + omega * numpyro.sample("tau_z", dist.Normal()))
        numpyro.deterministic("mu", mu)
        numpyro.deterministic("tau", tau)
        if uniform:
            # Sampled inside their interval, devices that agree to the digit make a funnel that NUTS takes hours for.
            a, b = (first - mu[owner]) / tau[owner], (second - mu[owner]) / tau[owner]
            a, b = jnp.where(a > 0, -b, a), jnp.where(a > 0, -a, b)
            upper = log_ndtr(b)
            numpyro.factor("devices", (upper + jnp.log1p(-jnp.exp(log_ndtr(a) - upper))).sum())
        else:
            value = mu[owner] + tau[owner] * numpyro.sample("z", dist.Normal().expand([len(devices)]).to_event(1))
            numpyro.sample("seen", dist.Normal(value, second).to_event(1), obs=first)

    kernel = NUTS(model, target_accept_prob=0.95)
    mcmc = MCMC(kernel, num_warmup=1000, num_samples=1500, num_chains=4, chain_method="sequential", progress_bar=False)
    mcmc.run(jax.random.PRNGKey(5))
    drawn = mcmc.get_samples()
    rng = np.random.default_rng(6)
    new = rng.normal(np.asarray(drawn["mu"]), np.asarray(drawn["tau"]))
    return np.quantile(new, LEVELS, axis=0)


@pytest.mark.parametrize("case", [rounded_pairs, known_devices, unequal_numbers], ids=lambda f: f.__name__)
def test_new_devices_agree_with_a_joint_fit(case):
    sets = case()
    reference = joint_fit(sets)
    fit = fit_quantity("Fy", sets, PRIOR, np.random.SeedSequence(4))
    ours = np.quantile(np.random.default_rng(7).normal(fit.mu, fit.tau), LEVELS, axis=0)
    # Monte-Carlo error of a 5 % quantile with about 1000 effective draws is 0.06 of the width of the band.
    width = reference[2] - reference[0]
    assert np.all(np.abs(ours - reference) < 0.08 * width + 0.01)
    wrong = np.quantile(fit.mu, LEVELS, axis=0)  # the level alone, spread forgotten, must be told apart
    assert not np.all(np.abs(wrong - reference) < 0.08 * width + 0.01)
