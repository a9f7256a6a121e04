"""The paper's tables, as files and as devices."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from shj_bayes._util.files import shipped
from shj_bayes.errors import PopulationError
from shj_bayes.population.device import DeviceEstimate, Tags
from shj_bayes.population.measurement import Rounded

DEVICE_TABLES = (3, 4, 5, 6, 7)
Value = float | int | tuple[float, ...] | tuple[int, ...]


class Holding(StrEnum):
    """Whether the tables of the paper bear out what its text says."""

    YES = "holds"
    PARTLY = "holds in part"
    NO = "does not hold"
    OPEN = "not settled"


@dataclass(frozen=True)
class Claim:
    """One statement of the paper against its own numbers."""

    id: str  # short name
    claim: str  # what the paper says, in our words
    verdict: Holding  # what its tables say
    values: Mapping[str, Value]  # the figures behind the verdict
    sentence: str  # the same in plain words


@dataclass(frozen=True)
class PublishedRow:
    """One device row of Tables 3-7."""

    table: int  # 3 to 7
    row: str  # as printed, tidied
    set_name: str  # the set it belongs to
    tags: Tags  # material, coating, coverage, corroded
    values: Mapping[tuple[str, int], float]  # K kN/mm, Fy kN, beta 1, dep mm/s; runs 1 and 2
    steps: Mapping[str, float]  # rounding step per quantity; decades for beta

    @property
    def ratio(self) -> float:
        """Sliding force of the second run over that of the first, as printed."""
        return self.values["Fy", 2] / self.values["Fy", 1]

    @property
    def gamma(self) -> float:
        """1/dep, s/mm, as printed."""
        return 1.0 / self.values["dep", 1]

    def device(self) -> DeviceEstimate:
        """Turn the row into a device whose values are known up to their rounding."""
        value, step = self.values, self.steps
        printed = {
            "K": Rounded.to_step(value["K", 1], step["K"]),
            "Fy": Rounded.to_step(value["Fy", 1], step["Fy"]),
            "gamma": Rounded.gamma_of_dep(value["dep", 1], step["dep"]),
            "beta": Rounded.to_decade(value["beta", 1], step["beta"]),
        }
        second = Rounded.to_step(value["Fy", 2], step["Fy"])
        return DeviceEstimate.from_table(f"T{self.table} {self.row}", self.set_name, printed, second, self.tags)


def read_table(number: int) -> list[dict[str, str]]:
    """Rows of ``data/published/table<number>.csv``, cells as text by column; `PopulationError` where there is none."""
    if number not in range(1, 8):
        raise PopulationError(f"the paper has Tables 1 to 7, not {number}")
    with shipped("data", "published", f"table{number}.csv").open(encoding="utf-8", newline="") as handle:
        return list(csv.DictReader(handle))


def published_rows() -> tuple[PublishedRow, ...]:
    """Return the 25 device rows of Tables 3-7; rows that repeat another table are left out."""
    rows = []
    for number in DEVICE_TABLES:
        by_row: dict[str, list[dict[str, str]]] = {}
        for line in read_table(number):
            if not line["repeats_table"]:
                by_row.setdefault(line["row"], []).append(line)
        for row, lines in by_row.items():
            head = lines[0]
            coverage = head["coverage_percent"]
            rows.append(
                PublishedRow(
                    number,
                    row,
                    head["set"],
                    Tags(
                        coating=head["coating"],
                        coverage_percent=float(coverage) if coverage else None,
                        corroded=head["corroded"] == "true",
                        material=head["material"],
                    ),
                    {(line["quantity"], int(line["run"])): float(line["value"]) for line in lines},
                    {line["quantity"]: float(line["rounding_step"]) for line in lines},
                )
            )
    return tuple(rows)


def published_devices() -> tuple[DeviceEstimate, ...]:
    """Return the 25 devices of Tables 3-7, each value known up to its rounding.

    Five sets of one device (shim materials, Table 3), five of two (coatings, Tables 4 and 5) and five of
    two (corroded coatings, Tables 6 and 7).
    """
    return tuple(row.device() for row in published_rows())
