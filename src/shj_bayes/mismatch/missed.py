"""What a formula may miss: it is near the truth, not the truth. A curve over its coordinate stands for the rest."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import expit

from shj_bayes.mismatch.classes import Candidate, Class, candidates
from shj_bayes.mismatch.scene import Metric, Scene, solve
from shj_bayes.mismatch.screen import screen
from shj_bayes.mismatch.search import EXPLAINED, ODDS
from shj_bayes.mismatch.state import State
from shj_bayes.model.curve import Curve
from shj_bayes.model.parameters import FloatArray


def curves_of(scene: Scene, state: State, member: Candidate) -> FloatArray | None:
    """Give the curves that stand for a class, kN by unit of normal coefficients, shape (n, p); None where none do.

    To first order, with the standard deviation of `Curve.size`; where several stand for it, as heat that decays sooner
    or later, all of them. What acts on the motion has no curve.
    """
    curves = [v for v in member.of.variants if v.curve is not None and not v.curve.sides]
    if not curves:
        return None
    likely = {v.curve.coordinate: v for v in sorted(curves, key=lambda v: v.weight) if v.curve is not None}
    one = replace(member.of, variants=tuple(likely.values()))
    return np.column_stack([c.columns for c in candidates(scene, state, (one,))])


def beside_missed(
    scene: Scene,
    metric: Metric,
    state: State,
    found: Sequence[tuple[Candidate, float]],
    others: Sequence[Class] = (),
) -> State:
    """Give a state with the covariance that it has beside what the formulas of an answer may miss, and beside the rest.

    The rest are the classes that are not in the answer, each with its probability: too small to matter for the force,
    or too weak to be seen, they move the parameters by more than noise does. All to first order. The parameters stay
    those of the answer; how far they would go counts as uncertainty.

    Parameters
    ----------
    scene : Scene
        The recordings.
    metric : Metric
        Noise and discrepancy.
    state : State
        The model that was found.
    found : sequence of Candidate and float
        Its classes with their sizes, as shares of Fy.
    others : sequence of Class
        Classes that it does not hold.
    """
    covariance = state.covariance.copy()
    missed = [
        curves * ((1.0 - EXPLAINED) * size / Curve.size)
        for member, size in found
        if member.variant.curve is None and (curves := curves_of(scene, state, member)) is not None
    ]
    if missed:
        covariance = _spread(metric, state, *missed)
    seen: set[str] = set()
    for c in screen(metric, state, candidates(scene, state, tuple(others))):
        if c.of.id not in seen:
            seen.add(c.of.id)
            curve = c.variant.curve
            column = c.change[:, None] if curve is None else c.columns * (curve.size / Curve.size)
            covariance += expit(c.gain + ODDS) * (_spread(metric, state, column) - state.covariance)
    return replace(state, covariance=covariance)


def _spread(metric: Metric, state: State, *columns: FloatArray) -> FloatArray:
    """Covariance of the parameters beside further columns, with the square of how far they move from where they are."""
    d = state.z.size
    mean, covariance = solve(metric.products(state.beside(*columns)))
    moved = mean[:d] - state.z
    return np.asarray(covariance[:d, :d] + np.outer(moved, moved))
