from dataclasses import replace

import pytest
from made_devices import table_device

from shj_bayes.margins.sheet import pool
from shj_bayes.margins.specimen import specimens_of_table
from shj_bayes.margins.virtual_test import virtual_tests
from shj_bayes.population.device import PUBLISHED, Tags
from shj_bayes.population.hierarchy import fit_population

ZINC = Tags("zinc", 70.0, material="Bisalloy 500")
RUSTY = Tags("zinc", 70.0, corroded=True, material="Bisalloy 500")
DEVICES = (
    table_device("1", "Zinc 70", 10, 90, 60, -90, ZINC),
    table_device("2", "Zinc 70", 13, 95, 70, -60, ZINC),
    table_device("1", "Zinc 70 corroded", 18, 70, 60, 90, RUSTY),
    table_device("2", "Zinc 70 corroded", 18, 75, 65, 60, RUSTY),
    table_device("x", "=cmd|'<b>", 18, 70, 50, 60, Tags(material="Brass")),
)
LABEL = "=cmd|'<b>"


@pytest.fixture(scope="session")
def devices():
    return DEVICES


@pytest.fixture(scope="session")
def population():
    return replace(fit_population(DEVICES, seed=3), tested=PUBLISHED)


@pytest.fixture(scope="session")
def trials(population):
    return virtual_tests(specimens_of_table(population), None)


@pytest.fixture(scope="session")
def design(trials, population):
    return pool(trials, population)
