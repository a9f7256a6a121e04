"""End of a campaign: what became of its devices, and what they say together; worked out again only where it changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from shj_bayes._util.lock import alone_in
from shj_bayes._util.made import made
from shj_bayes.commands.campaign import FAILED, Manifest, Outcome
from shj_bayes.commands.margin_sheet import MARGINS, PAGE, POPULATION, campaign_inputs
from shj_bayes.report.campaign_file import read_campaign
from shj_bayes.report.campaign_physics import statements

WRITES = (*POPULATION, *MARGINS, "comparison-curves.csv", "report.html")


@dataclass(frozen=True, eq=False)
class Summary:
    """End of a campaign or of the tables."""

    record: dict[str, Any]  # for machines
    text: str  # for people; ends with where the page is
    usable: bool = True  # False when no device could be used


@alone_in("folder")
def summarise_campaign(
    manifest: Manifest, outcomes: Sequence[Outcome], folder: Path, *, seed: int, progress: bool = False
) -> Summary:
    """Pool the usable devices of a campaign and write its page.

    Parameters
    ----------
    manifest : Manifest
        The campaign.
    outcomes : sequence of Outcome
        What became of each device.
    folder : Path
        Campaign folder.
    seed : int
        Same seed and devices, same numbers.
    progress : bool
        Show a progress bar.
    """
    usable = [o for o in outcomes if o.status != FAILED and o.verdict != "unusable"]
    record = read_campaign(folder)
    lines = [*map(_line, outcomes), *record["warnings"], *statements(record)]

    def pool() -> dict[str, Any]:
        # Population, margins and pictures need most of scipy, which a campaign in which nothing changed need not load.
        from shj_bayes.commands.pooled import pooled_campaign  # noqa: PLC0415

        return pooled_campaign(usable, folder, seed=seed, progress=progress)

    who = [(o.device.folder, o.device.name, o.device.set_name, asdict(o.device.tags)) for o in usable]
    said = made(folder, "summary", [seed, who, campaign_inputs(folder)], WRITES, pool)
    if usable:
        lines += ["", *said["lines"], "", f"margins: {folder / PAGE}"]
    return Summary(record | said["record"], "\n".join([*lines, f"report: {folder / 'report.html'}"]), bool(usable))


def _line(o: Outcome) -> str:
    """Say what became of a device."""
    parts = [o.status, o.verdict or o.reason]
    if o.diagnosis not in ("", "off"):
        parts.append(f"{o.diagnosis}{f' ({o.diagnosis_reason})' if o.diagnosis_reason else ''}")
    if o.with_set:
        parts.append(f"with what its set has: {o.with_set}{f' ({o.with_set_reason})' if o.with_set == FAILED else ''}")
    return f"{o.device.set_name}, {o.device.name}: {', '.join(parts)}"
