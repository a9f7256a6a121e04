"""What hypotheses are fitted under: the recordings, a noise, and the classes that are looked for."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.start import start_values
from shj_bayes.mismatch.data import BinnedData, ErrorModel, ErrorParameters
from shj_bayes.mismatch.hypothesis import (
    LOG_PRIOR_ODDS,
    Candidate,
    Dependence,
    Hypothesis,
    cancel,
    columns_of,
    formulas,
    same_twice,
    screen,
    size_weights,
    without,
)
from shj_bayes.mismatch.laplace import Laplace, find_noise, laplace
from shj_bayes.mismatch.periodic import follows_cycles, is_over_a_clock, waves
from shj_bayes.model.curve import SIZES
from shj_bayes.model.device import DeviceModel

WIDE = 2.0  # times the size of a curve, or of an effect where its search begins: what noise is found beside
NEARLY = 2.0  # nats; formulas that are worse than the best by more add little to the weight of their class
FLAT = 1e3  # of Fy: a constant force as large as any


@dataclass(frozen=True, eq=False)
class Fitter:
    """Fits hypotheses to the recordings of a device under one noise."""

    # what is looked for, with columns at the base law: they change little from model to model, and only choose what is
    # fitted
    looked: Sequence[Candidate]
    metric: ErrorModel  # noise and discrepancy in the recordings, found beside everything that is looked for
    hidden: frozenset[str] = frozenset()  # mechanisms whose formulas are not tried
    floor: float = -math.inf  # log weight, nats, below which a fit is given up on its way
    _screened: dict[Hypothesis, list[Candidate]] = field(init=False, default_factory=dict)

    @cached_property
    def classes(self) -> dict[str, Dependence]:
        """Classes that are looked for, by their ids."""
        return {c.of.id: c.of for c in self.looked}

    def candidates_of(self, of: str, *, curves: bool = False) -> list[Candidate]:
        """Candidates of a class, by its id; its curves alone, if asked for."""
        return [c for c in self.looked if c.of.id == of and not (curves and c.variant.curve is None)]

    def model_of(self, members: Iterable[Candidate]) -> DeviceModel:
        """Model that holds given classes."""
        added = tuple(member.variant.effect for member in members)
        device = self.metric.data.device
        return device.with_effects((*device.effects, *added))

    def fitted(self, members: tuple[Candidate, ...], start: FloatArray, floor: float = -math.inf) -> Hypothesis | None:
        """Fit a hypothesis from a start; None where there is no fit, or one whose log weight will not reach `floor`."""
        data = self.metric.data
        try:
            state = laplace(self.metric, self.model_of(members), start, max(self.floor, floor))
            # Or nothing can be weighed beside it. By half of the prior, as rounding differs when it is worked out anew.
            np.linalg.cholesky(0.5 * np.eye(state.z.size) + state.gaussian.inner)
            weight = state.evidence + len(members) * LOG_PRIOR_ODDS
            weight += sum(self._about_size(state, i, m) for i, m in enumerate(members))
        except np.linalg.LinAlgError:
            return None
        for variant in (m.variant for m in members if is_over_a_clock(m.of)):
            values = state.values_of(variant.effect)  # of a formula or a wave over a clock: not what the cycles do
            if (variant.curve is None or variant.curve.period) and follows_cycles(data, variant.effect, values):
                return None
        return Hypothesis(members, state, weight) if math.isfinite(weight) and not cancel(state, members) else None

    def _about_size(self, state: Laplace, place: int, member: Candidate) -> float:
        """Log weight of a parametrisation, of a curve with its size averaged over."""
        extra, curve = math.log(member.variant.weight), member.variant.curve
        if curve is None:
            return extra
        given, own = state.gaussian, columns_of(self.metric.data, state, place)
        its_own = np.isin(np.arange(state.z.size), own)
        gains = [given.sized(np.where(its_own, size / curve.size, 1.0)).gain for size in SIZES]
        return extra + float(np.logaddexp.reduce(np.array(gains) - given.gain + np.log(size_weights())))

    def all_fitted(self, tried: Iterable[tuple[tuple[Candidate, ...], Candidate]]) -> list[Hypothesis]:
        """Fit hypotheses, each from the start of a form; those with a fit, most probable first."""
        ones = [one for members, form in tried if (one := self.fitted(members, form.start)) is not None]
        return sorted(ones, key=lambda one: -one.log_weight)

    def best_fitted(
        self, tried: Iterable[tuple[tuple[Candidate, ...], Candidate]], floor: float = -math.inf
    ) -> Hypothesis | None:
        """Fit hypotheses that differ in the formula of one class, each from the start of a form; the most probable one.

        The formula of the best one stands for all that do nearly as well, and has the weight of them all: it is the
        class that is weighed. None where there is no fit.
        """
        ones: dict[str, tuple[Hypothesis, Candidate]] = {}
        floor -= NEARLY
        for members, form in sorted(tried, key=lambda one: -one[1].gain):
            one, name = self.fitted(members, form.start, floor), form.variant.effect.id
            if one is not None and (name not in ones or one.log_weight > ones[name][0].log_weight):
                ones[name], floor = (one, form), max(floor, one.log_weight - NEARLY)
        if not ones:
            return None
        best, own = max(ones.values(), key=lambda pair: pair[0].log_weight)
        more = float(np.logaddexp.reduce([one.log_weight for one, _ in ones.values()])) - best.log_weight
        all_of_them = replace(own, variant=replace(own.variant, weight=own.variant.weight * math.exp(more)))
        members = tuple(all_of_them if m is own else m for m in best.members)
        return replace(best, members=members, log_weight=best.log_weight + more)

    def with_own_noise(self, h: Hypothesis, start: ErrorParameters) -> Hypothesis | None:
        """Fit a hypothesis under the noise that is most probable beside it, searched for from a start."""
        none = np.zeros((h.state.residual.size, 0))
        data = self.metric.data
        metric = ErrorModel(data, find_noise(data, h.state, none, start), h.state.slope)
        new = replace(self, metric=metric).fitted(h.members, h.state.z)
        return replace(new, metric=metric) if new is not None else None

    def screen(self, h: Hypothesis) -> list[Candidate]:
        """Candidates to add to a hypothesis, the best of each class, best first."""
        if h not in self._screened:
            rest = [c for c in self.looked if c.of.id not in h.key]
            free = {c.of.id: c.of for c in rest}.values()
            again = [wave for of in free for wave in waves(self.metric, h.state, of)]
            apart = [c for c in (*rest, *again) if not any(same_twice(c, m) for m in h.members)]
            self._screened[h] = screen(self.metric, h.state, apart)
        return self._screened[h]

    def forms(self, h: Hypothesis, place: int) -> list[Candidate]:
        """Formulas of the class of a member, each from its best starts, with where the rest of the model is."""
        data = self.metric.data
        at = place, columns_of(data, h.state, place)[0]
        return self.forms_of(h.members[place].of, *without(data, h, place), at)

    def forms_of(
        self, of: Dependence, members: tuple[Candidate, ...], z: FloatArray, at: tuple[int, int] | None = None
    ) -> list[Candidate]:
        """Formulas of a class, each from its best starts, beside other members and where their model is, `z`.

        `at` is the place of the class among the members, and of its parameters among theirs; the last by default.
        """
        (place, first), data = at or (len(members), z.size), self.metric.data
        nothing, out = np.zeros((data.blocks.used.size, 0)), []
        for variant in formulas((of.action, of.coordinate), self.hidden):
            form = Candidate(of, variant, z, nothing, data.device)
            model = self.model_of((*members[:place], form, *members[place:]))
            values = start_values(variant.effect)
            if variant.effect.parameters[0].either_sign:  # a size of either sign
                values[0] = sorted({*values[0], *(-value for value in values[0])})
            tails = [np.array(tail) for tail in product(*values)]
            starts = np.array([np.insert(z, first, tail) for tail in tails])
            with np.errstate(all="ignore"):
                residual = data.likelihood.at(model).residual(starts)
                heights = self.metric.squares(np.nan_to_num(residual.T, nan=1e6))
            best = np.argsort(heights, kind="stable")[: 1 if heights.size < 3 else 2]
            out += [replace(form, start=starts[i], model=model, gain=-0.5 * float(heights[i])) for i in best]
        return out


def noise_beside(
    data: BinnedData, state: Laplace, looked: Sequence[Candidate], start: ErrorParameters | None
) -> ErrorModel:
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
    columns.append(FLAT * data.zeros * data.scale_kN)  # a constant says nothing of the noise
    wide = np.concatenate(columns, axis=1) if columns else np.zeros((state.residual.size, 0))
    return ErrorModel(data, find_noise(data, state, wide, start, data.noise_most_kN), state.slope)


def noise_of_size(device: DeviceModel, size_kN: float) -> tuple[float, ...]:
    """Noise parameters to begin with, unbounded: the size of a residual in every part."""
    values = []
    for own, law in zip(device.noise.own, device.laws[device.n_law :], strict=True):
        unit = size_kN if own.unit == "kN" else 1.0
        value = law.quantile(0.5) if own.typical is None else np.asarray(own.typical * unit)
        values.append(float(np.clip(law.to_free(value), -7.0, 7.0)))
    return tuple(values)
