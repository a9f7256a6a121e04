"""An answer must improve what it was not fitted to: dependences that do not are dropped until the rest does."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from shj_bayes.mismatch.classes import DOUBT
from shj_bayes.mismatch.findings import Answer, Reason, answer_of
from shj_bayes.mismatch.heldout import Gain, HeldOut, held_out
from shj_bayes.mismatch.hypothesis import Hypothesis, without
from shj_bayes.mismatch.scene import Metric, NoiseSetting, Scene
from shj_bayes.mismatch.search import Search
from shj_bayes.mismatch.state import State, settle_under
from shj_bayes.results.diagnosis import DiagnosisVerdict


@dataclass(frozen=True)
class DroppedMember:
    """A dependence that was found and does not improve what was left out."""

    of: str  # id of its class
    gain: Gain  # of the model with it over the model without it


@dataclass(frozen=True, eq=False)
class Proven:
    """An answer whose dependences all improve what was left out."""

    out: Search  # the search, without the hypotheses that hold what was dropped
    answer: Answer
    dropped: tuple[DroppedMember, ...]  # in the order in which they were dropped
    fine: Scene  # the recordings in blocks as fine as those of a fit of the model that is shown
    # before, after: the base law in them and the model that is shown, under the noise of the latter; one state where
    # nothing is shown
    before: State
    after: State
    held: tuple[HeldOut, HeldOut]  # of both

    @property
    def gain(self) -> Gain:
        """What the model that is shown predicts better than the base law."""
        return Gain.of(*self.held)


def proven(out: Search, tell: Callable[[str], None] = lambda _: None) -> Proven:
    """Weigh what a finished search found, and drop what does not improve cycles that were left out.

    The dependence that is dropped is the one without which they are predicted best; the others are weighed anew
    without it. What is then still missing, but has no dependence left that improves anything, is unknown.
    """
    dropped: list[DroppedMember] = []
    missing = False
    while True:
        answer = answer_of(out)
        tell("predicting cycles that were left out")
        held = _Held.of(out, answer)
        if not dropped:
            missing = bool(answer.findings) and _nothing(answer) < DOUBT
        worst = held.worst(out, answer)
        if worst is None:
            break
        tell(f"{worst.of} does not improve cycles that were left out")
        dropped.append(worst)
        out = _less(out, answer.shown, worst.of)
    if missing and not answer.findings:
        answer = replace(answer, verdict=DiagnosisVerdict.UNKNOWN, reason=Reason.NOT_BORNE_OUT)
    return Proven(out, answer, tuple(dropped), held.fine, held.before, held.after, (held.base, held.shown))


def _nothing(answer: Answer) -> float:
    """Probability that nothing is missing."""
    return dict(answer.sets).get(frozenset(), 0.0)


def _less(out: Search, shown: Hypothesis, of: str) -> Search:
    """Give a search without the hypotheses that hold a class, and with the shown one less that class."""
    found = {key: h for key, h in out.found.items() if of not in key}
    place = next(i for i, member in enumerate(shown.members) if member.of.id == of)
    if shown.key - {of} not in found:
        members, z = without(out.scene, shown, place)
        fitted = out.fitted(members, z)
        rest = None if fitted is None else out.with_own_noise(fitted, out.metric.setting)
        found |= {} if rest is None else {rest.key: rest}
    best = max(found.values(), key=lambda h: h.log_weight)
    return replace(out, found=found, metric=best.metric or out.metric, screened={})


@dataclass(frozen=True, eq=False)
class _Held:
    """The base law and the model of an answer, on cycles that were left out."""

    fine: Scene
    setting: NoiseSetting
    before: State
    after: State
    base: HeldOut
    shown: HeldOut

    @classmethod
    def of(cls, out: Search, answer: Answer) -> "_Held":
        """Fit both, in blocks as fine as those of a fit, and leave cycles out."""
        h, base, setting = answer.shown, out.found[frozenset()].state, out.metric.setting
        fine = out.scene.finer_at(h.state.model, h.state.z)
        metric, before = settle_under(fine, setting, base.model, base.z)
        if not answer.findings:
            alone = held_out(fine, metric, before)
            return cls(fine, setting, before, before, alone, alone)
        after = settle_under(fine, setting, h.state.model, h.state.z)[1]
        metric = Metric(fine, setting, after.slope)
        return cls(fine, setting, before, after, *(held_out(fine, metric, state) for state in (before, after)))

    def worst(self, out: Search, answer: Answer) -> DroppedMember | None:
        """Find the dependence without which what was left out is predicted best; None where each improves it."""
        if not answer.findings:
            return None
        members, metric = answer.shown.members, Metric(self.fine, self.setting, self.after.slope)
        gains = []
        for place, member in enumerate(members):
            rest, h = self.base, replace(answer.shown, state=self.after)
            if len(members) > 1:
                less, z = without(self.fine, h, place)
                state = settle_under(self.fine, self.setting, out.model_of(less), z)[1]
                rest = held_out(self.fine, metric, state)
            gains.append(DroppedMember(member.of.id, Gain.of(rest, self.shown)))
        whole = Gain.of(self.base, self.shown)
        if all(one.gain.improves for one in gains) and not whole.is_worse:
            return None
        return min(gains, key=lambda one: one.gain.elpd if np.isfinite(one.gain.elpd) else -np.inf)
