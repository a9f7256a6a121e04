from dataclasses import replace

import pytest

from shj_bayes.population.device import DeviceEstimate, Tags
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.measurement import Rounded
from shj_bayes.population.tested import PUBLISHED


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
