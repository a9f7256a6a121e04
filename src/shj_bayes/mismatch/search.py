"""Which classes a device holds: sets of them are compared by their evidence, grown and shrunk until none is better."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from shj_bayes.mismatch.data import MODEL_ERROR, BinnedData, ErrorParameters
from shj_bayes.mismatch.fitter import Fitter, noise_beside, noise_of_size
from shj_bayes.mismatch.hypothesis import (
    ALPHA,
    CONSTANT,
    DIRECTION,
    EXPLAINED,
    MIN_EFFECT,
    MOTION,
    TEETH,
    TIME,
    TRAVEL,
    Dependence,
    Hypothesis,
    Parametrisation,
    candidates,
    replaced,
    screen,
    without,
)
from shj_bayes.mismatch.laplace import laplace_under, zero_of
from shj_bayes.mismatch.moves import (
    BEAM,
    DEPTH,
    FOLLOWED,
    LAST_MOVES,
    RIVAL,
    Search,
    add_one,
    constant_of,
    drop_one,
    follow_bends,
    following,
    free_size,
    is_no_better_than_noise,
    look_for,
    moving,
    near_to,
    refit_noise,
    replace_by_formula,
    try_constant,
)
from shj_bayes.mismatch.periodic import (
    chatter_of,
    comes_again_in_place,
    goes_one_way,
    is_over_a_clock,
    of_whole_cycles,
    resolved,
    waves,
)
from shj_bayes.model.curve import Curve

EVEN, EARLY = (0.05, 0.15, 0.5), (0.15, 0.5)  # lengths of curves on a linear scale and on one that is fine at first
# Curves over travel and time of the same freedom: coordinate and length.
FREE = {
    TRAVEL: (*(("late_travel", length) for length in EVEN), *(("travel", length) for length in EARLY)),
    TIME: (*(("time", length) for length in EVEN), *(("early_time", length) for length in EARLY)),
}
PROPORTION = 0.01  # of what a class explains: the error of a good curve of it
NAMED = 0.1  # nats by which the one that a formula follows comes first
# Blocks in which all classes are looked for. What needs more comes again after so short a way that no formula is known
# for it; it is found, and nothing beside it.
MOST_BLOCKS = 8000
BY_TEETH = 0.4  # of their size: what teeth make of a mean force. More is missed otherwise, and looks like larger teeth
TURNS = 3  # in which rivals are weighed under the noise of a best hypothesis that is new
MOST_FINAL = 6  # hypotheses that are weighed under noise of their own


def search(
    data: BinnedData,
    classes: Sequence[Dependence],
    hidden: frozenset[str] = frozenset(),
    tell: Callable[[str], None] = lambda _: None,
) -> Search:
    """Find the most probable sets of classes; formulas of `hidden` mechanisms are not tried.

    `tell` gets one line for each step.
    """
    tell("fitting the base law")
    whole = [of_whole_cycles(data, of) for of in classes]
    size = float(np.std(data.likelihood.residual(data.z[None])[0]))
    start = ErrorParameters(noise_of_size(data.device, size), MODEL_ERROR * data.scale_kN)
    metric, rough = laplace_under(data, start, data.device, data.z)
    shown = resolved(metric, rough, whole)
    if shown is not data:
        data = shown
        metric, rough = laplace_under(data, start, data.device, data.z)
    if data.blocks.used.size > MOST_BLOCKS:
        classes = whole = [of for of in whole if comes_again_in_place(of)]
    looked = candidates(data, rough, tuple(whole))
    again = [w for of in whole for w in waves(metric, rough, of)]
    metric = noise_beside(data, rough, [*looked, *again], None)
    out = Search(Fitter(looked, metric, hidden), tell=tell).add((), data.z)
    assert out.found
    out = deepen_from(try_constant(out), 0)
    if whole != list(classes):
        # Only now: beside few classes, curves over time that change within a cycle do what many others do together.
        out = look_for(out, out.data, tuple(classes))
        out = deepen_from(out, len(out.best.members))
    out = detect_chatter(out)
    for move in LAST_MOVES:
        out = move(out)
    return detect_chatter(finish(out))


def deepen_from(out: Search, first: int) -> Search:
    """Add classes, one after another, to the best hypotheses with so many and more, until none is better.

    Nor better than more noise, where the noise is capped: any curve has some evidence then.
    """
    for depth in range(first, DEPTH):
        before, out = out.best, detect_chatter(out, most=BY_TEETH)
        out.tell(f"looking beyond {' and '.join(sorted(before.key)) or 'the base law'}")
        level = out.ranked(depth)
        near = [h for h in level[:BEAM] if h.log_weight > before.log_weight - FOLLOWED or h is level[0]]
        for h in dict.fromkeys((*near, *moving(out, depth))):
            out = add_one(out, h)
        if out.best.key != before.key:
            out = _refined(out, before, depth)
        elif len(out.best.members) <= depth:
            break
        if out.metric.is_capped and is_no_better_than_noise(out.fitter, out.best, before):
            break
        out = follow_bends(out)
    return out


def _refined(out: Search, before: Hypothesis, depth: int) -> Search:
    """Try formulas in the hypotheses that were grown, and what the best of them can do without, under noise found anew.

    `before` is the best one before they were grown, from so many classes.
    """
    least = near_to(out.best.log_weight, before.log_weight, RIVAL)
    grown = {h.key: h.members[-1] for h in out.ranked(depth + 1)}
    for h in out.ranked(depth + 1):
        if h.log_weight > least:
            out = replace_by_formula(out, h)
    last = out.best.members[-1]
    if last is grown.get(out.best.key) and last.variant.curve is None and last.of.action != MOTION:
        # A formula, chosen to first order; in the place of all others every form has been tried.
        out = replace_by_formula(out, out.best, len(out.best.members) - 1, again=True)
    return refit_noise(drop_one(out, out.best))


def detect_chatter(out: Search, most: float = math.inf) -> Search:
    """Look for chatter beside the best hypothesis; what that misses in the mean is at first at most so much of it."""
    data, state, chatter = out.data, out.best.state, None
    if "stick_slip" not in out.fitter.hidden and str(TEETH) not in out.best.key:
        chatter = chatter_of(data, state, data.noise_most_kN)
        missed = math.sqrt(float(np.mean(state.residual[data.blocks.used > 0] ** 2))) / data.scale_kN
        chatter = chatter if chatter and (out.chatter or missed <= most * chatter.size) else None
    return replace(out, chatter=chatter)


def finish(out: Search) -> Search:
    """Give each hypothesis in contention the noise that is most probable under it, and weigh them anew.

    The noise beside everything that could be added is the right one to search with, but what it leaves out as
    physics may be slow noise after all.
    """
    best, searched = out.best, out.metric
    out = drop_one(out, best)
    near = [h for h in out.found.values() if h.log_weight > best.log_weight - RIVAL]
    less = [out.found[k] for m in best.members if (k := best.key - {m.of.id}) in out.found]
    ranked = sorted({h.key: h for h in (*near, *less)}.values(), key=lambda h: -h.log_weight)[:MOST_FINAL]
    for h in ranked:
        if h.log_weight > out.best.log_weight - RIVAL:  # which its own forms may have raised
            out = replace_by_formula(out, h, again=True)
    kept = dict.fromkeys((*(out.found[h.key] for h in ranked), out.found[frozenset()]))
    weighed = replace(out, found={}, curves={})
    for h in (*kept, *_with_forms(out.fitter, out.found[ranked[0].key])):
        weighed = weighed.keep(out.fitter.with_own_noise(h, searched.setting))
    out = _share_noise(weighed)
    first = out.best
    out = _offset_or_direction(_without_each(out))
    if out.best is not first:
        out = _share_noise(out)
    out = _travel_or_time(out)
    for h in out.found.values():
        out = _zero_apart(out, h)
    return _under(out, out.best)


def _under(out: Search, h: Hypothesis) -> Search:
    """Give a search under the noise of a hypothesis."""
    assert h.metric is not None
    return replace(out, fitter=replace(out.fitter, metric=h.metric))


def _share_noise(out: Search, turns: int = TURNS) -> Search:
    """Search for the noise of each rival from that of the best hypothesis: the most probable one may be farther.

    A rival is also what comes near to the best under its noise. Where one becomes the best, the others are weighed
    beside it, `turns` times at most.
    """
    best = out.best
    assert best.metric is not None
    least, under = best.log_weight - RIVAL, _under(out, best).fitter
    for h in out.found.values():
        near = h is best or h.log_weight > least
        one = None if near else under.fitted(h.members, h.state.z, least)
        if h is not best and (near or (one is not None and one.log_weight > least)):
            out = out.keep(out.fitter.with_own_noise(h, best.metric.setting))
    return out if out.best is best or turns == 1 else _share_noise(out, turns - 1)


def _offset_or_direction(out: Search) -> Search:
    """Weigh a constant force against push and pull that differ, in what is in contention with one of them.

    Both move the plateaus, and a search that has found either may never have fitted the other.
    """
    for h in sorted(out.found.values(), key=lambda h: -h.log_weight):
        own, key = {CONSTANT, DIRECTION} & h.key, h.key ^ {CONSTANT, DIRECTION}
        if len(own) != 1 or h.log_weight < out.best.log_weight - RIVAL or h.metric is None:
            continue
        known, (name,), (other,) = out.found.get(key), own, {CONSTANT, DIRECTION} - own
        if other not in out.fitter.classes or (known and known.log_weight > h.log_weight - RIVAL):
            continue
        fitter = _under(out, h).fitter
        rest, z = without(out.data, h, [m.of.id for m in h.members].index(name))
        forms = fitter.forms_of(fitter.classes[other], rest, z)
        new = fitter.best_fitted(((*rest, form), form) for form in forms)
        if new is not None:
            out = out.keep(fitter.with_own_noise(new, h.metric.setting))
    return out


def _with_forms(fitter: Fitter, h: Hypothesis) -> list[Hypothesis]:
    """Fit the best formula in the place of each curve over a clock: beside the curve nothing is slow noise."""
    curves = (i for i, m in enumerate(h.members) if m.variant.curve is not None and is_over_a_clock(m.of))
    tried = (
        fitter.best_fitted((replaced(h, place, form), form) for form in fitter.forms(h, place)) for place in curves
    )
    return [one for one in tried if one is not None]


def _without_each(out: Search) -> Search:
    """Weigh the best hypothesis without each of its classes: another one may have been the best before."""
    best = out.best
    assert best.metric is not None
    out = drop_one(_under(out, best), best)
    own = {
        key: h if h.metric is not None else out.fitter.with_own_noise(h, best.metric.setting)
        for key, h in out.found.items()
    }
    out = replace(out, found={key: h for key, h in own.items() if h is not None})
    return _without_each(out) if out.best.key < best.key else out


def _travel_or_time(out: Search) -> Search:
    """Weigh travel against time in each hypothesis in contention that holds one of them; see `_odds_of_other`.

    Both together keep the probability of the better one.
    """
    for h in sorted(out.found.values(), key=lambda h: -h.log_weight):
        own, key = {TRAVEL, TIME} & h.key, h.key ^ {TRAVEL, TIME}
        rival = out.found.get(key)
        near = h.log_weight > out.best.log_weight - RIVAL and not (rival and rival.log_weight > h.log_weight)
        if len(own) != 1 or not near or not {TRAVEL, TIME} <= out.fitter.classes.keys():
            continue
        weighed = _odds_of_other(out, h, *own, *({TRAVEL, TIME} - own))
        if weighed is not None:
            odds, other = weighed
            less, more = -float(np.logaddexp(0.0, odds)), -float(np.logaddexp(0.0, -odds))
            pair = {one.key: replace(one, log_weight=h.log_weight + p) for one, p in ((h, less), (other, more))}
            out = replace(out, found={**out.found, **pair})
    return out


def _odds_of_other(out: Search, h: Hypothesis, own: str, other: str) -> tuple[float, Hypothesis] | None:
    """Log odds of travel in the place of time, or of time in that of travel, and the best hypothesis with it.

    They are those of curves of equal freedom, each as probable before the test. A curve is known to be right to about
    `PROPORTION` of itself: the likelihood counts with a power that lets this share of what the class explains weigh one
    nat (Miller and Dunson 2019, J. Am. Stat. Assoc. 114, 1113). None where the force goes back and forth, as what is
    worn stays worn. A class that no formula follows is no more probable than one with a name.
    """
    place = [m.of.id for m in h.members].index(own)
    effect = h.members[place].variant.effect
    fitter = replace(out.fitter, metric=h.metric or out.metric)
    one_way = goes_one_way(out.data, effect, h.state.values_of(effect))
    rest = fitter.fitted(*without(out.data, h, place)) if one_way else None
    if rest is None:
        return None
    fits: dict[str, list[Hypothesis]] = {}
    for name in (own, other):
        curves = [Curve("capacity", over, length) for over, length in FREE[name]]
        variants = tuple(Parametrisation(curve, curve.effect(), 1.0) for curve in curves)
        of = replace(fitter.classes[name], variants=variants)
        tried = screen(fitter.metric, rest.state, candidates(out.data, rest.state, (of,)))
        fits[name] = fitter.all_fitted(((*rest.members, c), c) for c in tried)
    if not all(fits.values()):
        return None
    weight = {name: float(np.logaddexp.reduce([one.log_weight for one in ones])) for name, ones in fits.items()}
    if weight[own] - rest.log_weight < EXPLAINED * (h.log_weight - rest.log_weight):
        return None

    def named(h: Hypothesis, place: int) -> Hypothesis | None:
        return max(following(fitter, h, place), key=lambda one: one.log_weight, default=None)

    def is_named(h: Hypothesis, name: str) -> bool:
        return any(m.of.id == name and m.variant.curve is None for m in h.members)

    best = max(fits[other], key=lambda one: one.log_weight)
    drawn = named(best, len(rest.members)) or best
    rival = out.found.get(h.key ^ {own, other})
    if rival is None or (drawn is not best and not is_named(rival, other)):
        rival = replace(drawn, metric=h.metric)
    odds = (weight[other] - weight[own]) / (1.0 + PROPORTION * (h.log_weight - out.best_within(h.key - {own})))
    both = is_named(h, own) or named(h, place) is not None, is_named(rival, other)
    if both[0] != both[1]:
        odds = min(odds, -NAMED) if both[0] else max(odds, NAMED)
    return odds, rival


def _zero_apart(out: Search, h: Hypothesis) -> Search:
    """Split a hypothesis whose zero of the load cell may be off by a size that matters: that is a constant force.

    The probability that it is goes to the hypothesis with the constant.
    """
    constant, found, scale_kN = constant_of(out.fitter), out.found, out.data.scale_kN
    assert h.metric is not None
    if constant is None or CONSTANT in h.key:
        return out
    mean, sd = zero_of(h.metric, h.state)
    limit = MIN_EFFECT * scale_kN
    off = float(ndtr((mean - limit) / sd) + ndtr((-limit - mean) / sd))
    if off < ALPHA:
        return out
    out = _under(out, h)
    start = np.append(h.state.z, free_size(constant, mean / scale_kN))
    new = found.get(h.key | {CONSTANT}) or out.fitter.fitted((*h.members, constant), start)
    if new is None:
        return out
    known = new.log_weight if new.key in found else -math.inf
    weight = float(np.logaddexp(known, h.log_weight + math.log(off)))
    less = replace(h, log_weight=h.log_weight + math.log(max(1.0 - off, 1e-300)))
    split = {h.key: less, new.key: replace(new, log_weight=weight, metric=new.metric or h.metric)}
    return replace(out, found={**found, **split})
