"""From a search to one word: adequate, named, family or unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shj_bayes.mismatch.name import Ranking
from shj_bayes.mismatch.repeats import repeating_share
from shj_bayes.mismatch.search import Search
from shj_bayes.mismatch.thresholds import EXPLAINED, NOTABLE, PRACTICAL, REPEAT_P, REPEATED, RIVAL_MASS


@dataclass(frozen=True)
class Judgement:
    """Verdict with its reason.

    Parameters
    ----------
    word : {"adequate", "named", "family", "unknown"}
        As in INTERFACE.
    reason : str
        One plain sentence.
    rivals : dict of str to tuple of str
        For each effect found, those that this recording does not exclude in its place.
    """

    word: str
    reason: str
    rivals: dict[str, tuple[str, ...]]


def judge(result: Search, left_kN: float, explained: float) -> Judgement:
    """Weigh a search.

    Parameters
    ----------
    result : Search
        Effects found, and their rivals.
    left_kN : float
        Largest mean residual that is left in a region where chance is excluded, kN.
    explained : float
        Share of the explainable misfit that the effects take up.

    Returns
    -------
    Judgement
    """
    capacity = result.base.capacity_kN
    last = result.steps[-1]
    alarm = last.why and not last.why.startswith("p =")
    rivals = {name: _rivals(ranking) for name, ranking in result.rankings.items()}
    matters = left_kN >= PRACTICAL * capacity
    if not result.found:
        if alarm and matters:
            return Judgement("unknown", f"misfit of up to {left_kN:.2g} kN is left; {last.why}", rivals)
        bound = f"; what is there stays below {100 * PRACTICAL:.0f} % of Fy" if alarm else ""
        return Judgement("adequate", f"nothing beyond noise of a size that matters{bound} ({last.why})", rivals)
    if left := _unexplained(result, left_kN if alarm else 0.0, explained):
        words = f"the catalogue does not explain the misfit: {', '.join(result.found)} would take up {left}"
        return Judgement("unknown", words, rivals)
    if any(rivals.values()):
        return Judgement(
            "family", "effects that this recording cannot tell apart would each explain the misfit", rivals
        )
    return Judgement("named", "each effect is separable from its rivals with this recording", rivals)


def _unexplained(result: Search, left_kN: float, explained: float) -> str:
    """Say how much the effects take up and what they leave, when that is too much; `left_kN` is 0 without an alarm."""
    capacity = result.base.capacity_kN
    again = result.steps[-1].repeat
    repeated = repeating_share(result.steps[0].repeat, again)
    if left_kN and again.p_value < REPEAT_P and again.size_kN >= PRACTICAL * capacity and repeated < REPEATED:
        which = "of the misfit that comes again from cycle to cycle"
        return f"{100 * repeated:.0f} % {which} and leave {again.size_kN:.2g} kN over {again.coordinate}"
    part = f"{100 * explained:.0f} % of the misfit and leave"
    if explained < EXPLAINED and left_kN >= PRACTICAL * capacity:
        return f"{part} {left_kN:.2g} kN"
    # Over few half-cycles chance excludes nothing; but no load cell is this uneven while neighbouring samples agree.
    if explained < EXPLAINED and result.known.rmse_kN >= NOTABLE * capacity:
        return f"{part} {result.known.rmse_kN:.2g} kN root mean square"
    return ""


def _rivals(ranking: Ranking) -> tuple[str, ...]:
    """Effects that are not excluded in the place of the best one, and win in more than a stray resampling."""
    likely = np.argsort(-ranking.probability, kind="stable")
    before = np.cumsum(ranking.probability[likely]) - ranking.probability[likely]
    stray = {int(i) for i, mass in zip(likely, before, strict=True) if mass >= RIVAL_MASS}
    rows = enumerate(zip(ranking.candidates, ranking.excluded(), strict=True))
    return tuple(c.effect.id for i, (c, out) in rows if i > 0 and not out and c.t > 0 and i not in stray)
