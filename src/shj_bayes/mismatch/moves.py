"""Moves of a search: each takes what was found so far and gives what is found with it.

A search holds hypotheses, the best of each set of classes. A move fits others and keeps those that are better.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.mismatch.data import BinnedData, ErrorModel
from shj_bayes.mismatch.fitter import Fitter, noise_beside
from shj_bayes.mismatch.hypothesis import (
    CONSTANT,
    DIRECTION,
    DISTANCE,
    EXPLAINED,
    LOG_PRIOR_ODDS,
    MIN_EFFECT,
    MOTION,
    Candidate,
    Dependence,
    Hypothesis,
    candidates,
    columns_of,
    force_distance,
    is_curve,
    joined,
    replaced,
    screen,
    second_of,
    size_of,
    tolerance,
    without,
)
from shj_bayes.mismatch.laplace import laplace_under, visible
from shj_bayes.mismatch.periodic import Chatter
from shj_bayes.model.coordinates import coordinates_of

PROMISING = 0.7  # of what matters, to first order; less is not followed
ROUGHLY = 2.0  # factor by which an effect may be larger than it is to first order where its search begins
BEAM = 2  # hypotheses of each number of classes to which another class is added
BEAM_IN_PLACE = 4  # wider: one of two classes that do together what a curve does comes nowhere near it alone
MOST = 5  # candidates that are followed at each step
DEPTH = 5  # classes in a hypothesis at most
LARGEST_OF = 2.576  # 99th percentile of a normal distribution, in standard deviations
LARGEST = 160  # parameters of a model that is grown further
RIVAL = 30.0  # nats; hypotheses that are worse are not followed
FOLLOWED = 100.0  # nats; while classes are still to come, likewise


@dataclass(frozen=True, eq=False)
class Search:
    """What a search for the classes that a device holds has found."""

    fitter: Fitter  # what hypotheses are fitted under
    found: Mapping[frozenset[str], Hypothesis] = field(default_factory=dict)  # the best one of each set of classes
    curves: Mapping[frozenset[str], Hypothesis] = field(default_factory=dict)  # the same with curves only, no formulas
    bends: frozenset[str] = frozenset()  # effects on the motion whose bends the blocks of the recordings follow
    chatter: Chatter | None = None  # scatter that the sliding makes, beside the best hypothesis
    tell: Callable[[str], None] = lambda _: None  # gets one line for each step

    @property
    def data(self) -> BinnedData:
        """The recordings."""
        return self.metric.data

    @property
    def metric(self) -> ErrorModel:
        """Noise and discrepancy that hypotheses are weighed under."""
        return self.fitter.metric

    @property
    def best(self) -> Hypothesis:
        """The most probable hypothesis."""
        return max(self.found.values(), key=lambda h: h.log_weight)

    def best_within(self, key: frozenset[str]) -> float:
        """Largest log weight of the hypotheses that hold no other classes than these."""
        return max((h.log_weight for own, h in self.found.items() if own <= key), default=-math.inf)

    def ranked(self, n: int) -> list[Hypothesis]:
        """Hypotheses with so many classes, most probable first."""
        return sorted((h for h in self.found.values() if len(h.members) == n), key=lambda h: -h.log_weight)

    def keep(self, new: Hypothesis | None) -> "Search":
        """Keep a hypothesis if it is better than what is known under its key; nothing where there was no fit."""

        def kept(known: Mapping[frozenset[str], Hypothesis], new: Hypothesis) -> Mapping[frozenset[str], Hypothesis]:
            has = known.get(new.key)
            return known if has is not None and has.log_weight >= new.log_weight else {**known, new.key: new}

        if new is None:
            return self
        curves = kept(self.curves, new) if all(is_curve(m) for m in new.members) else self.curves
        return replace(self, found=kept(self.found, new), curves=curves)

    def add(self, members: tuple[Candidate, ...], start: FloatArray) -> "Search":
        """Fit a hypothesis from a start, and keep it."""
        return self.keep(self.fitter.fitted(members, start))

    @property
    def matters(self) -> float:
        """Size that a class must have, as a share of Fy: beside a force that fluctuates a fifth of what that makes."""
        fluctuates = (1.0 - EXPLAINED) * LARGEST_OF * self.metric.fluctuation if self.metric.is_rough else 0.0
        return max(MIN_EFFECT, fluctuates)

    @property
    def matters_in_strokes(self) -> float:
        """Size that what begins anew in each stroke must have: teeth lower the mean force there by up to their size."""
        return self.chatter.size if self.chatter else self.matters

    def matters_of(self, h: Hypothesis, place: int) -> float:
        """Size that a member must have: that of its class, but for a larger force that teeth do not make.

        They lower the mean force most in the direction in which they are largest.
        """
        of = h.members[place].of
        teeth = self.chatter if of.id == DIRECTION else None
        if teeth and teeth.lowers * h.state.z[columns_of(self.data, h.state, place)[0]] > 0.0:
            return self.matters
        return self.matters_among(of)

    def matters_among(self, of: Dependence) -> float:
        """Size that a class must have: from stroke to stroke teeth lower the mean force by as much as they differ."""
        goes = {over.goes for over in coordinates_of(of.coordinate)}
        if "stroke" in goes or of.action == MOTION:
            return self.matters_in_strokes
        among = of.action == "capacity" and ("test" in goes or of.id == DIRECTION)
        return max(self.matters, self.chatter.apart) if self.chatter and among else self.matters


def try_constant(search: Search) -> Search:
    """Fit the base law beside a constant force, from where the search begins: the law alone may lie far off."""
    data, constant = search.data, constant_of(search.fitter)
    residual = data.likelihood.residual(data.z[None])[0]
    size = float(residual @ data.blocks.used / data.blocks.used.sum()) / data.scale_kN
    if constant is None or abs(size) <= MIN_EFFECT:
        return search
    return search.add((constant,), np.append(data.z, free_size(constant, size)))


def constant_of(fitter: Fitter) -> Candidate | None:
    """Give the constant force that is looked for; None where it is not."""
    return next(iter(fitter.candidates_of(CONSTANT)), None)


def free_size(constant: Candidate, size: float) -> FloatArray:
    """Size of a constant force, a share of Fy, in its unbounded space."""
    return constant.variant.effect.parameters[0].to_free(np.asarray(size))


def add_one(search: Search, h: Hypothesis) -> Search:
    """Fit the promising larger hypotheses."""
    fitter = search.fitter
    if h.state.z.size > LARGEST:
        return search
    listed = fitter.screen(h)
    best = max((c.gain for c in listed), default=0.0)
    tried: dict[tuple[str, bool], int] = {}
    # What acts on the motion has places of its own: to first order many curves do as well as a gap.
    followed: set[str] = set()
    for c in listed:
        enough = c.gain + LOG_PRIOR_ODDS > -1.0 and c.gain > 0.5 * best - 20.0
        effect = c.variant.curve is None and c.gain > 10.0
        allowed = 2 if c.variant.curve is None else 1
        kind = (c.of.id, c.variant.curve is None)
        if not (enough or effect) or tried.get(kind, 0) >= allowed:
            continue
        moves = c.of.action == MOTION
        if len(followed) >= MOST and not moves and c.of.id not in followed:
            continue
        size = visible(search.data, h.state.jacobian, c.change[:, None])[0] * (ROUGHLY if effect else 1.0)
        if size < PROMISING * (search.matters if c.of.id == DIRECTION else search.matters_among(c.of)):
            continue
        level = search.ranked(len(h.members) + 1)
        whole = not level or any(m.of.action == MOTION for m in (*h.members, c))  # `moving` may follow it
        floor = -math.inf if whole else near_to(level[0].log_weight, h.log_weight, FOLLOWED)
        new = fitter.fitted((*h.members, c), joined(h, c), floor)
        search = search.keep(new)
        # A wave that follows the cycles leaves its place to the next one.
        if new is not None or c.variant.curve is None:
            tried[kind] = tried.get(kind, 0) + 1
            if not moves:
                followed.add(c.of.id)
    return search


def near_to(height: float, before: float, nats: float) -> float:
    """Log weight that is near to the best, which has gone from `before` to a height: a curve may miss a part."""
    return height - max(nats, (1.0 - EXPLAINED) * (height - before))


def moving(search: Search, n: int) -> list[Hypothesis]:
    """Most probable hypothesis with so many classes of which one acts on the motion, while the noise is capped.

    As long as other large effects are still to come, a curve over position does more than a gap does.
    """
    own = [h for h in search.ranked(n) if any(m.of.action == MOTION for m in h.members)]
    return own[:1] if search.metric.is_capped else []


def replace_by_formula(search: Search, h: Hypothesis, first: int = 0, *, again: bool = False) -> Search:
    """Try the formulas of a class in the place of each of its curves, and of what acts on the motion.

    Of the members from the place `first` on. `again` tries them in the place of all formulas: the best one was chosen
    beside other classes and other noise.
    """
    for place in range(first, len(h.members)):
        h = search.found[h.key]
        member = h.members[place]
        if again or member.variant.curve is not None or member.of.action == MOTION:
            tried = ((replaced(h, place, form), form) for form in search.fitter.forms(h, place))
            if second_of(member) == DISTANCE and DISTANCE not in h.key:
                for one in search.fitter.all_fitted(tried)[:BEAM]:
                    search = _beside_distance(search.keep(one), one, first)
            else:
                search = search.keep(search.fitter.best_fitted(tried, h.log_weight))
        search = beside_direction(search, h, place)
    return search


def _beside_distance(search: Search, one: Hypothesis, first: int) -> Search:
    """Try a function of the distance beside a formula in the place of a curve over position, which holds both."""
    # A curve: to first order a formula beside one that is far off may seem to do what it cannot.
    other = search.fitter.candidates_of(DISTANCE, curves=True)
    if not other:
        return search
    best = screen(search.metric, one.state, other)[0]
    search = search.add((*one.members, best), joined(one, best))
    both = search.found.get(one.key | {DISTANCE})
    return search if both is None else replace_by_formula(search, both, first)


def beside_direction(search: Search, h: Hypothesis, place: int) -> Search:
    """Try a difference of push and pull, beside a formula or a curve, in the place of curves for push and for pull.

    The rest is fitted with the difference first: beside such curves the parameters of the law may be anywhere.
    """
    fitter, of = search.fitter, h.members[place].of
    if second_of(h.members[place]) != DIRECTION or DIRECTION in h.key or DIRECTION not in fitter.classes:
        return search
    rest = fitter.fitted(*without(search.data, h, place))
    if rest is None:
        return search
    best = screen(search.metric, rest.state, fitter.candidates_of(DIRECTION))[0]
    one = fitter.fitted((*rest.members, best), joined(rest, best))
    if one is None:
        return search
    curve = screen(search.metric, one.state, fitter.candidates_of(of.id, curves=True))[0]
    search = search.keep(one).add((*one.members, curve), joined(one, curve))
    for form in fitter.forms_of(of, one.members, one.state.z):
        search = search.add((*one.members, form), form.start)
    return search


def drop_one(search: Search, h: Hypothesis) -> Search:
    """Fit the hypotheses with one class less."""
    for place in range(len(h.members)):
        rest, z = without(search.data, h, place)
        known = search.found.get(frozenset(m.of.id for m in rest))
        if known is None or not all(a.variant is b.variant for a, b in zip(known.members, rest, strict=True)):
            search = search.add(rest, z)
    return search


def swap_one(search: Search) -> Search:
    """Try what else could stand in the place of each class of the best hypothesis."""
    for place in range(len(search.best.members)):
        h = search.best
        if 1 < len(h.members) > place:
            less = h.key - {h.members[place].of.id}
            if less not in search.found:
                search = drop_one(search, h)
            if less in search.found:
                fitter = replace(search.fitter, floor=h.log_weight - RIVAL)
                grown = add_one(replace(search, fitter=fitter), search.found[less])
                search = replace(grown, fitter=search.fitter)
    return search


def split_curve(search: Search) -> Search:
    """Look for two classes in the place of each curve that matters and that no formula follows.

    Neither alone comes near what formulas over two coordinates do together. Not where more noise does as well, and not
    while the noise is capped.
    """
    if search.metric.is_capped:
        return search
    for place, member in enumerate(search.best.members):
        h = search.best
        is_there = place < len(h.members) and h.members[place] is member
        if not is_there or member.variant.curve is None or len(h.members) == DEPTH:
            continue
        if size_of(search.data, h, place) < search.matters_of(h, place):
            continue
        rest = search.fitter.fitted(*without(search.data, h, place))
        if rest is None or is_no_better_than_noise(search.fitter, h, rest):
            continue
        if next(following(search.fitter, h, place), None) is None:
            search = _in_place_of_curve(search, h, member.of, rest)
    return search


def _in_place_of_curve(search: Search, h: Hypothesis, of: Dependence, rest: Hypothesis) -> Search:
    """Fit the promising hypotheses with two classes in the place of a curve; `rest` is the hypothesis without it."""
    search.tell(f"looking for two dependences in the place of {of.id}")
    looked = [c for c in search.fitter.looked if c.of.id != of.id or c.variant.curve is None]
    floor, n = h.log_weight - RIVAL, len(rest.members)
    part = replace(search, fitter=replace(search.fitter, looked=looked, floor=floor), found={rest.key: rest}, curves={})
    part = add_one(part, rest)
    for one in part.ranked(n + 1)[:BEAM_IN_PLACE]:
        part = add_one(part, one)
        for form in part.fitter.forms_of(of, one.members, one.state.z) if of.id not in one.key else ():
            part = part.add((*one.members, form), form.start)
    for one in part.ranked(n + 2)[:BEAM_IN_PLACE]:
        part = replace_by_formula(part, one, n)
    for one in drop_one(part, part.best).found.values():
        if one.log_weight > floor:
            search = search.add(one.members, one.state.z)
    return search


def following(fitter: Fitter, h: Hypothesis, place: int) -> Iterator[Hypothesis]:
    """Give the hypotheses with a formula in the place of a curve that it follows: within what it may miss."""
    allowed = tolerance(fitter.metric.data, h, place)
    for form in fitter.forms(h, place):
        one = fitter.fitted(replaced(h, place, form), form.start)
        if one is not None and force_distance(fitter.metric.data, h, one) <= allowed:
            yield one


def is_no_better_than_noise(fitter: Fitter, h: Hypothesis, less: Hypothesis) -> bool:
    """Whether a hypothesis has no more evidence than one with less, each under its most probable noise."""
    setting = fitter.metric.setting
    weights = [one.log_weight for x in (h, less) if (one := fitter.with_own_noise(x, setting))]
    return len(weights) > 1 and weights[1] >= weights[0]


def follow_bends(search: Search) -> Search:
    """Fit anew in blocks that follow the bends of what acts on the motion: at a gap a block has two."""
    h = search.best
    bends = frozenset(m.variant.effect.id for m in h.members if m.of.action == MOTION)
    if bends <= search.bends:
        return search
    data = search.data.finer_at(h.state.model, h.state.z)
    return look_for(replace(search, bends=bends), data, tuple(search.fitter.classes.values()))


def look_for(search: Search, data: BinnedData, classes: tuple[Dependence, ...]) -> Search:
    """Look for given classes from here on in such blocks, beside what was found."""
    h = search.best
    metric, rough = laplace_under(data, search.metric.setting, data.device, data.z)
    fitter = replace(search.fitter, metric=metric, looked=candidates(data, rough, classes))
    return refit_noise(_again(replace(search, fitter=fitter), h))


def refit_noise(search: Search) -> Search:
    """Find the noise beside the best hypothesis and everything that could be added; fit the best anew."""
    h, fitter = search.best, search.fitter
    metric = noise_beside(search.data, h.state, fitter.screen(h), search.metric.setting)
    return _again(replace(search, fitter=replace(fitter, metric=metric)), h)


def _again(search: Search, h: Hypothesis) -> Search:
    """Fit the hypotheses in contention with one of them anew."""
    kept = [*search.found.values(), *search.curves.values()]
    followed = moving(search, len(h.members))
    search = replace(search, found={}, curves={})
    for one in kept:
        near = one.log_weight > h.log_weight - RIVAL or one in followed
        if near or not one.members or one.key == h.key:
            search = search.add(one.members, one.state.z)
    return search


# Tried in this order where one class more makes nothing better; another move is one more function of a search.
LAST_MOVES: tuple[Callable[[Search], Search], ...] = (split_curve, swap_one)
