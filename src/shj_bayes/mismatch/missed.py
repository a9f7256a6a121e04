"""Parameters of a model whose formulas are near the truth, not the truth: what they may miss is integrated out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from shj_bayes.mismatch.classes import candidates
from shj_bayes.mismatch.findings import Finding
from shj_bayes.mismatch.scene import Metric, Scene, solve
from shj_bayes.mismatch.search import EXPLAINED
from shj_bayes.mismatch.state import State
from shj_bayes.model.parameters import FloatArray


def beside_missed(scene: Scene, metric: Metric, state: State, findings: Sequence[Finding]) -> State:
    """Give a state with the covariance that it has beside what the formulas of an answer may miss.

    That is a curve over the coordinate of each, with a standard deviation of 1 - `EXPLAINED` of its size. To first
    order; what acts on the motion has no curve. The parameters stay those of the formulas, which predict without the
    curves; how far they would go beside these counts as uncertainty.

    Parameters
    ----------
    scene : Scene
        The recordings.
    metric : Metric
        Noise and discrepancy.
    state : State
        The model that was found.
    findings : sequence of Finding
        Its classes.
    """
    columns = [c for finding in findings if (c := _missed(scene, state, finding)) is not None]
    if not columns:
        return state
    d = state.z.size
    mean, covariance = solve(metric.products(state.beside(*columns)))
    moved = mean[:d] - state.z
    return replace(state, covariance=covariance[:d, :d] + np.outer(moved, moved))


def _missed(scene: Scene, state: State, finding: Finding) -> FloatArray | None:
    """Give what a formula may miss, kN by unit of its coefficients, shape (n, p); None where there is no formula."""
    of = finding.member.of
    curves = [v for v in of.variants if v.curve is not None and not v.curve.sides]
    if finding.member.variant.curve is not None or not curves:
        return None
    variant = max(curves, key=lambda v: v.weight)
    assert variant.curve is not None
    (candidate,) = candidates(scene, state, (replace(of, variants=(variant,)),))
    return candidate.columns * ((1.0 - EXPLAINED) * finding.size / variant.curve.size)
