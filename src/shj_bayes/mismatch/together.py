"""Diagnoses of a campaign taken together: read, added up by set and over all devices, and what follows for models."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from shj_bayes.errors import InferenceError, ReportError
from shj_bayes.mismatch.sets import Common, DeviceEvidence, common_to
from shj_bayes.results.campaign import SetTogether
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.store import read

DIGITS = 6  # of probabilities in files


@dataclass(frozen=True, eq=False)
class DiagnosedDevice:
    """A diagnosed device."""

    folder: str  # its folder below the campaign's
    evidence: DeviceEvidence  # what it says of every class
    modelled: tuple[str, ...]  # effects of the model that its diagnosis ended in
    sampled: bool  # that model was fitted: the diagnosis was no first look
    units: Mapping[str, str] = field(default_factory=dict)  # units of its further channels by coordinate


@dataclass(frozen=True, eq=False)
class Together:
    """What the devices of a set have in common."""

    set_name: str  # the set; empty for all devices of the campaign
    devices: tuple[DiagnosedDevice, ...]  # its diagnosed devices
    common: Common  # what they have in common

    @property
    def effects(self) -> dict[str, tuple[str, ...]]:
        """Effects of the models of devices that hold what is certain of the set, where no fit does so yet; by folder.

        They are those that the device's own diagnosis found, and those that only the set makes certain.
        """
        out = {}
        for place, device in enumerate(self.devices):
            entering = [one for one in self.common.shared if one.enters and place in one.holders]
            found = [one for one in entering if one.alone[place]]
            added = tuple(one.effects[place] for one in entering if not one.alone[place] and one.effects[place])
            if added or (not device.sampled and found):
                out[device.folder] = (*device.modelled, *added)
        return out

    @property
    def record(self) -> SetTogether:
        """As it stands in ``campaign.json``."""
        units: dict[str, str] = {}
        for device in self.devices[::-1]:
            units |= device.units
        classes = tuple(
            replace(
                one,
                unit=units.get(one.coordinate, one.unit),
                probability=round(one.probability, DIGITS),
                of_devices=tuple(round(p, DIGITS) for p in one.of_devices),
            )
            for one in self.common.shared
        )
        return SetTogether(set=self.set_name, devices=tuple(d.folder for d in self.devices), classes=classes)


def together(devices: Iterable[tuple[str, DiagnosedDevice]]) -> tuple[Together, ...]:
    """Add up the diagnoses of a campaign, each behind the name of its set.

    One for each set; behind them, where there are several sets, one for all devices.
    """
    by_set: dict[str, list[DiagnosedDevice]] = {}
    for set_name, device in devices:
        by_set.setdefault(set_name, []).append(device)
    groups: list[tuple[str, Sequence[DiagnosedDevice]]] = list(by_set.items())
    if len(groups) > 1:
        groups.append(("", [device for _, own in groups for device in own]))
    return tuple(Together(name, tuple(own), common_to([d.evidence for d in own])) for name, own in groups)


def read_diagnosed(place: Path, folder: str) -> DiagnosedDevice:
    """Read what a diagnosis says for the set of its device; `InferenceError` if it cannot be read.

    `place` is the folder of the diagnosis, `folder` that of the device below the campaign's.
    """
    try:
        record = read(DiagnosisRecord, place)
        if record.evidence is None:
            raise ValueError("there is none")
        units = {one.coordinate: one.unit or "1" for one in record.channels}
        return DiagnosedDevice(folder, DeviceEvidence(record.evidence), tuple(record.modelled), not record.quick, units)
    except (ReportError, ValueError) as error:
        raise InferenceError(
            f"the evidence in its diagnosis.json cannot be read ({error}); delete that file and run again"
        ) from error
