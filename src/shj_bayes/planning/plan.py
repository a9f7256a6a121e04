"""Which test next: protocols are proposed, foreseen, changed for the better, and the leading ones rehearsed in full."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from shj_bayes._util.arrays import one_blas_thread
from shj_bayes.mismatch.classes import DOUBT, MATTERS
from shj_bayes.planning.foresight import OUTCOMES, Foreseen, ForeseenQuantity, entropy_of, foresee
from shj_bayes.planning.known import Known
from shj_bayes.planning.protocol import Candidates, Protocol, Rig, changed
from shj_bayes.planning.rehearsal import Rehearsal, rehearse

ROUNDS, PARENTS, CHILDREN = 1, 4, 4
FINAL = 6  # protocols that are foreseen again with fresh outcomes: the best of many is partly luck
SHOWN, REHEARSALS = 3, 8
LITTLE = 0.1  # of what is not known: a test that is expected to settle less is not worth its time
WHICH, FORCE = "which", "force"


class Worth(StrEnum):
    """Whether a test is worth its time."""

    YES = "yes"
    DECIDED = "decided"
    LITTLE = "little"


@dataclass(frozen=True, eq=False)
class Row:
    """One protocol and what it is expected to give."""

    protocol: Protocol
    foreseen: tuple[Foreseen, ...]  # for each device
    # information, nats, mean over the devices: loss of entropy, or of the logarithm of the standard deviation
    gain: float
    misread: float  # largest error of the force for what readers get wrong of the motion, as a share of Fy
    broken: tuple[str, ...] = ()  # limits of the rig that it does not keep, in words
    rehearsal: Rehearsal | None = None  # what simulated tests ended in, first device

    @property
    def order(self) -> tuple[bool, float, float]:
        """By what protocols are ranked, larger is better: for ``which`` how far contenders are apart, else the gain.

        Entropy alone would praise a test that makes sure of a wrong set. Protocols whose motion is read with an error
        that matters come last: a diagnosis would take the error for an effect.
        """
        which = self.foreseen[0].sd is None
        first = float(np.mean([s.apart for s in self.foreseen])) if which else self.gain
        return self.misread <= MATTERS, first, self.gain

    @property
    def gain_per_minute(self) -> float:
        """Gain per minute on the rig, nats/min."""
        return self.gain / (self.protocol.duration_s / 60.0)


@dataclass(frozen=True, eq=False)
class Question:
    """What the next test is to settle."""

    word: str = WHICH  # which set of classes is there, or the name of the quantity that should become narrow
    quantities: tuple[ForeseenQuantity, ...] = ()  # that quantity for each device; empty for ``which``


ANY_SET = Question()


@dataclass(frozen=True, eq=False)
class Plan:
    """The answer to which test is next."""

    known: tuple[Known, ...]
    rig: Rig
    question: Question
    best: tuple[Row, ...]  # protocols that the rig allows, best first
    compared: tuple[Row, ...]  # Table 1 again, and the files that were given
    worth: Worth  # whether the best is worth its time
    seed: int

    @property
    def unsettled(self) -> float:
        """Mean entropy of the probabilities of the sets before the test, nats."""
        return float(np.mean([_entropy(k) for k in self.known]))


@one_blas_thread
def make_plan(
    known: Sequence[Known],
    candidates: Candidates,
    question: Question = ANY_SET,
    *,
    seed: int = 1,
    rehearsals: int = REHEARSALS,
    tell: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Choose the next test for one device, or for several that it is planned for.

    The leading protocols are simulated in full so many times (`rehearsals`). `tell` gets one line for each step.
    """
    rig = candidates.rig
    asked: tuple[ForeseenQuantity | None, ...] = question.quantities or (None,) * len(known)

    def row(protocol: Protocol, seed: int, n: int = OUTCOMES) -> Row:
        seen = tuple(foresee(k, protocol, rig.rate_Hz, seed, q, n) for k, q in zip(known, asked, strict=True))
        gain = float(np.mean([_gain(k, s, q) for k, s, q in zip(known, seen, asked, strict=True)]))
        force = max(s.force_kN for s in seen)
        broken = rig.broken_by(protocol)
        if force > rig.max_force_kN:
            broken = (*broken, f"force up to {force:.4g} kN, allowed {rig.max_force_kN:.4g}")
        misread = max(s.misread_kN / k.sliding_kN for s, k in zip(seen, known, strict=True))
        return Row(protocol, seen, gain, misread, broken)

    compared = [candidates.first[0], *candidates.given]
    tell(f"weighing {len(candidates.all)} protocols")
    rows = [row(p, seed) for p in candidates.all]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    for k in range(ROUNDS):
        parents = ranked(rows)[:PARENTS]
        children = [new for r in parents for _ in range(CHILDREN) if (new := changed(r.protocol, rig, rng)) is not None]
        tell(f"improving the best, {k + 1} of {ROUNDS}: {len(children)} further protocols")
        rows += [row(p, seed) for p in children]
    tell("weighing the best again, with fresh outcomes")
    different = list({r.protocol.blocks or r.protocol: r for r in reversed(ranked(rows))}.values())[::-1]
    finalists = [r.protocol for r in different[:FINAL] if r.protocol not in compared]
    again = [row(p, seed + 1, 3 * OUTCOMES) for p in (*finalists, *compared)]
    best = ranked(again)[:SHOWN]
    others = [r for r in again if r.protocol in compared]

    def rehearsed(r: Row) -> Row:
        tell(f"simulating '{r.protocol.name}' in full, {rehearsals} times")
        return replace(r, rehearsal=rehearse(known[0], r.protocol, rig.rate_Hz, rehearsals, seed, asked[0]))

    worth = _worth(known, best, question.word)
    if rehearsals and worth is Worth.YES:
        done = {id(r): rehearsed(r) for r in [*best, *(r for r in others if r not in best)]}
        best, others = [done[id(r)] for r in best], [done.get(id(r), r) for r in others]
    return Plan(tuple(known), rig, question, tuple(best), tuple(others), worth, seed)


def ranked(rows: Sequence[Row]) -> list[Row]:
    """Protocols that the rig allows, best first."""
    return sorted((r for r in rows if not r.broken), key=lambda r: r.order, reverse=True)


def _entropy(known: Known) -> float:
    return float(entropy_of(np.array(list(known.probabilities.values()))))


def _gain(known: Known, seen: Foreseen, quantity: ForeseenQuantity | None) -> float:
    if quantity is None:
        return _entropy(known) - seen.entropy
    assert seen.sd is not None
    return math.log(quantity.now(known)[1] / seen.sd)


def _worth(known: Sequence[Known], best: Sequence[Row], question: str) -> Worth:
    if question != WHICH:
        return Worth.YES if best and best[0].gain >= LITTLE else Worth.LITTLE
    if all(max(k.probabilities.values()) >= 1.0 - DOUBT for k in known):
        return Worth.DECIDED
    left = float(np.mean([_entropy(k) for k in known]))
    return Worth.YES if best and best[0].gain >= LITTLE * left else Worth.LITTLE
