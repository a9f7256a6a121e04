import numpy as np
import pytest

from shj_bayes.population.device import DeviceEstimate, Tags
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.measurement import Rounded


def table_device(name, set_name, K, Fy, second, dep, tags=None):
    return DeviceEstimate.from_table(
        name,
        set_name,
        K=Rounded.to_step(K, 1.0),
        Fy=Rounded.to_step(Fy, 5.0),
        Fy_second=Rounded.to_step(second, 5.0),
        gamma=Rounded.gamma_of_dep(dep, 30.0),
        beta=Rounded.to_decade(10.0),
        tags=tags or Tags(),
    )


DEVICES = (
    table_device("a1", "Zinc 70", 10, 90, 60, -90),
    table_device("a2", "Zinc 70", 13, 90, 70, -60),
    table_device("b1", "=cmd|' /C calc'!A0", 8, 50, 20, 30, Tags("alkyd", 100.0)),
    table_device("b2", "=cmd|' /C calc'!A0", 12, 75, 45, -60, Tags("alkyd", 100.0)),
    table_device("c1", "Brass", 18, 70, 50, 30),
)


@pytest.fixture(scope="session")
def devices():
    return DEVICES


@pytest.fixture(scope="session")
def result(devices):
    return fit_population(devices, seed=3)


@pytest.fixture
def rng():
    return np.random.default_rng(20)
