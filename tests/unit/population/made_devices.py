"""Devices as the published tables state them, for the tests of population and margins."""

from shj_bayes.population.device import DeviceEstimate, Tags
from shj_bayes.population.quantities import gamma_of_dep, ratio_of, rounded, to_decade, to_step


def table_device(name, set_name, K, Fy, second, dep, tags=None):
    printed = {
        "K": to_step(K, 1.0),
        "Fy": to_step(Fy, 5.0),
        "gamma": gamma_of_dep(dep, 30.0),
        "beta": to_decade(10.0),
    }
    known = {q: rounded(q, one) for q, one in printed.items()}
    known["ratio"] = ratio_of(to_step(second, 5.0), printed["Fy"])
    return DeviceEstimate(name, set_name, known, tags or Tags())
