import numpy as np
import pytest
from made_devices import table_device

from shj_bayes.population.device import Tags
from shj_bayes.population.hierarchy import fit_population

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
