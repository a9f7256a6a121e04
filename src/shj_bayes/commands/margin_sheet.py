"""The margins of a folder: drawn up, or as they stand where nothing that they rest on changed."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from shj_bayes._util.files import file_digest, need_population
from shj_bayes.commands.finished import Done
from shj_bayes.margins.request import PLAIN, Request
from shj_bayes.results.campaign import CampaignRecord, read_campaign
from shj_bayes.results.codec import to_json
from shj_bayes.results.store import digests, has, made

POPULATION = ("population.csv", "population.json", "population.npz")
PAGE = "margins.html"
MARGINS = ("margins.csv", "margins.xlsx", "margins.json", "margins-devices.csv", "loops.csv", PAGE)


def design_margins(folder: Path, request: Request = PLAIN, *, progress: bool = False) -> Done:
    """Draw up and write the margins of a folder that ``campaign`` or ``tables`` wrote.

    `PopulationError` if a set that was asked for is not there, or a cycle was not tested; nothing is written then.
    """
    need_population(folder)

    def draw_up() -> dict[str, Any]:
        # Virtual tests, codes and pictures need most of scipy, which margins that stand need not load.
        from shj_bayes.commands.design import drawn_up  # noqa: PLC0415

        return drawn_up(folder, request, progress=progress)

    chosen = asdict(request)
    if request.history is not None:
        chosen["history"] = [str(request.history), file_digest(request.history)]
    rests_on = [chosen, digests(folder, POPULATION), campaign_inputs(folder)]
    return Done(**made(folder, "margins", rests_on, MARGINS, draw_up))


def campaign_inputs(folder: Path) -> dict[str, Any]:
    """Give all that the pages of a campaign rest on: what ``campaign.json`` says, and the files of its devices.

    A device that was kept is one that was done. The published tables have no devices.
    """
    if not has(CampaignRecord, folder):
        return {}
    record = read_campaign(folder)
    files = {device.folder: digests(folder, [f"{device.folder}/**/*"]) for _, device in record.devices}
    content = to_json(replace(record, digest=""))
    for device in (device for group in content["sets"] for device in group["devices"]):
        device["status"] = {"kept": "done"}.get(device["status"], device["status"])
    return {"campaign": content, "files": files}
