"""Find the effects that were left out, one after another, and re-test the earlier ones when a later one enters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from shj_bayes.mismatch.calibrate import Alarm, Line, look, strongest_line
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.name import Candidate, Ranking, ahead_beyond_chance, compare, rank, try_all
from shj_bayes.mismatch.refit import Refit, View, extend_starts, refit
from shj_bayes.mismatch.regions import Regions
from shj_bayes.mismatch.repeats import Repeat, repeats
from shj_bayes.mismatch.share import share
from shj_bayes.mismatch.thresholds import (
    ALIAS,
    ALPHA,
    GAIN_NATS,
    GAIN_SE,
    LARGE,
    MAX_EFFECTS,
    NOTABLE,
    OF_REST,
    PART,
    PRACTICAL,
    WORTH,
)
from shj_bayes.model.effects.effect import Effect
from shj_bayes.model.parameters import FloatArray

Tell = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the search.

    Parameters
    ----------
    before : Refit
        Model at the start of the round.
    alarm : Alarm
        What the calibrated look found in it (regions first, then effects).
    ranking : Ranking
        Every further effect, fitted.
    p_value : float
        Of "nothing more is missing": four times the smallest of the look's, the line's, the repeat's and the held-out
        gains' (Bonferroni over the four, and over the effects).
    line : Line
        Strongest line over time in the residual at the start of the round.
    repeat : Repeat
        What comes again in it from one half-cycle to the next; in the last round less what an effect below the
        practical size takes up.
    taken : str
        Id of the effect that entered, empty when none did.
    why : str
        Reason in words.
    """

    before: Refit
    alarm: Alarm
    ranking: Ranking
    p_value: float
    line: Line
    repeat: Repeat
    taken: str
    why: str


@dataclass(frozen=True, eq=False)
class Search:
    """End of the search.

    Parameters
    ----------
    base, final : Refit
        Model without effects, and with those that were found.
    steps : tuple of Step
        Rounds in order; the last one took nothing.
    rankings : dict of str to Ranking
        For each effect found, its rivals given the other effects.
    known : Refit
        The final model, with an effect below the practical size where one is left: what that takes up is known, not
        worth a name, and not left over.
    """

    base: Refit
    final: Refit
    steps: tuple[Step, ...]
    rankings: dict[str, Ranking]
    known: Refit

    @property
    def new(self) -> tuple[Effect, ...]:
        """Effects of the final model that were not given from the start."""
        given = self.base.model.effects
        return tuple(effect for effect in self.final.model.effects if effect not in given)

    @property
    def found(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple(effect.id for effect in self.new)


@dataclass(frozen=True, eq=False)
class Setting:
    """What stays the same during a search.

    Parameters
    ----------
    evidence, coarse, fine : Evidence
        The recordings, and the same with fewer samples (to choose starts) and with more (to find the noise floor).
    regions : Regions
        Where to look.
    catalogue : tuple of Effect
        What to try.
    seed : int
        Of the resampling.
    tell : callable
        Gets one line for each step.
    """

    evidence: Evidence
    coarse: Evidence
    fine: Evidence
    regions: Regions
    catalogue: tuple[Effect, ...]
    seed: int
    tell: Tell

    def rng(self, *key: int) -> np.random.Generator:
        """Stream of random numbers that belongs to one place of the search."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=key))


def search(setting: Setting, base: Refit) -> Search:
    """Add effects while the residual holds more than noise.

    Parameters
    ----------
    setting : Setting
        Recordings and catalogue.
    base : Refit
        Base law, fitted.

    Returns
    -------
    Search
    """
    current, steps = base, []
    for number in range(MAX_EFFECTS + 1):
        setting.tell(f"looking for misfit beyond {', '.join(e.id for e in current.model.effects) or 'the base law'}")
        alarm = look(setting.evidence, current, _directions(setting, current), setting.rng(1, number))
        ranking = _rank(setting, base, current, _try_rest(setting, current), setting.rng(2, number))
        line = strongest_line(setting.evidence, current)
        again = repeats(setting.evidence, current.residual_kN, setting.rng(5, number))
        looks = (alarm.p_value, line.p_value, again.p_value, _p_of_gains(setting, ranking, current))
        p_value = min(1.0, len(looks) * min(looks))
        best = ranking.candidates[0]
        if p_value >= ALPHA / 2**number:
            why = f"p = {p_value:.4f}: nothing more than noise explains"
        elif number == MAX_EFFECTS:
            why = f"no more than {MAX_EFFECTS} effects are looked for"
        else:
            why = _objection(setting, base, current, best, float(ranking.elpd_gain[0]))
        known = current
        if why and best.size_kN < PRACTICAL * current.capacity_kN and _beyond_chance(best, float(ranking.elpd_gain[0])):
            known = best.fit
            again = repeats(setting.evidence, known.residual_kN, setting.rng(6, number))
        taken, reason = ("", why) if why else (best.effect.id, "best on held-out cycles")
        steps.append(Step(current, alarm, ranking, p_value, line, again, taken, reason))
        if why:
            break
        current = best.fit
        if number > 0:
            current = _revise(setting, current, base, number)
    return Search(base, current, tuple(steps), _rivals(setting, steps[0].ranking, current, base.model.effects), known)


def _p_of_gains(setting: Setting, ranking: Ranking, current: Refit) -> float:
    """Chance of a held-out gain like the largest, over all effects of a size that matters.

    Flipping whole cycles cannot show an effect that sits in a few of them, however large; its gain on held-out cycles
    can. Under "nothing is missing" the mean gain of a cycle is below 0, so Student's t is on the safe side. A held-out
    likelihood ratio is at most 1 on average when nothing is missing, so by Markov's inequality a gain of g nats has a
    chance below exp(-g) (Wasserman, Ramdas, Balakrishnan 2020, universal inference); it sees what a t over a few
    half-cycles cannot.
    """
    floor = PRACTICAL * current.capacity_kN
    pairs = zip(ranking.candidates, ranking.elpd_gain, strict=True)
    tails = [
        min(float(stats.t.sf(c.t, setting.evidence.n_blocks - 1)), float(np.exp(-max(nats, 0.0))))
        for c, nats in pairs
        if c.size_kN >= floor
    ]
    return min(1.0, len(ranking.candidates) * min(tails, default=1.0))


def _rank(
    setting: Setting, base: Refit, current: Refit, tried: Sequence[Candidate], rng: np.random.Generator
) -> Ranking:
    """Rank effects that a model does not hold yet, those that may enter first."""

    def admits(candidate: Candidate, nats: float) -> bool:
        return not _objection(setting, base, current, candidate, nats) and not _poor_double(current, tried, candidate)

    return rank(setting.evidence, tried, rng, admits)


def _poor_double(current: Refit, tried: Sequence[Candidate], candidate: Candidate) -> bool:
    """Whether an effect does what another one does, but worse beyond chance.

    An offset of 0.9 % of Fy is too small to be named; it must not hand its place on to an asymmetry that fits worse
    and is called 1.1 %.
    """
    own = candidate.fit.residual_kN - current.residual_kN
    for other in tried:
        if ahead_beyond_chance(other.gain - candidate.gain):
            change = other.fit.residual_kN - current.residual_kN
            if float(own @ change) > ALIAS * float(np.linalg.norm(own) * np.linalg.norm(change)):
                return True
    return False


def _objection(setting: Setting, base: Refit, current: Refit, candidate: Candidate, nats: float) -> str:
    """Why an effect must not enter; empty when it may.

    It must gain more on held-out cycles than selection among all effects gives, and be worth a name.
    """
    name = candidate.effect.id
    if not _beyond_chance(candidate, nats):
        return f"the best effect ({name}) gains t = {candidate.t:.1f} on held-out cycles: not beyond chance"
    if candidate.size_kN < PRACTICAL * current.capacity_kN:
        return f"the best effect ({name}) is {candidate.size_kN:.2g} kN, below {100 * PRACTICAL:.0f} % of Fy"
    part = share(setting.evidence, setting.fine, base, current, candidate.fit)
    fall = float(np.sqrt(max(current.rmse_kN**2 - candidate.fit.rmse_kN**2, 0.0)))
    large = candidate.size_kN >= LARGE * current.capacity_kN and part >= PART
    of_rest = share(setting.evidence, setting.fine, current, current, candidate.fit)
    clear = candidate.t >= GAIN_SE and (large or of_rest >= OF_REST)
    if part < WORTH and fall < NOTABLE * current.capacity_kN and not clear:
        return f"the best effect ({name}) would take up {100 * part:.1f} % of the misfit of the base law, {fall:.2g} kN"
    return ""


def _beyond_chance(candidate: Candidate, nats: float) -> bool:
    """Whether the held-out gain of an effect, `nats` in all, is beyond what selection among all effects gives.

    By its t over blocks; or by its size, as the t is blind to an effect that sits in three of fourteen half-cycles. One
    that sits in a single block is no evidence: a block that the smaller model happens to predict badly without it would
    then decide (67 of 72 nats for stick-slip in the last half-cycle of a steel damper).
    """
    return nats > 0.0 and (candidate.t >= GAIN_SE or nats * candidate.without_best >= GAIN_NATS)


def _revise(setting: Setting, current: Refit, base: Refit, number: int) -> Refit:
    """Exchange or drop effects that entered earlier, when another one is better now."""
    given = base.model.effects
    for k, effect in enumerate(current.model.effects[:-1]):
        if effect in given:
            continue
        without, tried = _in_place_of(setting, current, effect)
        ranking = _rank(setting, base, without, tried, setting.rng(3, number, k))
        if _objection(setting, base, without, ranking.candidates[0], float(ranking.elpd_gain[0])):
            return _revise(setting, without, base, number) if len(without.model.effects) > len(given) + 1 else without
        current = ranking.candidates[0].fit
    return current


def _in_place_of(setting: Setting, current: Refit, effect: Effect) -> tuple[Refit, list[Candidate]]:
    """Fit a model without one of its effects, and every effect in its place.

    The effect itself stands as it is fitted now where its own starts do not lead there again: a change of clamping
    that was found beside one effect is not given up because it is not found beside two.
    """
    without = _fit_with(setting, current, [other for other in current.model.effects if other is not effect])
    tried = _try_rest(setting, without)
    own = compare(setting.evidence, without.held_out_squares(setting.evidence), current, effect)
    return without, [own if c.effect is effect and c.gain.sum() < own.gain.sum() else c for c in tried]


def _rivals(setting: Setting, first: Ranking, final: Refit, given: Sequence[Effect]) -> dict[str, Ranking]:
    """For each effect of the final model, how every other one would do in its place.

    In the place of the only effect stands the base law, and `first` holds every effect tried beside that already.
    """
    out = {}
    new = [effect for effect in final.model.effects if effect not in given]
    alone = len(new) == 1
    for position, effect in enumerate(new):
        tried = first.candidates if alone else _in_place_of(setting, final, effect)[1]
        out[effect.id] = rank(setting.evidence, tried, setting.rng(4, position))
    return out


def _try_rest(setting: Setting, current: Refit) -> list[Candidate]:
    """Fit a model with each effect that it does not hold yet."""
    own = {effect.id for effect in current.model.effects}
    rest = [effect for effect in setting.catalogue if effect.id not in own]
    return try_all(setting.evidence, current, rest, coarse=setting.coarse)


def _fit_with(setting: Setting, current: Refit, effects: Sequence[Effect]) -> Refit:
    """Fit the base law with some of the current effects, from the current parameters."""
    model = current.model.with_effects(effects)
    values = dict(zip(current.model.law_names, current.z, strict=True))
    start = np.array([values[name] for name in model.law_names])
    return refit(setting.evidence, model, [start], sigma_kN=current.rmse_kN)


def _directions(setting: Setting, current: Refit) -> FloatArray:
    """Regions, and the change each further effect would make from its start values."""
    columns = [setting.regions.columns]
    own = {e.id for e in current.model.effects}
    for effect in setting.catalogue:
        if effect.id in own:
            continue
        model = current.model.with_effects((*current.model.effects, effect))
        # All starts, not the promising ones: those were chosen by looking at the residual that is being tested.
        for start in extend_starts(current, model, effect):
            change = View(setting.evidence, model).force(start) - current.force_kN
            columns.append((change * setting.evidence.weight)[:, None])
    return np.concatenate(columns, axis=1)
