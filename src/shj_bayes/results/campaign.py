"""``campaign.json``: what became of the devices of a campaign, and what those of each set have in common."""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from shj_bayes.errors import ReportError, shown
from shj_bayes.results import store
from shj_bayes.results.codec import IF_KNOWN, Probability, Stored
from shj_bayes.results.diagnosis import DependenceId, DiagnosisVerdict
from shj_bayes.results.fit import USABLE, Trust

SCHEMA: Literal["shj-bayes/campaign/1"] = "shj-bayes/campaign/1"
LARGEST = 1e4  # number of a connection, in mm, kN or pieces
MAX_NOTE = 4000  # characters of what somebody wrote
LIKELY = 0.5  # a device is given what more probably than not it has
WITH_SET = "with-set"  # in the folder of a device: its fit with its set's physics


@dataclass(frozen=True, kw_only=True)
class DeviceEntry:
    """What became of a device; `Outcome` explains the words."""

    name: str
    folder: str
    status: Annotated[str, {"enum": ("done", "kept", "failed")}]
    reason: str
    verdict: Annotated[str, {"enum": (*Trust, "")}]
    diagnosis: Annotated[str, {"enum": (*DiagnosisVerdict, "off", "failed", "")}] = ""
    diagnosis_reason: str = ""
    with_set: Annotated[str, {"enum": (*Trust, "failed", "")}] = ""
    with_set_reason: str = ""
    note: str | None = field(default=None, metadata=IF_KNOWN)  # what somebody wrote of it

    @property
    def usable_with_set(self) -> bool:
        """Whether it has a usable fit with what its set has."""
        return self.with_set in USABLE


@dataclass(frozen=True, kw_only=True)
class Connection:
    """One connection as tested, as far as the manifest says it of a set."""

    bolts: int | None = field(default=None, metadata=IF_KNOWN)  # clamp the sliding surfaces
    bolt_mm: float | None = field(default=None, metadata=IF_KNOWN)  # diameter of one
    bolt_grade: str | None = field(default=None, metadata=IF_KNOWN)
    surfaces: int | None = field(default=None, metadata=IF_KNOWN)  # that slide, of each bolt
    clamping_kN: float | None = field(default=None, metadata=IF_KNOWN)  # of one bolt
    shim: str | None = field(default=None, metadata=IF_KNOWN)
    finish: str | None = field(default=None, metadata=IF_KNOWN)  # of the sliding surfaces
    slot_mm: float | None = field(default=None, metadata=IF_KNOWN)  # length of the slot
    # "device": measured across the sliding surfaces; "machine": with grips and frame, whose flexibility is then in K
    displacement: Annotated[str | None, {"enum": ("device", "machine", None)}] = field(default=None, metadata=IF_KNOWN)

    def __post_init__(self) -> None:
        """Refuse numbers that no connection has."""
        numbers = (self.bolts, self.bolt_mm, self.surfaces, self.clamping_kN, self.slot_mm)
        if not all(0 < x < LARGEST for x in numbers if x is not None):
            raise ValueError(f"numbers of a connection must lie between 0 and {LARGEST:g}")
        if (self.travel_mm or 1.0) <= 0:
            raise ValueError(f"a slot of {self.slot_mm:g} mm is no longer than its bolt of {self.bolt_mm:g} mm")
        if self.displacement not in ("device", "machine", None):
            raise ValueError('displacement is measured at the "device" or at the "machine"')

    @property
    def travel_mm(self) -> float | None:
        """Free travel from the middle of the slot to either end; None where slot or bolt are not known."""
        return None if self.slot_mm is None or self.bolt_mm is None else 0.5 * (self.slot_mm - self.bolt_mm)


@dataclass(frozen=True, kw_only=True)
class SetEntry:
    """A set and its devices."""

    name: str
    devices: tuple[DeviceEntry, ...]
    connection: Connection | None = field(default=None, metadata=IF_KNOWN)
    note: str | None = field(default=None, metadata=IF_KNOWN)  # what somebody wrote of it


@dataclass(frozen=True, kw_only=True)
class SharedDependence:
    """A class of dependence in a set; lists are in the order of its diagnosed devices."""

    action: str
    coordinate: str
    unit: str
    probability: Probability  # that the set has it
    # the set has it, or a rival, with 95 %, and it is large enough to be followed: models of its devices hold it
    enters: bool
    rivals: tuple[str, ...]  # classes that may stand in its place
    of_devices: tuple[float, ...]  # that each device has it, given the evidence of all
    alone: tuple[bool, ...]  # whether the diagnosis of each device found it
    effects: tuple[str, ...]  # effect that stands, or would stand, for it in each
    # size_percent, change_percent: size in each, and its change from one end of the coordinate to the other, per cent
    # of Fy
    size_percent: tuple[float | None, ...]
    change_percent: tuple[float | None, ...]

    @property
    def id(self) -> DependenceId:
        """The class."""
        return DependenceId(self.action, self.coordinate)

    @property
    def holders(self) -> tuple[int, ...]:
        """Places of the devices that have it, more probably than not."""
        return tuple(i for i, p in enumerate(self.of_devices) if p >= LIKELY)


@dataclass(frozen=True, kw_only=True)
class SetTogether:
    """What the diagnosed devices of a set have in common."""

    set: str  # empty for all devices of the campaign
    devices: tuple[str, ...]  # their folders
    classes: tuple[SharedDependence, ...]

    def __post_init__(self) -> None:
        """Refuse what does not belong together."""
        for one in self.classes:
            lists = (one.of_devices, one.alone, one.effects, one.size_percent, one.change_percent)
            if any(len(values) != len(self.devices) for values in lists):
                raise ValueError(f"{one.action} over {one.coordinate} of {shown(self.set)} is not told of each device")
        if not all(map(safe_folder, self.devices)):
            raise ValueError(f"what {shown(self.set)} has in common names a folder that is none of its devices")


@dataclass(frozen=True, kw_only=True)
class CampaignRecord(Stored, file="campaign.json", command="shj-bayes campaign"):
    """Content of ``campaign.json``."""

    schema: Literal["shj-bayes/campaign/1"] = SCHEMA
    name: str
    simulated: bool = False
    warnings: tuple[str, ...] = ()
    sets: tuple[SetEntry, ...]
    together: tuple[SetTogether, ...] = ()
    digest: str = ""

    @property
    def devices(self) -> list[tuple[str, DeviceEntry]]:
        """All devices, each behind the name of its set."""
        return [(group.name, device) for group in self.sets for device in group.devices]


def read_campaign(folder: Path) -> CampaignRecord:
    """Read the record of a campaign; `ReportError` where that fails, or the folder of a device is not below its own."""
    record = store.read(CampaignRecord, folder)
    inside = os.path.realpath(folder) + os.sep  # of links, too
    for set_name, device in record.devices:
        if not (safe_folder(device.folder) and os.path.realpath(folder / device.folder).startswith(inside)):
            raise ReportError(
                f"campaign.json in {folder.name} names the folder {shown(device.folder)} for the device "
                f"{shown(device.name)} of the set {shown(set_name)}; it must be one below {folder.name}; "
                "restore it, or run shj-bayes campaign again"
            )
    return record


def safe_folder(place: str) -> bool:
    """Whether a folder named in ``campaign.json`` is written as one below the campaign's, and so may be linked to."""
    return bool(re.fullmatch(r"[\w][\w. -]*(/[\w][\w. -]*)*", place))
