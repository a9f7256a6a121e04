"""Numbers and data of the diagnosis page: tables, and what its pictures draw."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.numbers import bin_means, edges_of, index_in
from shj_bayes.report.words import ForceUnit, unit_for
from shj_bayes.results.device import Channels, read_channels
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
class SignedMeans:
    """Mean residual along the motion over one coordinate, or over several; nan where there are too few samples."""

    edges: tuple[FloatArray, ...] = field(repr=False)  # of the bins of each coordinate, shape (n + 1,)
    # push_kN, pull_kN: shape (n,), or (n, m, ...); positive where the device resists more than the law says
    push_kN: FloatArray = field(repr=False)
    pull_kN: FloatArray = field(repr=False)


def signed_means(
    channels: Channels, residual_kN: FloatArray, bins: Mapping[str, int], fewest: int = FEWEST
) -> SignedMeans:
    """Average a residual along the motion in even bins, so many of each coordinate."""
    used, direction, shape = channels.used, channels.direction, tuple(bins.values())
    values = [getattr(channels, name) for name in bins]
    edges = [edges_of(value[used], n) for value, n in zip(values, shape, strict=True)]
    cell = np.ravel_multi_index([index_in(v, e) for v, e in zip(values, edges, strict=True)], shape)
    push, pull = (
        bin_means(cell, residual_kN * direction, used & (direction == sign), math.prod(shape), fewest).reshape(shape)
        for sign in (1, -1)
    )
    return SignedMeans(tuple(edges), push, pull)


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
