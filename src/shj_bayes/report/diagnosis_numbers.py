"""Numbers and data of the diagnosis page: tables, and what its pictures draw."""

import math
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.numbers import bin_means, edges_of, index_in
from shj_bayes.report.words import ForceUnit, unit_for
from shj_bayes.results.device import BoolArray, Channels, IntArray, read_channels
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.store import read


@dataclass(frozen=True, eq=False)
class DiagnosisData:
    """What a diagnosis left in its folder."""

    record: DiagnosisRecord
    channels: Channels = field(repr=False)  # content of ``diagnosis.nc``

    @property
    def capacity_kN(self) -> float:
        """Sliding force of the base law, kN; from the measured force where the record does not say."""
        stated = self.record.fy_kN or 0.0
        return stated if stated > 0 else float(np.quantile(np.abs(self.channels.force_kN), 0.9)) or 1.0

    @property
    def force(self) -> ForceUnit:
        """Unit in which the page shows forces."""
        return unit_for(self.capacity_kN)


def number(value: float | None) -> float:
    """Return a number of a record; nan where there is none."""
    return math.nan if value is None else value


def read_diagnosis(folder: Path) -> DiagnosisData:
    """Read ``diagnosis.json`` and ``diagnosis.nc``; `ReportError` where one is missing, damaged or another."""
    return DiagnosisData(read(DiagnosisRecord, folder), read_channels(folder))


N_BINS, N_POSITION, MAX_TRAVEL = 24, 24, 40
FEWEST = 3  # samples of a bin that is drawn


@dataclass(frozen=True, eq=False)
class Profile:
    """Mean direction-signed residual over one coordinate, arrays of shape (n_bins,); nan where there is no sample."""

    centre: FloatArray = field(repr=False)  # middle of each bin
    # push_kN, pull_kN: mean residual; positive where the device resists more than the law says
    push_kN: FloatArray = field(repr=False)
    pull_kN: FloatArray = field(repr=False)


@dataclass(frozen=True, eq=False)
class Map:
    """Mean direction-signed residual over stroke position and travel."""

    # position_mm, travel_m: shape (n + 1,): edges
    position_mm: FloatArray = field(repr=False)
    travel_m: FloatArray = field(repr=False)
    # push_kN, pull_kN: shape (m, n): mean residual, nan where there is no sample
    push_kN: FloatArray = field(repr=False)
    pull_kN: FloatArray = field(repr=False)


def profile(
    values: FloatArray, residual_kN: FloatArray, direction: IntArray, used: BoolArray, n_bins: int = N_BINS
) -> Profile:
    """Average the residual, kN, along the motion (+1 push, -1 pull) in even bins of a coordinate, shape (n,)."""
    edges = edges_of(values[used], n_bins)
    signed = residual_kN * direction
    index = index_in(values, edges)
    means = [bin_means(index, signed, used & (direction == sign), n_bins, FEWEST) for sign in (1, -1)]
    return Profile(0.5 * (edges[:-1] + edges[1:]), means[0], means[1])


def position_travel(channels: Channels, residual_kN: FloatArray) -> Map:
    """Average the direction-signed residual over position and travel, about one row for each large cycle."""
    used = channels.used
    position, travel = channels.position_mm, channels.travel_m
    across = edges_of(position[used], N_POSITION)
    rows = travel_bins(channels)
    along = edges_of(travel[used], rows)
    cell = index_in(travel, along) * N_POSITION + index_in(position, across)
    parts = [
        bin_means(cell, residual_kN * channels.direction, used & (channels.direction == sign), rows * N_POSITION)
        for sign in (1, -1)
    ]
    return Map(across, along, parts[0].reshape(rows, N_POSITION), parts[1].reshape(rows, N_POSITION))


def travel_bins(channels: Channels) -> int:
    """About one bin for each large cycle, so that push and pull are both in it."""
    used = channels.used
    cycle_m = 2 * float(np.ptp(channels.position_mm[used])) / 1000
    return int(np.clip(round(float(np.ptp(channels.travel_m[used])) / max(cycle_m, 1e-9)), 4, MAX_TRAVEL))


def shown_cycle(channels: Channels, run: int) -> slice:
    """Choose the samples of one cycle of a run to show: its last two neighbouring half-cycles of the largest stroke."""
    mine = np.flatnonzero(channels.run == run)
    turns = mine[1:][np.diff(channels.direction[mine]) != 0]
    ends = [int(mine[0]), *turns.tolist(), int(mine[-1]) + 1]
    halves = list(pairwise(ends))
    strokes = [float(np.ptp(channels.position_mm[a:b])) for a, b in halves]
    large = [s >= 0.95 * max(strokes) for s in strokes]
    pairs = [i for i in range(len(halves) - 1) if large[i] and large[i + 1]]
    if not pairs:
        return slice(ends[0], ends[-1])
    return slice(halves[pairs[-1]][0], halves[pairs[-1] + 1][1])
