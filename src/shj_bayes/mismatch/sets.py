"""What devices have in common: the evidence of each class added over the devices of a set.

The model, for the devices of a set (or of a campaign) and each class of coordinates:

- the set has the class with probability `PRIOR_INCLUSION`, as a device has;
- where the set has it, each device has it with probability theta, the share of devices that have it, of which nothing
  is known: uniform between 0 and 1, integrated out;
- where the set has it not, a device may still have it alone, with the probability q that leaves p = `PRIOR_INCLUSION`
  for a device of which nothing is known: p = p E(theta) + (1 - p) q;
- what a device says of a class is its Bayes factor B, from the log weights of the sets of classes that were weighed for
  it (`evidence`), the other classes of the device integrated out.

So the set has class c with odds ``p / (1 - p)`` times ``integral of prod(1 - theta + theta B_i)`` over
``prod(1 - q + q B_i)``. Classes that do the same in a test, such as travel and time, must not be counted twice: what is
compared are combinations of classes that a set has, grown and shrunk until none is better, and a device's B of one
class is taken with each other class of the combination at the share that was found for it.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.special import logsumexp

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.errors import InferenceError, ReportError
from shj_bayes.mismatch.hypothesis import ALPHA, MIN_EFFECT, PRIOR_INCLUSION
from shj_bayes.mismatch.moves import PROMISING
from shj_bayes.model.coordinates import coordinates_of
from shj_bayes.results.campaign import SetTogether, SharedDependence
from shj_bayes.results.diagnosis import DependenceId, DiagnosisRecord, EvidenceRecord
from shj_bayes.results.store import read

ALONE = PRIOR_INCLUSION * 0.5 / (1.0 - PRIOR_INCLUSION)  # of a device whose set has not what it has; see the module
NODES = (8, 100)  # of Gauss and Legendre for theta: exact for up to 2 n - 1 devices
NEGLIGIBLE = 1e-4  # probability of a combination below which it is left out of sums
Combination = frozenset[str]


@dataclass(frozen=True, eq=False)
class DiagnosedDevice:
    """A diagnosed device; `ValueError` if the parts of its evidence do not belong together."""

    evidence: EvidenceRecord  # what it says of every class
    folder: str = ""  # its folder below the campaign's
    modelled: tuple[str, ...] = ()  # effects of the model that its diagnosis ended in
    sampled: bool = False  # that model was fitted: the diagnosis was no first look
    units: Mapping[str, str] = field(default_factory=dict)  # units of its further channels by coordinate

    def __post_init__(self) -> None:
        """Refuse weights that are not those of its sets."""
        n, sets, nats = len(self.evidence.classes), self.evidence.sets, self.evidence.nats
        if any(place >= n for places in sets for place in places):
            raise ValueError(f"a set names class {max(map(max, filter(None, sets)))} of {n}")
        if len(nats) != len(sets) or not np.all(np.isfinite(nats)) or () not in sets:
            raise ValueError("sets of classes and their weights do not belong together")

    @cached_property
    def holds(self) -> BoolArray:
        """Which classes each set holds, shape (m, n)."""
        return np.array([[i in places for i in range(len(self.evidence.classes))] for places in self.evidence.sets])

    @cached_property
    def _bare(self) -> FloatArray:
        """Log evidence of each set, without prior odds, shape (m,)."""
        return np.asarray(np.array(self.evidence.nats) - self.evidence.log_odds * self.holds.sum(axis=1))

    def log_factors(self, names: Sequence[str], log_odds: FloatArray) -> FloatArray:
        """Log Bayes factor of each class of `names`, with every other one at its odds, shape (n_names,) both.

        0 where the device says nothing of a class.
        """
        out, classes = np.zeros(len(names)), self.evidence.classes
        here = np.array([place for place, name in enumerate(names) if name in classes], dtype=np.int64)
        holds = self.holds[:, [classes.index(names[place]) for place in here]]
        if not here.size:
            return out
        known = np.array([log_odds[names.index(name)] for name in classes])
        weights = (self._bare + self.holds @ known)[:, None]
        with_it, without = (logsumexp(np.where(mask, weights, -np.inf), axis=0) for mask in (holds, ~holds))
        out[here] = np.where(holds.any(axis=0), with_it - log_odds[here] - without, 0.0)
        return out


def log_shared(log_factors: FloatArray) -> tuple[float, float]:
    """Weigh that a set has a class, from the log Bayes factors of its devices; see the module.

    Gives the log Bayes factor of the set, and the share of the devices that have it where the set has: the posterior
    mean of theta.
    """
    theta, logs = _over_share(log_factors)
    total = float(logsumexp(logs))
    return total - float(_mixed(log_factors, ALONE).sum()), float(np.exp(logs - total) @ theta)


def _over_share(log_factors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares theta, and the log of the likelihood of the devices times the weight of each, shape (k,) both."""
    n = int(np.clip(log_factors.size // 2 + 1, *NODES))
    at, weight = np.polynomial.legendre.leggauss(n)
    theta = (at + 1.0) / 2.0
    return theta, np.log(weight / 2.0) + _mixed(log_factors[:, None], theta).sum(axis=0)


def _mixed(log_factors: FloatArray, share: FloatArray | float) -> FloatArray:
    """Log of 1 - share + share B."""
    return np.asarray(np.logaddexp(np.log1p(-share), np.log(share) + log_factors))


def _log_odds(p: float) -> float:
    return math.log(p / (1.0 - p))


class _Weighing:
    """Combinations of classes weighed for some devices, each once."""

    def __init__(self, devices: Sequence[DiagnosedDevice]) -> None:
        self.devices = devices
        self.names = sorted({name for device in devices for name in device.evidence.classes})
        self.weights: dict[Combination, float] = {frozenset(): 0.0}
        self._odds: dict[Combination, FloatArray] = {frozenset(): np.full(len(self.names), _log_odds(ALONE))}
        self._factors: dict[Combination, FloatArray] = {}
        self._gains: dict[tuple[Combination, str], tuple[float, float]] = {}

    def factors(self, combination: Combination) -> FloatArray:
        """Log Bayes factor of every class in each device, the others as in a combination, shape (n_names, n)."""
        if combination not in self._factors:
            of_each = [device.log_factors(self.names, self._odds[combination]) for device in self.devices]
            self._factors[combination] = np.stack(of_each, axis=1)
        return self._factors[combination]

    def gain(self, combination: Combination, name: str) -> tuple[float, float]:
        """Log Bayes factor of one class more, and the share of devices that have it."""
        key = (combination, name)
        if key not in self._gains:
            self._gains[key] = log_shared(self.factors(combination)[self.names.index(name)])
        return self._gains[key]

    def weigh(self, combination: Combination) -> float:
        """Log weight of a combination over that of none, its classes added one by one, the strongest first."""
        if combination not in self.weights:
            known: Combination = frozenset()
            while known != combination:
                name = max(sorted(combination - known), key=lambda one: self.gain(known, one)[0])
                gain, share = self.gain(known, name)
                larger = known | {name}
                self._odds[larger] = self._odds[known].copy()
                self._odds[larger][self.names.index(name)] = _log_odds(share)
                self.weights[larger] = self.weights[known] + gain + _log_odds(PRIOR_INCLUSION)
                known = larger
        return self.weights[combination]

    def grow(self) -> Combination:
        """Find the most probable combination, and weigh those around it: one class less, more, or another."""
        best: Combination = frozenset()
        while True:
            around = {best ^ {name} for name in self.names}
            around |= {best - {old} | {new} for old in best for new in self.names if new not in best}
            better = max(sorted(around, key=sorted), key=self.weigh)
            if self.weigh(better) <= self.weigh(best):
                return best
            best = better

    def of_devices(self, combination: Combination, name: str) -> FloatArray:
        """Probability that each device has a class where the set has a combination, shape (n,)."""
        b = self.factors(combination)[self.names.index(name)]
        if name not in combination:
            return np.asarray(np.exp(math.log(ALONE) + b - _mixed(b, ALONE)))
        theta, logs = _over_share(b)
        each = np.exp(np.log(theta) + b[:, None] - _mixed(b[:, None], theta))
        return np.asarray(each @ np.exp(logs - logsumexp(logs)))


def common_to(
    devices: Sequence[DiagnosedDevice],
) -> tuple[tuple[SharedDependence, ...], tuple[tuple[Combination, float], ...]]:
    """Find what the devices of a set, or of a campaign, have in common; see the module for the model.

    Gives every class, and the combinations of them that the set may have with their probabilities, most probable first.
    """
    out = _Weighing(devices)
    best = out.grow()
    names = sorted(out.weights, key=lambda key: (-out.weights[key], sorted(key)))
    logs = np.array([out.weights[key] for key in names])
    probability = np.exp(logs - logsumexp(logs))
    listed = [(key, float(p)) for key, p in zip(names, probability, strict=True)]
    likely = [(key, p) for key, p in listed if p >= NEGLIGIBLE]
    total = sum(p for _, p in likely)
    shared = []
    for name in out.names:
        each = sum((p / total * out.of_devices(key, name) for key, p in likely), np.zeros(len(devices)))
        held = sum(p for key, p in listed if name in key)
        # Classes that stand in its place in combinations that 5 % of doubt do not leave out.
        others: dict[str, float] = {}
        for key, p in listed if name in best else ():
            for other in sorted(key - best) if name not in key and len(key) >= len(best) else ():
                others[other] = others.get(other, 0.0) + p
        rivals = tuple(sorted((k for k, p in others.items() if p >= ALPHA), key=lambda k: -others[k]))
        # Nothing less than the best combination explains the devices as well: it holds this class, or a rival.
        sure = name in best and sum(p for key, p in listed if key <= best - {name}) < ALPHA
        action, coordinate = DependenceId.read(name)
        known, own = next(iter(coordinates_of(coordinate)), None), [device.evidence for device in devices]
        one = SharedDependence(
            action=action,
            coordinate=coordinate,
            unit=known.unit if known else "1",
            probability=held,
            enters=False,
            rivals=rivals,
            of_devices=tuple(each.tolist()),
            alone=tuple(name in record.own for record in own),
            effects=tuple(record.own.get(name) or record.written.get(name, "") for record in own),
            size_percent=tuple(record.size_percent.get(name) for record in own),
            change_percent=tuple(record.change_percent.get(name) for record in own),
        )
        sizes = [one.size_percent[i] or 0.0 for i in one.holders]
        large = bool(sizes) and float(np.mean(sizes)) >= 100.0 * PROMISING * MIN_EFFECT
        shared.append(replace(one, enters=sure and large))
    order = sorted(shared, key=lambda one: (-one.probability, str(one.id)))
    return tuple(order), tuple(likely)


DIGITS = 6  # of probabilities in files


def together(
    devices: Iterable[tuple[str, DiagnosedDevice]],
) -> tuple[tuple[SetTogether, ...], dict[str, tuple[str, ...]]]:
    """Add up the diagnoses of a campaign, each behind the name of its set.

    What is common: one for each set; behind them, where there are several sets, one for all devices. Then, by folder,
    the effects of the models of devices that hold what is certain of their set, where no fit does so yet.
    """
    by_set: dict[str, list[DiagnosedDevice]] = {}
    for set_name, device in devices:
        by_set.setdefault(set_name, []).append(device)
    shared = {name: common_to(own)[0] for name, own in by_set.items()}
    enter: dict[str, tuple[str, ...]] = {}
    for name, own in by_set.items():
        for place, device in enumerate(own):
            entering = [one for one in shared[name] if one.enters and place in one.holders]
            added = tuple(one.effects[place] for one in entering if not one.alone[place] and one.effects[place])
            if added or (not device.sampled and any(one.alone[place] for one in entering)):
                enter[device.folder] = (*device.modelled, *added)
    out = [_told(name, own, shared[name]) for name, own in by_set.items()]
    if len(by_set) > 1:
        every = [device for own in by_set.values() for device in own]
        out.append(_told("", every, common_to(every)[0]))
    return tuple(out), enter


def _told(name: str, devices: Sequence[DiagnosedDevice], shared: Sequence[SharedDependence]) -> SetTogether:
    """Give what a set has in common as it stands in ``campaign.json``."""
    units = {coordinate: unit for device in devices[::-1] for coordinate, unit in device.units.items()}
    classes = tuple(
        replace(
            one,
            unit=units.get(one.coordinate, one.unit),
            probability=round(one.probability, DIGITS),
            of_devices=tuple(round(p, DIGITS) for p in one.of_devices),
        )
        for one in shared
    )
    return SetTogether(set=name, devices=tuple(d.folder for d in devices), classes=classes)


def read_diagnosed(place: Path, folder: str) -> DiagnosedDevice:
    """Read what a diagnosis says for the set of its device; `InferenceError` if it cannot be read.

    `place` is the folder of the diagnosis, `folder` that of the device below the campaign's.
    """
    try:
        record = read(DiagnosisRecord, place)
        if record.evidence is None:
            raise ValueError("there is none")
        units = {one.coordinate: one.unit or "1" for one in record.channels}
        return DiagnosedDevice(record.evidence, folder, tuple(record.modelled), not record.quick, units)
    except (ReportError, ValueError) as error:
        raise InferenceError(
            f"the evidence in its diagnosis.json cannot be read ({error}); delete that file and run again"
        ) from error
