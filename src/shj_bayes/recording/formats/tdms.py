"""TDMS files as LabVIEW writes them."""

import logging
from pathlib import Path
from typing import Any

from shj_bayes.errors import RecordingError
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.headers import split_header
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Column, Table, as_floats, refuse_large


def read_tdms(path: Path, sha256: str) -> Table:
    """Read the numeric channels of a TDMS file; a waveform's interval is the single number ``wf_increment`` (s)."""
    with path.open("rb") as stream:
        if stream.read(4) != b"TDSm":
            raise RecordingError(f"{path.name} is not a TDMS file although its ending says so; export it again")
    from nptdms import TdmsFile  # noqa: PLC0415
    from nptdms.log import log_manager  # noqa: PLC0415

    log_manager.set_level(logging.CRITICAL)  # it writes to the terminal; what matters of it is a finding
    with TdmsFile.open(path) as file:
        channels = [channel for group in file.groups() for channel in group.channels()]
        channels = [c for c in channels if c.dtype is not None and c.dtype.kind in "fiu" and len(c)]
        refuse_large(sum(8 * len(channel) for channel in channels), path.name)
        names = [str(channel.name) for channel in channels]
        unique = len(set(names)) == len(names)
        columns = tuple(_column(channel, unique) for channel in channels)
        cut = file.file_status.incomplete_final_segment
        steps = {float(c.properties["wf_increment"]) for c in channels if "wf_increment" in c.properties}
    scalars = {"wf_increment": steps.pop()} if len(steps) == 1 else {}
    words = "the file ends early, in the midst of what was written last; what was there is read"
    findings = (Finding("cut-short", "warning", words),) if cut else ()
    return Table(path.name, "tdms", sha256, columns, scalars=scalars, findings=findings)


def _column(channel: Any, unique: bool) -> Column:
    """One channel; its group is part of the name only where names repeat."""
    name, own = split_header(str(channel.name))
    name = name if unique else f"{channel.group_name}/{name}"
    unit = str(channel.properties.get("unit_string") or channel.properties.get("NI_UnitDescription") or "").strip()
    return Column(name, as_floats(channel[:]), unit or own, str(channel.name))


FORMATS = (Format("tdms", (".tdms",), read_tdms),)
