"""What one device says of every class, weak or strong: log weights of sets of classes, for sums over devices.

A search fits the sets of classes that a single device makes probable. What it leaves out as too weak may be certain in
eight devices; so every set that was fitted and is in contention is also weighed with each other class beside it, and
with each pair of them, to first order (`screen`). All stand on one scale: evidence times the prior probability.
"""

from collections.abc import Sequence
from itertools import combinations, pairwise

import numpy as np
from scipy.special import logsumexp

from shj_bayes.mismatch.classes import LOG_PRIOR_ODDS, Candidate, unit_columns
from shj_bayes.mismatch.findings import Answer, curve_band
from shj_bayes.mismatch.hypothesis import Hypothesis
from shj_bayes.mismatch.laplace import visible
from shj_bayes.mismatch.moves import RIVAL, Search
from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.diagnosis import EvidenceRecord

DIGITS = 3  # of a log weight, nats
SMALLER = (1.0, 0.2, 0.04)  # of the size that fits best alone: sizes at which two candidates are weighed together
CLEAR = 0.1  # nats; less between two candidates is nothing


def evidence_of(out: Search, answer: Answer) -> EvidenceRecord:
    """Log weights of sets of classes, and how each class would be written in the model of the device."""
    names = sorted(out.fitter.classes)
    position = {name: i for i, name in enumerate(names)}
    fitted = {h.key: h.log_weight for h in out.found.values()}
    added: dict[frozenset[str], float] = {}
    height = out.best.log_weight
    for h in out.found.values():
        if h.log_weight > height - RIVAL:
            for key, gain in _gains_beside(out, h).items():
                weight = h.log_weight + len(key) * LOG_PRIOR_ODDS + gain
                if weight > added.get(h.key | key, -np.inf):
                    added[h.key | key] = weight
    rows = fitted | {key: weight for key, weight in added.items() if key not in fitted}
    own = {f.member.of.id: f.member.variant.effect.id for f in answer.findings}
    sizes = {f.member.of.id: f.size for f in answer.findings}
    bands = {f.member.of.id: curve_band(out, f, 2) for f in answer.findings}
    changes = {name: band["mean"][1] - band["mean"][0] for name, band in bands.items() if band is not None}
    # The model that is shown may hold classes of a size that does not matter, too: here they are others.
    plain = out.found.get(frozenset(own), out.found[frozenset()])
    others = {name: c for name, c in _best(out.fitter.screen(plain)).items() if name not in own}
    first = _FirstOrder(out, plain, list(others.values()))
    for i, (name, c) in enumerate(others.items()):
        mean = first.mean(i)
        sizes[name] = float(visible(out.data, plain.state.jacobian, (first.columns[i] @ mean)[:, None])[0])
        if c.variant.curve is not None:
            ends = c.variant.curve.rows(np.array([0.0, 1.0]), np.ones(2)) @ mean
            changes[name] = 100.0 * (ends[1] - ends[0])
    return EvidenceRecord(
        classes=tuple(names),
        log_odds=LOG_PRIOR_ODDS,
        own=own,
        written={name: c.variant.effect.id for name, c in sorted(others.items())},
        size_percent={name: round(100.0 * size, DIGITS) for name, size in sizes.items()},
        change_percent={name: round(float(change), DIGITS) for name, change in changes.items()},
        sets=tuple(tuple(sorted(position[name] for name in key)) for key in rows),
        nats=tuple(round(weight - fitted[frozenset()], DIGITS) for weight in rows.values()),
        fitted=len(fitted),
    )


def _gains_beside(out: Search, h: Hypothesis) -> dict[frozenset[str], float]:
    """Log Bayes factor to first order of each class, and of each pair of classes, beside a hypothesis.

    That of a class is averaged over the ways to write it, where it begins, and its size. That of a pair is the product
    of both, times what the best way to write the one makes of the best way to write the other: far below 1 where the
    two do the same.
    """
    by_class: dict[str, list[Candidate]] = {}
    for c in out.fitter.screen(h):
        by_class.setdefault(c.of.id, []).append(c)
    alone = {name: _averaged(own) for name, own in by_class.items()}
    gains = {frozenset((name,)): gain for name, gain in alone.items()}
    first = _FirstOrder(out, h, [own[0] for own in by_class.values()])
    for (i, a), (j, b) in combinations(enumerate(by_class), 2):
        gains[frozenset((a, b))] = alone[a] + alone[b] + first.interplay(i, j)
    return gains


class _FirstOrder:
    """Candidates beside a hypothesis to first order, each of the size that fits best."""

    def __init__(self, out: Search, h: Hypothesis, candidates: Sequence[Candidate]) -> None:
        self.columns = [unit_columns(c) for c in candidates]
        self._beside = out.metric.gaussian(h.state.beside(*self.columns)).given(h.state.z.size)
        ends = np.cumsum([0, *(c.shape[1] for c in self.columns)])
        self._places = [np.arange(a, b) for a, b in pairwise(ends)]
        self._known: dict[int, tuple[float, float]] = {}

    def interplay(self, i: int, j: int) -> float:
        """Log Bayes factor of two candidates over the product of theirs; 0 where neither does what the other does."""
        (one, both_one), (other, both_other) = self._alone(i), self._alone(j)
        extra = self._log_factor((i, 1.0), (j, 1.0)) - one - other
        if abs(extra) < CLEAR:
            return extra
        # The size that fits a candidate alone need not fit it beside the other.
        both = [self._log_factor((i, u), (j, v)) for u in SMALLER for v in SMALLER]
        return float(logsumexp(both)) - both_one - both_other

    def _alone(self, i: int) -> tuple[float, float]:
        """Log Bayes factor of one candidate at the size that fits best, and summed over the sizes in `SMALLER`."""
        if i not in self._known:
            factors = [self._log_factor((i, size)) for size in SMALLER]
            self._known[i] = (factors[0], float(logsumexp(factors)))
        return self._known[i]

    def _log_factor(self, *which: tuple[int, float]) -> float:
        """Log Bayes factor of candidates of some size each together; their coefficients have standard normal priors."""
        own = np.concatenate([self._places[i] for i, _ in which])
        size = np.concatenate([np.full(self._places[i].size, size) for i, size in which])
        return self._beside.some(own).sized(size).gain

    def mean(self, i: int) -> FloatArray:
        """Posterior mean of the coefficients of one candidate alone."""
        return self._beside.some(self._places[i]).mean


def _best(listed: Sequence[Candidate]) -> dict[str, Candidate]:
    """Best candidate of each class; its best curve where it has one: a name is matched to a curve, not the reverse."""
    out: dict[str, Candidate] = {}
    for c in listed:
        kept = out.setdefault(c.of.id, c)
        if kept.variant.curve is None and c.variant.curve is not None:
            out[c.of.id] = c
    return out


def _averaged(own: list[Candidate]) -> float:
    """Log Bayes factor of a class: a mean over its variants, with their weights, and over their starts."""
    starts: dict[str, list[float]] = {}
    for c in own:
        curve = c.variant.curve
        word = c.variant.effect.id if curve is None else f"{curve.coordinate} {curve.length} {curve.sides}"
        starts.setdefault(word, []).append(c.gain)
    return float(logsumexp([logsumexp(gains) - np.log(len(gains)) for gains in starts.values()]))
