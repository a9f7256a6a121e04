"""End of a campaign: what became of its devices, and what they say together; worked out again only where it changed."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from shj_bayes._util.files import make_writable
from shj_bayes._util.lock import alone_in
from shj_bayes._util.made import digests, made
from shj_bayes._util.shipped import shipped
from shj_bayes.commands.campaign import FAILED, Outcome
from shj_bayes.commands.finished import Done
from shj_bayes.commands.margin_sheet import MARGINS, PAGE, POPULATION, campaign_inputs
from shj_bayes.population.device import Claim
from shj_bayes.report.campaign_physics import statements
from shj_bayes.results.campaign import read_campaign
from shj_bayes.results.codec import to_json
from shj_bayes.results.fit import Trust

WRITES = (*POPULATION, *MARGINS, "comparison-curves.csv", "report.html")


@alone_in("folder")
def summarise_campaign(outcomes: Sequence[Outcome], folder: Path, *, seed: int, progress: bool = False) -> Done:
    """Pool the usable devices of a campaign and write its page; the same seed and devices, the same numbers."""
    usable = [o for o in outcomes if o.status != FAILED and o.verdict != Trust.UNUSABLE]
    record = read_campaign(folder)
    lines = [*map(_line, outcomes), *record.warnings, *statements(record.together)]

    def pool() -> dict[str, Any]:
        # Population, margins and pictures need most of scipy, which a campaign in which nothing changed need not load.
        from shj_bayes.commands.pooled import pooled_campaign  # noqa: PLC0415

        return pooled_campaign(usable, folder, seed=seed, progress=progress)

    who = [(o.device.folder, o.device.name, o.device.set_name, asdict(o.device.tags)) for o in usable]
    said = made(folder, "summary", [seed, who, campaign_inputs(folder)], WRITES, pool)
    if usable:
        lines += ["", *said["lines"], "", f"margins: {folder / PAGE}"]
    text = "\n".join([*lines, f"report: {folder / 'report.html'}"])
    return Done(to_json(record) | said["record"], text, usable=bool(usable))


@alone_in("folder")
def summarise_tables(folder: Path, claims: Sequence[Claim], *, seed: int, progress: bool = False) -> Done:
    """Pool the published tables and write their page with the paper's claims; as for `summarise_campaign`."""
    make_writable(folder)

    def pool() -> dict[str, Any]:
        from shj_bayes.commands.pooled import pooled_tables  # noqa: PLC0415  (as above)

        return pooled_tables(claims, folder, seed=seed, progress=progress)

    rests_on = [seed, digests(shipped("data", "published"), ["*"]), [vars(claim) for claim in claims]]
    said = made(folder, "tables", rests_on, (*POPULATION, *MARGINS, "report.html"), pool)
    where = [f"margins: {folder / PAGE}", f"report: {folder / 'report.html'}"]
    return Done(said["record"], "\n".join([*said["lines"], "", *where]))


def _line(o: Outcome) -> str:
    """Say what became of a device."""
    parts = [o.status, o.verdict or o.reason]
    if o.diagnosis not in ("", "off"):
        parts.append(f"{o.diagnosis}{f' ({o.diagnosis_reason})' if o.diagnosis_reason else ''}")
    if o.with_set:
        parts.append(f"with what its set has: {o.with_set}{f' ({o.with_set_reason})' if o.with_set == FAILED else ''}")
    return f"{o.device.set_name}, {o.device.name}: {', '.join(parts)}"
