"""Write the JSON Schemas of the files of results, from the records that they are read into."""

import json
from pathlib import Path
from typing import Any

from shj_bayes.planning.files import PlanRecord
from shj_bayes.population.results import PopulationRecord
from shj_bayes.results.campaign import CampaignRecord
from shj_bayes.results.codec import schema_of
from shj_bayes.results.diagnosis import DiagnosisRecord, LeftOver
from shj_bayes.results.fit import FitRecord, SummaryRecord

RECORDS: tuple[Any, ...] = (
    *(FitRecord, SummaryRecord, LeftOver, DiagnosisRecord, CampaignRecord, PopulationRecord, PlanRecord),
)


def texts() -> dict[str, str]:
    """Text of each schema by the name of its file."""
    out = {}
    for kind in RECORDS:
        described = {"title": kind.__doc__.splitlines()[0].replace("`", "").rstrip(".")} | schema_of(kind)
        out[kind.FILE.replace(".json", ".schema.json")] = json.dumps(described, indent=1) + "\n"
    return out


if __name__ == "__main__":
    for name, text in texts().items():
        (Path(__file__).parent / name).write_text(text, encoding="utf-8")
