"""Which classes a device holds: sets of them are compared by their evidence, grown and shrunk until none is better."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.special import logsumexp, ndtr

from shj_bayes.inference.squares import start_values
from shj_bayes.mismatch.classes import (
    DOUBT,
    EXPLAINED,
    FORMS,
    MATTERS,
    PRESENT,
    Candidate,
    Class,
    Variant,
    candidates,
    size_weights,
)
from shj_bayes.mismatch.hypothesis import (
    CONSTANT,
    DIRECTION,
    DISTANCE,
    MOTION,
    TEETH,
    Hypothesis,
    away,
    columns_of,
    is_curve,
    joined,
    may_miss,
    replaced,
    same_twice,
    second_of,
    size_of,
    without,
)
from shj_bayes.mismatch.periodic import (
    Chatter,
    chatter_of,
    follows_cycles,
    is_over_a_clock,
    of_whole_cycles,
    resolved,
    waves,
)
from shj_bayes.mismatch.scene import MODEL_ERROR, Metric, NoiseSetting, Scene
from shj_bayes.mismatch.screen import screen
from shj_bayes.mismatch.state import State, find_noise, settle, settle_under, visible, zero_of
from shj_bayes.model.coordinates import coordinates_of
from shj_bayes.model.curve import SIZES
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.parameters import FloatArray

NOISE_MOST = 0.03  # of the largest force: noise beyond it is no noise of a load cell
PROMISING = 0.7  # of what matters, to first order; less is not followed
ROUGHLY = 2.0  # factor by which an effect may be larger than it is to first order where its search begins
BEAM = 2
BEAM_IN_PLACE = 4  # wider: one of two classes that do together what a curve does comes nowhere near it alone
MOST, MOST_FINAL = 5, 6  # candidates that are followed at each step
DEPTH = 5
LARGEST_OF = 2.576  # 99th percentile of a normal distribution, in standard deviations
LARGEST = 160  # parameters of a model that is grown further
WIDE = 2.0  # times the size of a curve, or of an effect where its search begins: what noise is found beside
FLAT = 1e3  # of Fy: a constant force as large as any
RIVAL = 30.0  # nats; hypotheses that are worse are not followed
FOLLOWED = 100.0  # nats; while classes are still to come, likewise
ODDS = math.log(PRESENT / (1.0 - PRESENT))


@dataclass(eq=False)
class Search:
    """A search for what a device holds."""

    scene: Scene  # the recordings
    # what to look for, with columns at the base law: they change little from model to model, and only choose what is
    # fitted
    looked: list[Candidate]
    metric: Metric  # noise and discrepancy, which are found beside all classes
    hidden: frozenset[str] = frozenset()  # mechanisms whose formulas are not tried
    tell: Callable[[str], None] = lambda _: None  # gets one line for each step
    found: dict[frozenset[str], Hypothesis] = field(default_factory=dict)  # hypotheses by their key
    curves: dict[frozenset[str], Hypothesis] = field(default_factory=dict)  # the same with curves only, no formulas
    # what could be added to each, best first
    screened: dict[frozenset[str], list[Candidate]] = field(default_factory=dict)
    bends: frozenset[str] = frozenset()  # effects on the motion whose bends the blocks follow
    floor: float = -math.inf  # log weight below which a hypothesis is not followed, however well it is fitted
    chatter: Chatter | None = None  # scatter that the sliding makes, beside the best hypothesis; see `listen`

    @property
    def classes(self) -> dict[str, Class]:
        """Classes that are looked for, by their ids."""
        return {c.of.id: c.of for c in self.looked}

    @property
    def matters(self) -> float:
        """Size that a class must have, as a share of Fy: beside a force that fluctuates a fifth of what that makes."""
        fluctuates = (1.0 - EXPLAINED) * LARGEST_OF * self.metric.fluctuation if self.is_rough else 0.0
        return max(MATTERS, fluctuates)

    @property
    def matters_in_strokes(self) -> float:
        """Size that what begins anew in each stroke must have: teeth lower the mean force there by up to their size."""
        return self.chatter.size if self.chatter else self.matters

    def matters_of(self, h: Hypothesis, place: int) -> float:
        """Size that a member must have: from stroke to stroke teeth lower the mean force by as much as they differ.

        They lower it most where they are largest: a larger force in that direction is not of their making.
        """
        of = h.members[place].of
        goes = {over.goes for over in coordinates_of(of.coordinate)}
        if "stroke" in goes or of.action == MOTION:
            return self.matters_in_strokes
        if self.chatter is None or of.action != "capacity":
            return self.matters
        if of.id == DIRECTION and self.chatter.lowers * h.state.z[columns_of(self.scene, h.state, place)[0]] > 0.0:
            return self.matters
        return max(self.matters, self.chatter.apart) if "test" in goes or of.id == DIRECTION else self.matters

    @property
    def is_rough(self) -> bool:
        """Whether the force fluctuates by more than the noise of a load cell."""
        return self.metric.fluctuation * self.scene.scale_kN > self.noise_most_kN

    @property
    def is_capped(self) -> bool:
        """Whether the noise would be larger than that of a load cell if it could: what is left is no smooth curve."""
        return self.metric.setting.size_kN(self.scene) > 0.999 * self.noise_most_kN

    @property
    def noise_most_kN(self) -> float:
        """Largest standard deviation that the noise of a load cell may have, kN."""
        return NOISE_MOST * self.scene.largest_kN

    @property
    def constant(self) -> Candidate | None:
        """A constant force; None where it is not looked for."""
        return next((c for c in self.looked if c.of.id == CONSTANT), None)

    @property
    def best(self) -> Hypothesis:
        """The most probable hypothesis."""
        return max(self.found.values(), key=lambda h: h.log_weight)

    def best_within(self, key: frozenset[str]) -> float:
        """Largest log weight of the hypotheses that hold no other classes than these."""
        return max((h.log_weight for own, h in self.found.items() if own <= key), default=-math.inf)

    def add(self, members: tuple[Candidate, ...], start: FloatArray) -> Hypothesis | None:
        """Fit a hypothesis from a start, and keep it; gives the best that is known under its key."""
        self._keep(self.fitted(members, start))
        return self.found.get(frozenset(member.of.id for member in members))

    def _keep(self, new: Hypothesis | None) -> None:
        """Keep a hypothesis if it is better than what was known under its key; nothing where there was no fit."""
        if new is None:
            return
        for kept in (self.found, self.curves):
            if kept is self.curves and not all(is_curve(m) for m in new.members):
                continue
            if new.key not in kept or kept[new.key].log_weight < new.log_weight:
                kept[new.key] = new

    def fitted(self, members: tuple[Candidate, ...], start: FloatArray, floor: float = -math.inf) -> Hypothesis | None:
        """Fit a hypothesis from a start; None where there is no fit.

        The fit is given up on its way where the log weight will not reach `floor`.
        """
        try:
            state = settle(self.scene, self.metric, self.model_of(members), start, max(self.floor, floor))
            # Or nothing can be weighed beside it. By half of the prior, as rounding differs when it is worked out anew.
            np.linalg.cholesky(0.5 * np.eye(state.z.size) + state.gaussian.inner)
            weight = state.evidence + len(members) * ODDS
            weight += sum(self._about_size(state, i, m) for i, m in enumerate(members))
        except np.linalg.LinAlgError:
            return None
        if any(self._follows_cycles(state, member) for member in members):
            return None
        return Hypothesis(members, state, weight) if math.isfinite(weight) else None

    def _follows_cycles(self, state: State, member: Candidate) -> bool:
        """Whether a formula or a wave over a clock does the same in each cycle."""
        curve, effect = member.variant.curve, member.variant.effect
        if not is_over_a_clock(member.of) or (curve is not None and curve.period is None):
            return False
        law = state.model.law_values(state.z)
        return follows_cycles(self.scene, effect, {name: law[f"{effect.id}.{name}"] for name in effect.names})

    def _about_size(self, state: State, place: int, member: Candidate) -> float:
        """Log evidence that a class gains when its size and its smoothness are averaged over."""
        extra = math.log(member.variant.weight)
        curve = member.variant.curve
        if curve is None:
            return extra
        own = columns_of(self.scene, state, place)
        given = state.gaussian
        its_own = np.isin(np.arange(state.z.size), own)
        gains = [given.sized(np.where(its_own, size / curve.size, 1.0)).gain for size in SIZES]
        return extra + float(logsumexp(np.array(gains) - given.gain + np.log(size_weights())))

    def screen(self, h: Hypothesis) -> list[Candidate]:
        """Candidates to add to a hypothesis, the best of each class, best first."""
        if h.key not in self.screened:
            rest = [c for c in self.looked if c.of.id not in h.key]
            free = {c.of.id: c.of for c in rest}.values()
            again = [wave for of in free for wave in waves(self.scene, self.metric, h.state, of)]
            apart = [c for c in (*rest, *again) if not any(same_twice(c, m) for m in h.members)]
            self.screened[h.key] = screen(self.metric, h.state, apart)
        return self.screened[h.key]

    def try_constant(self) -> None:
        """Fit the base law beside a constant force, from where the search begins: the law alone may lie far off."""
        residual = self.scene.residual(self.scene.device, self.scene.z[None])[0]
        size = float(residual @ self.scene.used / self.scene.used.sum()) / self.scene.scale_kN
        if self.constant is not None and abs(size) > MATTERS:
            self.add((self.constant,), np.append(self.scene.z, _free(self.constant, size)))

    def grow(self, h: Hypothesis) -> None:
        """Fit the promising larger hypotheses."""
        if h.state.z.size > LARGEST:
            return
        listed = self.screen(h)
        best = max((c.gain for c in listed), default=0.0)
        tried: dict[tuple[str, bool], int] = {}
        # What acts on the motion has places of its own: to first order many curves do as well as a gap.
        followed: set[str] = set()
        for c in listed:
            enough = c.gain + ODDS > -1.0 and c.gain > 0.5 * best - 20.0
            effect = c.variant.curve is None and c.gain > 10.0
            allowed = 2 if c.variant.curve is None else 1
            kind = (c.of.id, c.variant.curve is None)
            if not (enough or effect) or tried.get(kind, 0) >= allowed:
                continue
            moves = c.of.action == MOTION
            if len(followed) >= MOST and not moves and c.of.id not in followed:
                continue
            size = visible(self.scene, h.state.jacobian, c.change[:, None])[0] * (ROUGHLY if effect else 1.0)
            if size < PROMISING * self.matters:
                continue
            level = self.ranked(len(h.members) + 1)
            whole = not level or any(m.of.action == MOTION for m in (*h.members, c))  # `moving` may follow it
            floor = -math.inf if whole else near_to(level[0].log_weight, h.log_weight, FOLLOWED)
            new = self.fitted((*h.members, c), joined(h, c), floor)
            self._keep(new)
            # A wave that follows the cycles leaves its place to the next one.
            if new is not None or c.variant.curve is None:
                tried[kind] = tried.get(kind, 0) + 1
                if not moves:
                    followed.add(c.of.id)

    def refine(self, h: Hypothesis, first: int = 0, *, again: bool = False) -> None:
        """Try the published formulas in the place of each curve: where one is better, it is what the class holds.

        Of the members from the place `first` on. What acts on the motion has no curve: others in the place of its
        formula. `again` tries them in the place of all formulas: the best one was chosen beside other classes and other
        noise.
        """
        for place in range(first, len(h.members)):
            h = self.found[h.key]
            member = h.members[place]
            if again or member.variant.curve is not None or member.of.action == MOTION:
                beside = second_of(h.members[place]) == DISTANCE and DISTANCE not in h.key
                tried = ((replaced(h, place, form), form) for form in self.forms(h, place))
                if beside:
                    for one in self._all_fitted(tried)[:BEAM]:
                        self._keep(one)
                        self._beside_distance(one, first)
                else:
                    self._keep(self._best_fitted(tried, h.log_weight))
            self.beside_direction(h, place)

    def _beside_distance(self, one: Hypothesis, first: int) -> None:
        """Try a function of the distance beside a formula in the place of a curve over position, which holds both."""
        # A curve: to first order a formula beside one that is far off may seem to do what it cannot.
        other = [c for c in self.looked if c.of.id == DISTANCE and c.variant.curve is not None]
        if other:
            best = screen(self.metric, one.state, other)[0]
            both = self.add((*one.members, best), joined(one, best))
            if both is not None:
                self.refine(both, first)

    def beside_direction(self, h: Hypothesis, place: int) -> Hypothesis | None:
        """Try a formula or a curve beside a difference of push and pull in the place of curves for push and pull.

        They hold both.

        The rest is fitted with the difference first: beside such curves the parameters of the law may be anywhere.
        Gives the best of these hypotheses; None where there is none.
        """
        member = h.members[place]
        if second_of(member) != DIRECTION or DIRECTION in h.key or DIRECTION not in self.classes:
            return None
        rest = self.fitted(*without(self.scene, h, place))
        if rest is None:
            return None
        best = screen(self.metric, rest.state, [c for c in self.looked if c.of.id == DIRECTION])[0]
        one = self.fitted((*rest.members, best), joined(rest, best))
        self._keep(one)
        if one is not None:
            curves = [c for c in self.looked if c.of.id == member.of.id and c.variant.curve is not None]
            curve = screen(self.metric, one.state, curves)[0]
            self.add((*one.members, curve), joined(one, curve))
            for form in self.forms_of(member.of, one.members, one.state.z):
                self.add((*one.members, form), form.start)
        return self.found.get(h.key | {DIRECTION})

    def forms(self, h: Hypothesis, place: int) -> list[Candidate]:
        """Formulas of the class of a member, each from its best starts, with where the rest of the model is."""
        return self.forms_of(
            h.members[place].of, *without(self.scene, h, place), (place, columns_of(self.scene, h.state, place)[0])
        )

    def forms_of(
        self, of: Class, members: tuple[Candidate, ...], z: FloatArray, at: tuple[int, int] | None = None
    ) -> list[Candidate]:
        """Formulas of a class, each from its best starts, beside other members and where their model is, `z`.

        `at` is the place of the class among the members, and of its parameters among theirs; the last by default.
        """
        place, first = at or (len(members), z.size)
        acts, nothing, out = (of.action, of.coordinate), np.zeros((self.scene.used.size, 0)), []
        known = [e for e in catalogue().values() if acts in e.acts and e.mechanism not in self.hidden]
        for effect in known:
            variant = Variant(None, effect, FORMS / max(len(known), 1))
            form = Candidate(of, variant, z, nothing, self.scene.device)
            model = self.model_of((*members[:place], form, *members[place:]))
            values = start_values(effect)
            if effect.parameters[0].either_sign:  # a size of either sign
                values[0] = sorted({*values[0], *(-value for value in values[0])})
            tails = [np.array(tail) for tail in product(*values)]
            starts = np.array([np.insert(z, first, tail) for tail in tails])
            with np.errstate(all="ignore"):
                residual = self.scene.residual(model, starts)
                heights = np.diag(self.metric.products(np.nan_to_num(residual.T, nan=1e6)))
            best = np.argsort(heights, kind="stable")[: 1 if heights.size < 3 else 2]
            out += [replace(form, start=starts[i], model=model, gain=-0.5 * float(heights[i])) for i in best]
        return out

    def following(self, h: Hypothesis, place: int) -> Iterator[Hypothesis]:
        """Give the hypotheses with a formula in the place of a curve that it follows: within what it may miss."""
        allowed = may_miss(self.scene, h, place)
        for form in self.forms(h, place):
            one = self.fitted(replaced(h, place, form), form.start)
            if one is not None and away(self.scene, h, one) <= allowed:
                yield one

    def in_place_of(self, h: Hypothesis, place: int, of: Class) -> list[Hypothesis]:
        """Give the hypotheses with a formula of another class in the place of a curve, most probable first."""
        rest = self.fitted(*without(self.scene, h, place))
        if rest is None:
            return []
        return self._all_fitted(((*rest.members, f), f) for f in self.forms_of(of, rest.members, rest.state.z))

    def _all_fitted(self, tried: Iterable[tuple[tuple[Candidate, ...], Candidate]]) -> list[Hypothesis]:
        """Fit hypotheses, each from the start of a form; those with a fit, most probable first."""
        ones = [self.fitted(members, form.start) for members, form in tried]
        return sorted((one for one in ones if one is not None), key=lambda one: -one.log_weight)

    def _best_fitted(
        self, tried: Iterable[tuple[tuple[Candidate, ...], Candidate]], floor: float = -math.inf
    ) -> Hypothesis | None:
        """Fit hypotheses, each from the start of a form, from the best start on; the most probable one, if any."""
        best = None
        for members, form in sorted(tried, key=lambda one: -one[1].gain):
            one = self.fitted(members, form.start, floor)
            if one is not None and (best is None or one.log_weight > best.log_weight):
                best, floor = one, max(floor, one.log_weight)
        return best

    def as_curve(self, h: Hypothesis, place: int) -> Hypothesis | None:
        """Give a hypothesis with a curve in the place of a formula, beside all else that it holds: what can be drawn.

        A curve stays as it is; None where the class has none.
        """
        member = h.members[place]
        if member.variant.curve is not None:
            return h
        members, z = without(self.scene, h, place)
        looked = [c for c in self.looked if c.of.id == member.of.id and c.variant.curve is not None]
        if not looked or any(same_twice(looked[0], m) for m in members):
            return None
        rest = self.fitted(members, z)
        if rest is None:
            return None
        best = screen(self.metric, rest.state, looked)[0]
        first = columns_of(self.scene, h.state, place)[0]
        start = np.insert(z, [first] * len(best.variant.effect.parameters), 0.0)
        return self.fitted(replaced(h, place, best), start)

    def model_of(self, members: tuple[Candidate, ...]) -> DeviceModel:
        """Model that holds given classes."""
        added = tuple(member.variant.effect for member in members)
        return self.scene.device.with_effects((*self.scene.device.effects, *added))

    def shrink(self, h: Hypothesis) -> None:
        """Fit the hypotheses with one class less."""
        for place in range(len(h.members)):
            rest, z = without(self.scene, h, place)
            known = self.found.get(frozenset(m.of.id for m in rest))
            if known is not None and all(a.variant is b.variant for a, b in zip(known.members, rest, strict=True)):
                continue
            self.add(rest, z)

    def deepen(self, depth: int) -> bool:
        """Add a class to the best hypotheses with so many; whether the best of all is another one then."""
        before = self.best
        level = self.ranked(depth)
        near = [h for h in level[:BEAM] if h.log_weight > self.best.log_weight - FOLLOWED or h is level[0]]
        for h in dict.fromkeys((*near, *self.moving(depth))):
            self.grow(h)
        if self.best.key == before.key:
            return False
        least = near_to(self.best.log_weight, before.log_weight, RIVAL)
        grown = {h.key: h.members[-1] for h in self.ranked(depth + 1)}
        for h in self.ranked(depth + 1):
            if h.log_weight > least:
                self.refine(h)
        last = self.best.members[-1]
        if last is grown.get(self.best.key) and last.variant.curve is None and last.of.action != MOTION:
            # A formula, chosen to first order; in the place of all others every form has been tried.
            self.refine(self.best, len(self.best.members) - 1, again=True)
        self.shrink(self.best)
        self.retune()
        return True

    def deepen_from(self, first: int) -> None:
        """Add classes, one after another, to the best hypotheses with so many and more, until none is better.

        Nor better than more noise, where the noise is capped: any curve has some evidence then.
        """
        for depth in range(first, DEPTH):
            before = self.best
            self.tell(f"looking beyond {' and '.join(sorted(before.key)) or 'the base law'}")
            if not self.deepen(depth) and len(self.best.members) <= depth:
                break
            if self.is_capped and self._is_no_better_than_noise(self.best, before):
                break
            self.follow_bends()

    def follow_bends(self) -> None:
        """Average the recordings in blocks that follow the bends of what acts on the motion, and fit anew.

        Where a gap is crossed the force bends twice within a block of the base law: gaps were fitted far too soft.
        """
        h = self.best
        bends = frozenset(m.variant.effect.id for m in h.members if m.of.action == MOTION)
        if bends <= self.bends:
            return
        self.bends = bends
        self.scene = self.scene.finer_at(h.state.model, h.state.z)
        self.look_for(tuple(self.classes.values()))

    def look_for(self, classes: tuple[Class, ...]) -> None:
        """Look for given classes from here on, beside what was found."""
        h = self.best
        self.metric, rough = settle_under(self.scene, self.metric.setting, self.scene.device, self.scene.z)
        self.looked = candidates(self.scene, rough, classes)
        self._again(h)
        self.retune()

    def listen(self) -> None:
        """Look for chatter beside the best hypothesis."""
        sought = "stick_slip" not in self.hidden and str(TEETH) not in self.best.key
        self.chatter = chatter_of(self.scene, self.best.state, self.noise_most_kN) if sought else None

    def explain(self) -> None:
        """Look for two classes in the place of each curve that matters and that no formula follows.

        A smooth curve over one coordinate can do what formulas over two others, or a formula over its own and something
        over another, do together. Neither alone comes near it, so a search that adds one after another ends in it. What
        is no better than more noise is not explained, nor one of as many classes as a hypothesis may hold.
        """
        for place, member in enumerate(self.best.members):
            h = self.best
            is_there = place < len(h.members) and h.members[place] is member
            if not is_there or member.variant.curve is None or len(h.members) == DEPTH:
                continue
            if size_of(self.scene, h, place) < self.matters_of(h, place):
                continue
            rest = self.fitted(*without(self.scene, h, place))
            if rest is not None and not self._is_no_better_than_noise(h, rest):
                self._in_place_of_curve(h, place, rest)

    def _in_place_of_curve(self, h: Hypothesis, place: int, rest: Hypothesis) -> None:
        """Fit the promising hypotheses with two classes in the place of a curve that no formula follows.

        `rest` is the hypothesis without it.
        """
        if next(self.following(h, place), None) is not None:
            return
        of = h.members[place].of
        self.tell(f"looking for two dependences in the place of {of.id}")
        looked = [c for c in self.looked if c.of.id != of.id or c.variant.curve is None]
        alone, floor = {rest.key: rest}, h.log_weight - RIVAL
        part = replace(self, looked=looked, found=alone, curves={}, screened={}, floor=floor)
        n = len(rest.members)
        part.grow(rest)
        for one in part.ranked(n + 1)[:BEAM_IN_PLACE]:
            part.grow(one)
            for form in part.forms_of(of, one.members, one.state.z) if of.id not in one.key else ():
                part.add((*one.members, form), form.start)
        for one in part.ranked(n + 2)[:BEAM_IN_PLACE]:
            part.refine(one, n)
        part.shrink(part.best)
        for one in part.found.values():
            if one.log_weight > floor:
                self.add(one.members, one.state.z)

    def _is_no_better_than_noise(self, h: Hypothesis, less: Hypothesis) -> bool:
        """Whether a hypothesis has no more evidence than one with less, each under its most probable noise."""
        weights = [one.log_weight for x in (h, less) if (one := self.with_own_noise(x, self.metric.setting))]
        return len(weights) > 1 and weights[1] >= weights[0]

    def ranked(self, n: int) -> list[Hypothesis]:
        """Hypotheses with so many classes, most probable first."""
        return sorted((h for h in self.found.values() if len(h.members) == n), key=lambda h: -h.log_weight)

    def moving(self, n: int) -> list[Hypothesis]:
        """Most probable hypothesis with so many classes of which one acts on the motion, while the noise is capped.

        It is followed though others have more evidence: large effects are still to come, and as long as push and pull
        differ, say, a curve over position does more than a gap does, and ends beside others far from it.
        """
        own = [h for h in self.ranked(n) if any(m.of.action == MOTION for m in h.members)]
        return own[:1] if self.is_capped else []

    def exchange(self) -> None:
        """Try what else could stand in the place of each class of the best hypothesis."""
        for place in range(len(self.best.members)):
            h = self.best
            if 1 < len(h.members) > place:
                less = h.key - {h.members[place].of.id}
                if less not in self.found:
                    self.shrink(h)
                if less in self.found:
                    replace(self, floor=h.log_weight - RIVAL).grow(self.found[less])

    def finish(self) -> None:
        """Give each hypothesis in contention the noise that is most probable under it, and weigh them anew.

        The noise beside everything that could be added is the right one to search with, but what it leaves out as
        physics may be slow noise after all.
        """
        best = self.best
        self.shrink(best)
        near = [h for h in self.found.values() if h.log_weight > best.log_weight - RIVAL]
        less = [self.found[k] for m in best.members if (k := best.key - {m.of.id}) in self.found]
        ranked = sorted({h.key: h for h in (*near, *less)}.values(), key=lambda h: -h.log_weight)[:MOST_FINAL]
        for h in ranked:
            if h.log_weight > self.best.log_weight - RIVAL:  # which its own forms may have raised
                self.refine(h, again=True)
        ranked = [self.found[h.key] for h in ranked]
        ranked += [h for h in (self.found[frozenset()],) if h not in ranked]
        search_metric = self.metric
        found: dict[frozenset[str], Hypothesis] = {}
        for h in (*ranked, *self._with_forms(ranked[0])):
            new = self.with_own_noise(h, search_metric.setting)
            if new is not None and (h.key not in found or found[h.key].log_weight < new.log_weight):
                found[h.key] = new
        self.found = found
        self._share_noise()
        first = self.best
        self._without_each()
        if self.best is not first:
            self._share_noise()
        for h in list(found.values()):
            found |= self._zero_apart(h, found)
        self.metric = self.best.metric or search_metric
        self.screened = {}

    def _share_noise(self) -> None:
        """Search for the noise of each rival from that of the best hypothesis: the most probable one may be farther."""
        best = self.best
        assert best.metric is not None
        for key, h in list(self.found.items()):
            rival = h is not best and h.log_weight > best.log_weight - RIVAL
            new = self.with_own_noise(h, best.metric.setting) if rival else None
            if new is not None and new.log_weight > h.log_weight:
                self.found[key] = new

    def _with_forms(self, h: Hypothesis) -> list[Hypothesis]:
        """Fit the best formula in the place of each curve over a clock: beside the curve nothing is slow noise."""
        curves = (i for i, m in enumerate(h.members) if m.variant.curve is not None and is_over_a_clock(m.of))
        tried = (
            self._best_fitted((replaced(h, place, form), form) for form in self.forms(h, place)) for place in curves
        )
        return [one for one in tried if one is not None]

    def _without_each(self) -> None:
        """Weigh the best hypothesis without each of its classes: another one may have been the best before."""
        best = self.best
        assert best.metric is not None
        self.metric = best.metric
        self.shrink(best)
        for key, h in list(self.found.items()):
            if h.metric is None:
                new = self.with_own_noise(h, best.metric.setting)
                if new is None:
                    del self.found[key]
                else:
                    self.found[key] = new
        if self.best.key < best.key:
            self._without_each()

    def _zero_apart(
        self, h: Hypothesis, found: Mapping[frozenset[str], Hypothesis]
    ) -> dict[frozenset[str], Hypothesis]:
        """Split a hypothesis whose zero of the load cell may be off by a size that matters: that is a constant force.

        The probability that it is goes to the hypothesis with the constant. Gives those that change.
        """
        assert h.metric is not None
        if self.constant is None or CONSTANT in h.key:
            return {}
        mean, sd = zero_of(h.metric, h.state)
        limit = MATTERS * self.scene.scale_kN
        off = float(ndtr((mean - limit) / sd) + ndtr((-limit - mean) / sd))
        if off < DOUBT:
            return {}
        self.metric = h.metric
        members, start = (*h.members, self.constant), _free(self.constant, mean / self.scene.scale_kN)
        new = found.get(h.key | {CONSTANT}) or self.fitted(members, np.append(h.state.z, start))
        if new is None:
            return {}
        known = new.log_weight if new.key in found else -math.inf
        weight = float(np.logaddexp(known, h.log_weight + math.log(off)))
        less = replace(h, log_weight=h.log_weight + math.log(max(1.0 - off, 1e-300)))
        return {h.key: less, new.key: replace(new, log_weight=weight, metric=new.metric or h.metric)}

    def with_own_noise(self, h: Hypothesis, start: NoiseSetting) -> Hypothesis | None:
        """Fit a hypothesis under the noise that is most probable beside it."""
        none = np.zeros((h.state.residual.size, 0))
        metric = Metric(self.scene, find_noise(self.scene, h.state, none, start), h.state.slope)
        new = replace(self, metric=metric).fitted(h.members, h.state.z)
        return replace(new, metric=metric) if new is not None else None

    def retune(self) -> None:
        """Find the noise beside the best hypothesis and everything that could be added; fit the best anew."""
        h = self.best
        self.metric = noise_beside(self.scene, h.state, self.screen(h), self.metric.setting)
        self._again(h)

    def _again(self, h: Hypothesis) -> None:
        """Fit the hypotheses in contention with one of them anew."""
        kept = [*self.found.values(), *self.curves.values()]
        followed = self.moving(len(h.members))
        self.found, self.curves, self.screened = {}, {}, {}
        for one in kept:
            near = one.log_weight > h.log_weight - RIVAL or one in followed
            if near or not one.members or one.key == h.key:
                self.add(one.members, one.state.z)


def search(
    scene: Scene,
    classes: Sequence[Class],
    hidden: frozenset[str] = frozenset(),
    tell: Callable[[str], None] = lambda _: None,
) -> Search:
    """Find the most probable sets of classes; formulas of `hidden` mechanisms are not tried.

    `tell` gets one line for each step.
    """
    tell("fitting the base law")
    whole = [of_whole_cycles(scene, of) for of in classes]
    size = float(np.std(scene.residual(scene.device, scene.z[None])[0]))
    start = NoiseSetting(noise_of_size(scene.device, size), MODEL_ERROR * scene.scale_kN)
    metric, rough = settle_under(scene, start, scene.device, scene.z)
    shown = resolved(scene, metric, rough, whole)
    if shown is not scene:
        scene = shown
        metric, rough = settle_under(scene, start, scene.device, scene.z)
    looked = candidates(scene, rough, tuple(whole))
    again = [w for of in whole for w in waves(scene, metric, rough, of)]
    metric = noise_beside(scene, rough, [*looked, *again], None)
    out = Search(scene, looked, metric, hidden, tell)
    base = out.add((), scene.z)
    assert base is not None
    out.try_constant()
    out.deepen_from(0)
    if whole != list(classes):
        # Only now: beside few classes, curves over time that change within a cycle do what many others do together.
        out.look_for(tuple(classes))
        out.deepen_from(len(out.best.members))
    out.listen()
    if not out.is_capped:
        out.explain()
    out.exchange()
    out.finish()
    out.listen()
    return out


def near_to(height: float, before: float, nats: float) -> float:
    """Log weight from which hypotheses are near to the best, where it has gone from `before` to a height.

    A smooth curve may miss as much of a steep formula as a formula may miss of a curve.
    """
    return height - max(nats, (1.0 - EXPLAINED) * (height - before))


def noise_beside(scene: Scene, state: State, looked: Sequence[Candidate], start: NoiseSetting | None) -> Metric:
    """Noise beside everything that smooth functions of any coordinate can take up, at most that of a load cell.

    What is larger is left to the classes until the end: beside several effects that no single class makes up for, a
    large noise would take them all.
    """
    columns, seen = [], set()
    for c in looked:
        curve = c.variant.curve
        smooth = curve is None or curve.length == max(0.15, min(v.curve.length for v in c.of.variants if v.curve))
        kind = (c.of.id, curve is not None and curve.period is not None)
        if kind in seen or not smooth:
            continue
        seen.add(kind)
        columns.append(WIDE * c.columns)
    columns.append(FLAT * scene.zeros * scene.scale_kN)  # a constant says nothing of the noise
    wide = np.concatenate(columns, axis=1) if columns else np.zeros((state.residual.size, 0))
    setting = find_noise(scene, state, wide, start, NOISE_MOST * scene.largest_kN)
    return Metric(scene, setting, state.slope)


def _free(constant: Candidate, size: float) -> FloatArray:
    """Size of a constant force, a share of Fy, in its unbounded space."""
    return constant.variant.effect.parameters[0].to_free(np.asarray(size))


def noise_of_size(device: DeviceModel, size_kN: float) -> tuple[float, ...]:
    """Noise parameters to begin with, unbounded: the size of a residual in every part."""
    rough = {"sigma": size_kN, "sigma_white": size_kN, "sigma_slow": size_kN, "tau_slow": 3.0, "phi": 0.5, "nu": 10.0}
    return tuple(
        float(np.clip(law.to_free(np.asarray(rough.get(law.name, law.quantile(0.5)))), -7.0, 7.0))
        for law in device.laws_of_parameters[device.n_law :]
    )
