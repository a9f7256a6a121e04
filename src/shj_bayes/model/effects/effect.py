"""What a physical effect is: words, parameters with priors, and what it does to the law; and all that there are.

A module of this package is a chapter of effects by cause: those in its ``EFFECTS`` are found, in a file more as well.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, reduce
from typing import NamedTuple

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.imports import discovered
from shj_bayes.errors import ModelError
from shj_bayes.model import effects
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior

FAMILIES = (
    "even_in_position",
    "low_speed",
    "start_of_stroke",
    "end_of_stroke",
    "slow_change",
    "even_in_direction",
    "odd_in_position",
    "oscillation",
)
LEAST = 1e-3  # of the clamping: effects that take more than all of it leave this


class Contribution(NamedTuple):
    """What an effect does to the law in one run; every part has a neutral default, and parts combine freely."""

    # shape (n_samples,): multiplies Fy (the clamping force or the friction coefficient)
    clamping: FloatArray | float = 1.0
    added_kN: FloatArray | float = 0.0  # shape (n_samples,): added to the force
    # slack_mm, take_up_mm: free travel at zero force after each reversal, and the distance over which it then comes
    # back to full stiffness
    slack_mm: float = 0.0
    take_up_mm: float = 0.0
    # share of the free travel that lies ahead of the first motion, where the run starts without force: which side of
    # its clearance a device rests against is chance
    open_at_start: float = 0.5
    compliance_mm_per_kN: float = 0.0  # elastic part in series (grip, frame)
    smooth_reversal: float = 0.0  # share of the continuous reversal rule, 0 (Eq. 1 as published) to 1 (no jump)
    gamma_s_per_mm: float = 0.0  # added to gamma of Eq. (2)
    # share of the capacity on a second sliding surface, the clearance (mm) that it crosses at zero force, and its
    # stiffness over that share of K
    second_surface: tuple[float, float, float] = (0.0, 0.0, 1.0)


class Base(NamedTuple):
    """The base parameters an effect may refer to: K (kN/mm), Fy of this run (kN), beta, gamma (s/mm), Fy of run 1 (kN).

    Effects that add a force scale with ``Fy_first``: unlike friction they do not degrade with the clamping.
    """

    K: float
    Fy: float
    beta: float
    gamma: float
    Fy_first: float

    def sliding_from(self, clamping: float) -> Base:
        """Give the base of a contact that sticks up to a clamping times Fy: what slides is told from that force."""
        share = max(clamping, LEAST)
        return self._replace(Fy=share * self.Fy, Fy_first=share * self.Fy_first)


Values = Mapping[str, float]
Act = Callable[[History, Values, Base], Contribution]
# ``columns(history, base)``, shape (n_samples, p)
Columns = Callable[[History, Base], FloatArray]


@dataclass(frozen=True)
class Effect:
    """One physical effect."""

    id: str
    family: str
    title: str  # a few words, for headings
    statement: str  # one plain sentence that an engineer can act on; may hold ``{name}`` of a parameter
    equation: str  # plain-text equation
    cause: str  # likely mechanical cause
    shows: str  # where in a recording it shows
    next_test: str  # the cheapest change of the test that would tell it from its rivals
    # parameters with unit, law and source; the first one is the size, 0 (or its neutral value) means no effect
    parameters: tuple[Prior, ...]
    act: Act  # ``act(history, values, base)`` gives the `Contribution` to one run
    source: str  # equation or paper
    # parameter values at which the effect is absent; by default its size at 0
    neutral: Values = field(default_factory=dict)
    # values to start a search from, per parameter; every combination is one start (a few, or a grid of up to 300 that
    # is scanned to first order). A parameter that is not named starts at the middle of its prior.
    start: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    # parameters that say how the device stood when the test began: only the first cycle tells of them, so they are not
    # predicted for it from the others
    initial: tuple[str, ...] = ()
    # how it acts and on which coordinate it depends, e.g. ``("capacity", "travel")``; see `model.coordinates`.
    acts: tuple[tuple[str, str], ...] = ()
    # mechanism, form: where one mechanism has several published formulas, each is an effect: the id of the mechanism
    # (by default its own) and the word for the formula (empty for the first)
    mechanism: str = ""
    form: str = ""
    forms: tuple[Effect, ...] = ()  # the other formulas of the mechanism; see `with_form`
    # parameter that is the time by which the force channel is behind the displacement channel, s; all effects act on
    # the motion of that moment. Empty for most.
    delay: str = ""
    # parameter that is the share of this time that a filter with two poles makes: it rounds corners. Empty for most.
    filtered: str = ""
    # Where the effect is linear in its parameters: what each adds to the clamping, or to the force (kN), at its unit;
    # None for most. Derivatives then cost little.
    columns: Columns | None = None
    columns_added: bool = False  # to the force, not to the clamping

    def __post_init__(self) -> None:
        """Refuse effects without words, parameters or a neutral value."""
        if self.family not in FAMILIES:
            raise ModelError(
                f"effect {self.id}: family '{self.family}' is not known; choose one of {', '.join(FAMILIES)}"
            )
        object.__setattr__(self, "mechanism", self.mechanism or self.id)
        object.__setattr__(self, "neutral", self.neutral or dict.fromkeys(self.names[:1], 0.0))
        names = {p.name for p in self.parameters}
        if not names or not set(self.neutral) <= names:
            raise ModelError(f"effect {self.id}: needs parameters, and a neutral value for at least one of them")
        if not {*self.start, *self.initial, self.delay or self.names[0], self.filtered or self.names[0]} <= names:
            raise ModelError(
                f"effect {self.id}: starts, initial state and delay must be of its parameters, {', '.join(self.names)}"
            )

    def with_form(
        self,
        word: str,
        *,
        statement: str,
        equation: str,
        parameters: tuple[Prior, ...],
        act: Act,
        source: str,
        start: Mapping[str, tuple[float, ...]],
        filtered: str = "",
    ) -> Effect:
        """Give the same mechanism with another published formula beside those it has.

        The id of the form is that of the mechanism, an underscore and its `word`. The rest is as for the effect; the
        size is the first of its parameters and neutral at 0.
        """
        form = replace(
            self,
            id=f"{self.id}_{word}",
            mechanism=self.id,
            form=word,
            forms=(),
            statement=statement,
            equation=equation,
            parameters=parameters,
            neutral={parameters[0].name: 0.0},
            act=act,
            source=source,
            start=start,
            filtered=filtered,
            initial=(),
        )
        return replace(self, forms=(*self.forms, form))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameter names."""
        return tuple(p.name for p in self.parameters)


def combine(contributions: Sequence[Contribution]) -> Contribution:
    """Join the contributions of several effects."""
    return reduce(_joined, contributions) if contributions else Contribution()


def _joined(a: Contribution, b: Contribution) -> Contribution:
    return Contribution(
        clamping=a.clamping * b.clamping,
        added_kN=a.added_kN + b.added_kN,
        slack_mm=a.slack_mm + b.slack_mm,
        take_up_mm=a.take_up_mm + b.take_up_mm,
        open_at_start=(a if a.slack_mm > 0 else b).open_at_start,
        compliance_mm_per_kN=a.compliance_mm_per_kN + b.compliance_mm_per_kN,
        smooth_reversal=min(1.0, a.smooth_reversal + b.smooth_reversal),
        gamma_s_per_mm=a.gamma_s_per_mm + b.gamma_s_per_mm,
        second_surface=(a if a.second_surface[0] > 0 else b).second_surface,
    )


@cache
def _discovered() -> tuple[Effect, ...]:
    """Effects by family, in the order of `FAMILIES`, then by id."""
    found = discovered(effects, "EFFECTS")
    return tuple(sorted(found, key=lambda effect: (FAMILIES.index(effect.family), effect.id)))


def catalogue() -> dict[str, Effect]:
    """Every effect by id, in a fixed order: family, then id; behind each the other forms of its mechanism."""
    return {one.id: one for effect in _discovered() for one in (effect, *effect.forms)}
