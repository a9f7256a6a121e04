"""``campaign.json`` read back: what it holds is checked, and its device folders lie in the campaign's."""

import os
import re
from pathlib import Path
from typing import Any

from shj_bayes._util.files import check_seal, read_json
from shj_bayes.errors import ReportError, shown

WITH_SET = "with-set"  # in the folder of a device: its fit with its set's physics
WORDS = (  # of a device; all are texts
    "name", "folder", "status", "reason", "verdict", "diagnosis", "diagnosis_reason", "with_set", "with_set_reason"
)  # fmt: skip


def read_campaign(folder: Path) -> dict[str, Any]:
    """Read the record of a campaign: name, simulated, sets with devices.

    `ReportError` if it is missing, altered or damaged, or names a folder that is not one below the campaign's.
    """
    path = folder / "campaign.json"
    record = read_json(path, ReportError)
    check_seal(record, path, ReportError)
    advice = "restore it, or run shj-bayes campaign again"
    try:
        places = [
            {word: _text(device.get(word, "")) for word in WORDS} | {"set": _text(group["name"])}
            for group in record["sets"]
            for device in group["devices"]
        ]
        _text(record["name"])
        for key in ("together", "warnings"):
            if not isinstance(record.get(key, []), list):
                raise TypeError(f"{key} is {shown(record[key])}, no list")
        for group in record.get("together", ()):
            _text(group["set"])
    except (KeyError, TypeError, AttributeError) as error:
        raise ReportError(f"{folder.name} holds no readable campaign.json ({error}); {advice}") from error
    inside = os.path.realpath(folder) + os.sep  # of links, too
    for place in places:
        if not (safe_folder(place["folder"]) and os.path.realpath(folder / place["folder"]).startswith(inside)):
            raise ReportError(
                f"campaign.json in {folder.name} names the folder {shown(place['folder'])} for the device "
                f"{shown(place['name'])} of the set {shown(place['set'])}; it must be one below {folder.name}; {advice}"
            )
    return dict(record)


def safe_folder(place: str) -> bool:
    """Whether a folder named in ``campaign.json`` is written as one below the campaign's, and so may be linked to."""
    return bool(re.fullmatch(r"[\w][\w. -]*(/[\w][\w. -]*)*", place))


def _text(value: object) -> str:
    """Give a value that must be text."""
    if not isinstance(value, str):
        raise TypeError(f"{shown(value)} is no text")
    return value
