"""A data frame as a recording: the columns of a notebook are read like those of a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.heads import split_header
from shj_bayes.recording.reader import recording_of
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.tables import Column, Table, as_floats

if TYPE_CHECKING:
    import pandas as pd


def read_frame(
    frame: pd.DataFrame,
    name: str = "data frame",
    *,
    columns: str | None = None,
    units: str | None = None,
    rate_Hz: float | None = None,
) -> Recording:
    """Read a recording out of a data frame and check it; columns that hold no numbers are not used.

    `columns`, `units`, `rate_Hz` and errors are those of `shj_bayes.recording.reader.read`.
    """
    found = []
    for label, series in frame.items():
        try:
            values = as_floats(np.asarray(series.to_numpy(dtype=np.float64, na_value=np.nan)))
        except (TypeError, ValueError):
            continue
        title, unit = split_header(str(label))
        found.append(Column(title, values, unit, str(label)))
    if not found:
        raise RecordingError(f"{name}: no column holds numbers; give time, displacement and force as columns")
    return recording_of(Table(name, "dataframe", "", tuple(found)), columns, units, rate_Hz)
