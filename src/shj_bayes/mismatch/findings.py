"""What a search says: which classes are there with what probability, how large, and by what name."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TypeVar

import numpy as np
from scipy.special import expit, logsumexp, softmax

from shj_bayes._util.arrays import FloatArray
from shj_bayes.mismatch.data import BinnedData
from shj_bayes.mismatch.fitter import Fitter
from shj_bayes.mismatch.hypothesis import (
    ALPHA,
    CONSTANT,
    DIRECTION,
    MIN_EFFECT,
    MOTION,
    PRIOR_INCLUSION,
    SLIP,
    Candidate,
    Hypothesis,
    columns_of,
    force_distance,
    force_of,
    largest_size_of,
    missed_by,
    replaced,
    same_twice,
    screen,
    second_of,
    size_of,
    tolerance,
    without,
)
from shj_bayes.mismatch.laplace import Laplace, visible, zero_of
from shj_bayes.mismatch.moves import Search, beside_direction, following
from shj_bayes.model.curve import Curve
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.results.diagnosis import NOTHING_MISSING, SIGMA_90, DiagnosisVerdict

T = TypeVar("T")


class Reason(StrEnum):
    """Why a verdict is what it is."""

    NOTHING = NOTHING_MISSING
    SURE = "one set of coordinates holds all but 5 % of the probability"
    SEVERAL = "no set of coordinates holds 95 % of the probability"
    NAMES = "several mechanisms have the curve that was found"
    NO_FORM = "no known mechanism has the curve that was found"
    LEFT_OVER = "beside what was found more is left than a model may miss"
    CHATTER = "the force scatters while the connection slides, by more than noise can"
    FLUCTUATES = "the force fluctuates within a stroke by more than noise can"
    NOT_BORNE_OUT = "what was found does not improve cycles that were left out"
    SLOW_NOISE = "what is left changes slowly and is larger than noise can be"


@dataclass(frozen=True, eq=False)
class FoundEffect:
    """One class of the answer."""

    member: Candidate  # the class, as a formula where one follows the curve
    probability: float  # that the device holds it
    evidence: float  # log Bayes factor over the model without it, nats: over the base law where it is the only one
    size: float  # largest force that it makes and that the base law could not (99th percentile), as a share of Fy
    drawn: Hypothesis | None  # the model with a curve in its place, where there is one
    place: int  # its place among the classes of that model
    # Mechanisms of the catalogue that may have the curve, with their probabilities within the class, most probable
    # first and as many as hold 95 %; what was measured beside the force is its own name. None where no formula follows
    # the curve.
    names: tuple[tuple[str, float], ...]

    @property
    def named(self) -> bool:
        """Whether it has a name."""
        return bool(self.names)

    @property
    def curve(self) -> Curve | None:
        """The same as a curve, where there is one."""
        return self.drawn.members[self.place].variant.curve if self.drawn is not None else None

    @property
    def directions(self) -> dict[str, float]:
        """Directions that have a curve of their own, with their signs."""
        return {"push": 1.0, "pull": -1.0} if self.curve is not None and self.curve.sides else {"both": 1.0}


@dataclass(frozen=True, eq=False)
class Answer:
    """What a search says."""

    verdict: DiagnosisVerdict
    reason: Reason
    shown: Hypothesis  # the model that is shown: the most probable one, with formulas where they follow the curves
    findings: tuple[FoundEffect, ...]  # its classes
    sets: tuple[tuple[frozenset[str], float], ...]  # of classes of a size that matters, most probable first
    alternatives: dict[frozenset[str], Hypothesis]  # the best hypothesis of each of these sets
    p_value: float  # upper limit of the chance of such evidence if nothing were missing
    left_over: float  # size of the generic discrepancy, as a share of Fy
    inclusion: dict[str, float]  # probability of every class that was fitted


def answer_of(out: Search, dropped: Collection[str] = ()) -> Answer:
    """Weigh what a finished search found; no curve is taken apart into classes that were dropped."""
    ranked = sorted(out.found.values(), key=lambda h: -h.log_weight)
    probability = softmax([h.log_weight for h in ranked])
    # A set is what matters of a hypothesis; improbable hypotheses are taken as they are.
    reduced: dict[frozenset[str], float] = {}
    best: dict[frozenset[str], Hypothesis] = {}
    for h, p in zip(ranked, probability, strict=True):
        shown, shares = h, {h.key: 1.0}
        if p >= 1e-6:
            shown = _split(out, h, dropped)
            shares = truly_there(out, shown, that_matter(out, shown))
            for name in (CONSTANT, DIRECTION):
                if is_zero_elsewhere(out.data, shown, name):  # the test says nothing of it: as probable as before
                    shares = _shared(shares, name, PRIOR_INCLUSION)
        for key, share in shares.items():
            reduced[key] = reduced.get(key, 0.0) + float(p) * share
            best.setdefault(key, shown)
    sets = tuple(sorted(reduced.items(), key=lambda item: -item[1]))
    nothing = reduced.get(frozenset(), 0.0)
    inclusion: dict[str, float] = {}
    for key, p in reduced.items():
        for name in sorted(key):
            inclusion[name] = min(inclusion.get(name, 0.0) + p, 1.0)  # or more than 1 by rounding
    sure = nothing >= 1.0 - ALPHA
    top = next((key for key, _ in sets if key and not sure), frozenset[str]())
    findings, shown = _findings(out, best[top], top, inclusion)
    left = discrepancy_size(out, shown.state)
    verdict, reason = _verdict(out, findings, dict(sets).get(top, 0.0), nothing, left)
    return Answer(verdict, reason, shown, findings, sets, best, _p_value(out), left, inclusion)


def _shared(shares: Mapping[frozenset[str], float], name: str, there: float) -> dict[frozenset[str], float]:
    """Give the shares of sets of classes with a class in those that hold it with a probability."""
    out: dict[frozenset[str], float] = {}
    for key, p in shares.items():
        held = there if name in key else 0.0
        for own, part in ((key - {name}, 1.0 - held), (key, held)):
            out[own] = out.get(own, 0.0) + p * part
    return {key: p for key, p in out.items() if p}


def _verdict(
    out: Search, findings: Sequence[FoundEffect], probability: float, nothing: float, left: float
) -> tuple[DiagnosisVerdict, Reason]:
    """Give the verdict on findings of a probability, beside which so much is left, a share of Fy.

    `nothing` is the probability that nothing of a size that matters is missing.
    """
    largest = max((f.size for f in findings), default=0.0)
    unknown = {
        Reason.SLOW_NOISE: out.metric.is_rough and not out.chatter and out.metric.setting.is_slow(out.data),
        Reason.FLUCTUATES: out.metric.is_rough and not out.chatter,
        Reason.LEFT_OVER: left > out.matters_in_strokes and left > largest / 3.0,
        Reason.NO_FORM: nothing < ALPHA
        and any(not f.named and (f.size >= out.matters or (f is findings[0] and not out.chatter)) for f in findings),
    }
    several = {
        Reason.SEVERAL: bool(findings) and probability < 1.0 - ALPHA,
        Reason.NAMES: any(len(f.names) > 1 for f in findings),
    }
    for verdict, reasons in ((DiagnosisVerdict.UNKNOWN, unknown), (DiagnosisVerdict.FAMILY, several)):
        if any(reasons.values()):
            return verdict, next(reason for reason, true in reasons.items() if true)
    if findings:
        return DiagnosisVerdict.NAMED, Reason.SURE
    return (DiagnosisVerdict.NAMED, Reason.CHATTER) if out.chatter else (DiagnosisVerdict.ADEQUATE, Reason.NOTHING)


def that_matter(out: Search, h: Hypothesis) -> frozenset[str]:
    """Classes of a hypothesis that may be of a size that matters: the smallest are left out one after another.

    A class is left out where the upper limit of its size, exceeded with a probability of `ALPHA`, is too small. What is
    left is taken at its size in a fit without them: two classes that stand in for each other are both small.
    """
    sizes = [largest_size_of(out.data, h, i) / out.matters_of(h, i) for i in range(len(h.members))]
    if CONSTANT in h.key:  # less what the zero of the load cell takes off it: seen is the sum of both
        i = [m.of.id for m in h.members].index(CONSTANT)
        zero = zero_of(h.metric or out.metric, h.state)[0] / out.data.scale_kN
        size = h.state.values_of(h.members[i].variant.effect)["size"]
        if zero * size < 0.0:
            sizes[i] -= min(abs(zero), abs(size)) / out.matters_of(h, i)
    if min(sizes, default=math.inf) >= 1.0:
        return h.key
    rest = h.key - {h.members[int(np.argmin(sizes))].of.id}
    if rest in out.found:
        return that_matter(out, out.found[rest])
    return frozenset(m.of.id for m, size in zip(h.members, sizes, strict=True) if size >= 1.0)


def truly_there(out: Search, h: Hypothesis, key: frozenset[str]) -> dict[frozenset[str], float]:
    """Split the probability of a hypothesis: a class may be what the formulas of larger ones miss.

    Of its classes `key` matter. Gives the share of the probability for each set of classes; the one with the most
    evidence is in all of them.
    """
    sizes = {m.of.id: size_of(out.data, h, i) for i, m in enumerate(h.members) if m.of.id in key}
    known = {name: out.found[h.key - {name}] for name in sizes if h.key - {name} in out.found}
    gains = {name: h.log_weight - out.best_within(rest.key) for name, rest in known.items()}
    order = gains if len(gains) == len(sizes) else sizes
    ranked = sorted(sizes, key=lambda name: (-order[name], name))
    shares = {frozenset(ranked): 1.0}
    for place, name in enumerate(ranked):
        if place and name in known:
            larger = {other: sizes[other] for other in ranked[:place]}
            shares = _shared(shares, name, float(expit(-_missed_instead(out, h, known[name], larger))))
    return shares


def is_zero_elsewhere(data: BinnedData, h: Hypothesis, name: str) -> bool:
    """Whether a class that shifts the loops may be a force that a hypothesis adds over position or time, 0 elsewhere.

    Where that is is a convention: a curve may be 0 wherever the constant makes up for it. A spring works about
    mid-stroke, or about the zero of the displacement: in a test to one side the two differ by a constant.
    """
    shift = next((m.variant.effect for m in h.members if m.of.id == name), None)
    if shift is None:
        return False
    history, used = data.blocks[0].history, data.blocks.used > 0
    middle_mm = float(history.motion.displacement_mm[-1] - history.position_mm[-1])
    size_kN = h.state.values_of(shift)["size"] * data.scale_kN
    for place, member in enumerate(h.members):
        curve = member.variant.curve
        if member.of.coordinate not in ("position", "time") or member.of.action != "added":
            continue
        added_kN = force_of(data, h, place, h.state.z[None])[0][used]
        if curve is not None:
            if name == CONSTANT and curve.period is None and added_kN.min() <= -size_kN <= added_kN.max():
                return True
        elif member.of.coordinate == "position" and middle_mm:
            there = int(np.argmin(np.abs(data.blocks.channel("position_mm")[used] + middle_mm)))
            if abs(size_kN + added_kN[there]) <= tolerance(data, h, place) * data.scale_kN:
                return True
    return False


def _missed_instead(out: Search, h: Hypothesis, rest: Hypothesis, larger: Mapping[str, float]) -> float:
    """Log odds that a hypothesis without a class is the true one, and its larger forms miss what the class does.

    Both are weighed beside what the formulas of these classes, with their sizes, may miss (`missed_by`): a curve over
    the coordinate of each, or over the slip where it acts on the motion, as that acts at reversals. A constant, or one
    for each direction, has no form that could miss something.
    """
    weights = []
    for one in (rest, h):
        metric = one.metric or out.metric
        drawn = {m.of.id for m in one.members if m.variant.curve is not None}
        missed = []
        for of in (m.of for m in one.members if m.of.id in larger):
            over = out.fitter.classes.get(SLIP) if of.action == MOTION else of
            if over is not None and over.id not in drawn:
                missed.append(missed_by(out.data, one.state, over, larger[of.id]))
        beside = one.state.beside(*(curves for curves in missed if curves is not None))
        weights.append(one.log_weight + metric.gaussian(beside).log_evidence - one.state.gaussian.log_evidence)
    return weights[0] - weights[1]


def discrepancy_size(out: Search, state: Laplace) -> float:
    """Size of what the generic discrepancy takes up of a residual (99th percentile), as a share of Fy."""
    taken = out.metric.integrated_out(state.residual)[0]
    return float(visible(out.data, state.jacobian, taken[:, None])[0])


def _findings(
    out: Search, h: Hypothesis, top: frozenset[str], inclusion: dict[str, float]
) -> tuple[tuple[FoundEffect, ...], Hypothesis]:
    """Put formulas in the place of curves that they follow; give the findings, and the hypothesis with them."""
    places = [place for place, member in enumerate(h.members) if member.of.id in top]
    for place in places:
        if h.members[place].variant.curve is not None:
            h = _followed(out, h, place)
    names: dict[int, tuple[tuple[str, float], ...]] = {}
    for place in places:
        written = h.members[place].variant.curve
        if written is None or written.over.measured:
            h, names[place] = _named(out, h, place)
    found = []
    for place in places:
        of, size, drawn = h.members[place].of, size_of(out.data, h, place), _as_curve(out.fitter, h, place)
        evidence = h.log_weight - out.best_within(h.key - {of.id})
        found.append(
            FoundEffect(h.members[place], inclusion[of.id], evidence, size, drawn, place, names.get(place, ()))
        )
    return tuple(sorted(found, key=lambda f: -f.size)), h


def _followed(out: Search, h: Hypothesis, place: int) -> Hypothesis:
    """Give the hypothesis with the formula that follows a curve best, or with the curve where none does.

    A small curve is within what matters of everything: a formula in its place must be better than nothing, and matter.
    """
    best, score = h, out.best_within(h.key - {h.members[place].of.id})
    for new in following(out.fitter, h, place):
        if new.log_weight > score and largest_size_of(out.data, new, place) >= MIN_EFFECT:
            best, score = new, new.log_weight
    return best


def _as_curve(fitter: Fitter, h: Hypothesis, place: int) -> Hypothesis | None:
    """Give a hypothesis with a curve in the place of a formula, beside all else that it holds: what can be drawn.

    A curve stays as it is; None where the class has none.
    """
    member = h.members[place]
    if member.variant.curve is not None:
        return h
    members, z = without(fitter.metric.data, h, place)
    looked = fitter.candidates_of(member.of.id, curves=True)
    if not looked or any(same_twice(looked[0], m) for m in members):
        return None
    rest = fitter.fitted(members, z)
    if rest is None:
        return None
    best = screen(fitter.metric, rest.state, looked)[0]
    first = columns_of(fitter.metric.data, h.state, place)[0]
    start = np.insert(z, [first] * len(best.variant.effect.parameters), 0.0)
    return fitter.fitted(replaced(h, place, best), start)


def _split(out: Search, h: Hypothesis, dropped: Collection[str] = ()) -> Hypothesis:
    """Give the hypothesis with formulas for a curve that holds their class beside its own, where they follow it.

    Of the other class alone, or of both: they say what it is; see `hypothesis.second_of`.
    """
    for place, member in enumerate(h.members):
        second, fitter = second_of(member), out.fitter
        if second is None or second in (*h.key, *dropped) or second not in fitter.classes:
            continue
        allowed = tolerance(out.data, h, place)
        rest, ones = fitter.fitted(*without(out.data, h, place)), []
        if rest is not None:
            forms = fitter.forms_of(fitter.classes[second], rest.members, rest.state.z)
            ones = fitter.all_fitted(((*rest.members, f), f) for f in forms)
        for one in ones:
            if force_distance(out.data, h, one) <= allowed:
                return one
        both = beside_direction(out, h, place).found.get(h.key | {second})
        if both is not None and force_distance(out.data, h, both) <= allowed:
            return both
    return h


def _named(out: Search, h: Hypothesis, place: int) -> tuple[Hypothesis, tuple[tuple[str, float], ...]]:
    """Weigh the formulas that fit in a place by their evidence.

    Give the hypothesis with the best formula of the most probable mechanism, and the mechanisms that hold all but
    `ALPHA` of the probability.
    """
    own = h.members[place]
    acting = {e.mechanism for e in catalogue().values() if (own.of.action, own.of.coordinate) in e.acts}
    if len(acting - out.fitter.hidden) < 2:
        return h, ((own.variant.effect.mechanism, 1.0),)
    forms = {own.variant.effect.id: h}
    for form in out.fitter.forms(h, place):
        new, name = out.fitter.fitted(replaced(h, place, form), form.start), form.variant.effect.id
        if new is None or (name in forms and _height(new, place) <= _height(forms[name], place)):
            continue
        if name in forms or largest_size_of(out.data, new, place) >= MIN_EFFECT:
            forms[name] = new
    by_mechanism: dict[str, list[Hypothesis]] = {}
    for one in forms.values():
        by_mechanism.setdefault(one.members[place].variant.effect.mechanism, []).append(one)
    heights = {name: [_height(one, place) for one in ones] for name, ones in by_mechanism.items()}
    whole = float(logsumexp([height for own in heights.values() for height in own]))
    shares = {name: min(sum(math.exp(height - whole) for height in own), 1.0) for name, own in heights.items()}
    ranked = sorted(shares.items(), key=lambda item: -item[1])
    return max(by_mechanism[ranked[0][0]], key=lambda one: _height(one, place)), most_probable(ranked)


def _height(h: Hypothesis, place: int) -> float:
    """Log weight of a hypothesis but for that of the formula in a place, which may be that of all formulas there."""
    return h.log_weight - math.log(h.members[place].variant.weight)


def most_probable(ranked: Sequence[tuple[T, float]]) -> tuple[tuple[T, float], ...]:
    """First items of a list, most probable first, that hold all but `ALPHA` of the probability."""
    before = np.cumsum([0.0, *(p for _, p in ranked)])[:-1]
    return tuple(item for item, sum_before in zip(ranked, before, strict=True) if sum_before < 1.0 - ALPHA)


def _p_value(out: Search) -> float:
    """Bound on the chance of such evidence: under the null a Bayes factor of k has a chance of at most 1/k (Ville).

    Of something over nothing: the mean over all sets of the classes that are looked for, each with its probability
    before the test; those that were not fitted count as 0.
    """
    base = out.found[frozenset()].log_weight
    rest = [h.log_weight for key, h in out.found.items() if key]
    something = math.expm1(-len(out.fitter.classes) * math.log1p(-PRIOR_INCLUSION))  # odds before the test
    factor = logsumexp(rest) - base - math.log(something) if rest else -math.inf
    return float(min(1.0, math.exp(-factor))) if factor > 0 else 1.0


def rivals_of(answer: Answer) -> tuple[tuple[frozenset[str], float], ...]:
    """Find the smallest list of sets that holds all but `ALPHA` of the probability, most probable first."""
    return most_probable(answer.sets)


def curve_band(out: Search, f: FoundEffect, n: int = 61, direction: float = 1.0) -> dict[str, FloatArray] | None:
    """Curve of a finding over its coordinate or its period, with its 90 % band, % of Fy; None where there is none.

    Of curves for push and pull, that of a direction, 1 or -1.
    """
    if f.drawn is None or f.curve is None:
        return None
    curve, state = f.curve, f.drawn.state
    own = columns_of(out.data, state, f.place)
    share = np.linspace(0.0, 1.0, n)
    mean, cov = state.z[own], state.covariance[np.ix_(own, own)]
    rows = curve.rows(share, np.full(n, direction))
    centre = rows @ mean
    half = SIGMA_90 * np.sqrt(np.einsum("ij,jk,ik->i", rows, cov, rows))
    history = out.data.blocks[0].history
    at = curve.over.value_of(share, history) if curve.period is None else curve.period * share
    return {"at": at, "mean": 100 * centre, "q05": 100 * (centre - half), "q95": 100 * (centre + half)}
