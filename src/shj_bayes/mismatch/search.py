"""Which classes a device holds: sets of them are compared by their evidence, grown and shrunk until none is better."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import ndtr

from shj_bayes.mismatch.classes import ALPHA, MIN_EFFECT, Dependence, candidates
from shj_bayes.mismatch.data import MODEL_ERROR, BinnedData, ErrorParameters
from shj_bayes.mismatch.fitter import Fitter, noise_beside, noise_of_size
from shj_bayes.mismatch.hypothesis import CONSTANT, MOTION, TEETH, Hypothesis, replaced
from shj_bayes.mismatch.laplace import laplace_under, zero_of
from shj_bayes.mismatch.moves import (
    BEAM,
    DEPTH,
    FOLLOWED,
    RIVAL,
    Search,
    add_one,
    constant_of,
    drop_one,
    follow_bends,
    free_size,
    is_no_better_than_noise,
    look_for,
    moving,
    near_to,
    refit_noise,
    replace_by_formula,
    split_curve,
    swap_one,
    try_constant,
)
from shj_bayes.mismatch.periodic import chatter_of, is_over_a_clock, of_whole_cycles, resolved, waves

MOST_FINAL = 6  # hypotheses that are weighed under noise of their own


def search(
    scene: BinnedData,
    classes: Sequence[Dependence],
    hidden: frozenset[str] = frozenset(),
    tell: Callable[[str], None] = lambda _: None,
) -> Search:
    """Find the most probable sets of classes; formulas of `hidden` mechanisms are not tried.

    `tell` gets one line for each step.
    """
    tell("fitting the base law")
    whole = [of_whole_cycles(scene, of) for of in classes]
    size = float(np.std(scene.residual(scene.device, scene.z[None])[0]))
    start = ErrorParameters(noise_of_size(scene.device, size), MODEL_ERROR * scene.scale_kN)
    metric, rough = laplace_under(scene, start, scene.device, scene.z)
    shown = resolved(scene, metric, rough, whole)
    if shown is not scene:
        scene = shown
        metric, rough = laplace_under(scene, start, scene.device, scene.z)
    looked = candidates(scene, rough, tuple(whole))
    again = [w for of in whole for w in waves(scene, metric, rough, of)]
    metric = noise_beside(scene, rough, [*looked, *again], None)
    out = Search(Fitter(scene, looked, metric, hidden), tell=tell).add((), scene.z)
    assert out.found
    out = deepen_from(try_constant(out), 0)
    if whole != list(classes):
        # Only now: beside few classes, curves over time that change within a cycle do what many others do together.
        out = look_for(out, tuple(classes))
        out = deepen_from(out, len(out.best.members))
    out = detect_chatter(out)
    if not out.metric.is_capped:
        out = split_curve(out)
    return detect_chatter(finish(swap_one(out)))


def deepen_from(out: Search, first: int) -> Search:
    """Add classes, one after another, to the best hypotheses with so many and more, until none is better.

    Nor better than more noise, where the noise is capped: any curve has some evidence then.
    """
    for depth in range(first, DEPTH):
        before = out.best
        out.tell(f"looking beyond {' and '.join(sorted(before.key)) or 'the base law'}")
        out = _grown(out, depth)
        if out.best.key != before.key:
            out = _refined(out, before, depth)
        elif len(out.best.members) <= depth:
            break
        if out.metric.is_capped and is_no_better_than_noise(out.fitter, out.best, before):
            break
        out = follow_bends(out)
    return out


def _grown(out: Search, depth: int) -> Search:
    """Add a class to the best hypotheses with so many."""
    level, best = out.ranked(depth), out.best
    near = [h for h in level[:BEAM] if h.log_weight > best.log_weight - FOLLOWED or h is level[0]]
    for h in dict.fromkeys((*near, *moving(out, depth))):
        out = add_one(out, h)
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


def detect_chatter(out: Search) -> Search:
    """Look for chatter beside the best hypothesis."""
    sought = "stick_slip" not in out.fitter.hidden and str(TEETH) not in out.best.key
    return replace(out, chatter=chatter_of(out.scene, out.best.state, out.scene.noise_most_kN) if sought else None)


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
    out = _without_each(out)
    if out.best is not first:
        out = _share_noise(out)
    for h in out.found.values():
        out = _zero_apart(out, h)
    return _under(out, out.best)


def _under(out: Search, h: Hypothesis) -> Search:
    """Give a search under the noise of a hypothesis."""
    assert h.metric is not None
    return replace(out, fitter=replace(out.fitter, metric=h.metric))


def _share_noise(out: Search) -> Search:
    """Search for the noise of each rival from that of the best hypothesis: the most probable one may be farther."""
    best = out.best
    assert best.metric is not None
    for h in out.found.values():
        if h is not best and h.log_weight > best.log_weight - RIVAL:
            out = out.keep(out.fitter.with_own_noise(h, best.metric.setting))
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


def _zero_apart(out: Search, h: Hypothesis) -> Search:
    """Split a hypothesis whose zero of the load cell may be off by a size that matters: that is a constant force.

    The probability that it is goes to the hypothesis with the constant.
    """
    constant, found, scale_kN = constant_of(out.fitter), out.found, out.scene.scale_kN
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
