"""A set of classes with the model that holds them, and what can be put in the place of what."""

from dataclasses import dataclass

import numpy as np

from shj_bayes.mismatch.classes import Candidate
from shj_bayes.mismatch.scene import Metric, Scene
from shj_bayes.mismatch.state import State
from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.diagnosis import ClassId

CONSTANT = str(ClassId("added", "constant"))
TEETH = ClassId("motion", "stick-slip")
POSITION, DISTANCE, DIRECTION, SLIP = (
    str(ClassId("capacity", name)) for name in ("position", "distance", "direction", "slip")
)


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of classes with the model that holds them."""

    members: tuple[Candidate, ...]  # classes, in the order of the effects of the model behind those that were given
    state: State  # the model, fitted
    log_weight: float  # log of the evidence times the probability before the test
    metric: Metric | None = None  # noise and discrepancy under which it was weighed; None during a search

    @property
    def key(self) -> frozenset[str]:
        """Ids of the classes."""
        return frozenset(member.of.id for member in self.members)


def columns_of(scene: Scene, state: State, place: int) -> list[int]:
    """Positions of the parameters of a member, in the place among its classes, in the vector of a model."""
    effect = state.model.effects[len(scene.device.effects) + place]
    return [i for i, name in enumerate(state.model.law_names) if name.startswith(f"{effect.id}.")]


def without(scene: Scene, h: Hypothesis, place: int) -> tuple[tuple[Candidate, ...], FloatArray]:
    """Members of a hypothesis less the one in a place, and where the rest of its model is."""
    members = (*h.members[:place], *h.members[place + 1 :])
    return members, np.delete(h.state.z, columns_of(scene, h.state, place))


def joined(h: Hypothesis, c: Candidate) -> FloatArray:
    """Start of a hypothesis with one more class: the parameters of the smaller one, and where the class begins."""
    return np.concatenate([h.state.z, c.start[-len(c.variant.effect.parameters) :]])


def replaced(h: Hypothesis, place: int, member: Candidate) -> tuple[Candidate, ...]:
    """Give the members of a hypothesis with another one in a place."""
    return (*h.members[:place], member, *h.members[place + 1 :])


def is_curve(member: Candidate) -> bool:
    """Whether a class has no formula here: it is a curve, or it acts on the motion."""
    return member.variant.curve is not None or not any(v.curve is not None for v in member.of.variants)


def second_of(member: Candidate) -> str | None:
    """Class that a curve may hold beside its own: position and distance, or time and direction where both count."""
    curve = member.variant.curve
    if curve is not None and curve.sides:
        return DIRECTION
    return DISTANCE if curve is not None and member.of.id == POSITION else None


def same_twice(a: Candidate, b: Candidate) -> bool:
    """Whether one of two is a curve over position and the other a function of the distance, its even part."""
    pairs = [(m, n) for m, n in ((a, b), (b, a)) if (m.of.id, n.of.id) == (POSITION, DISTANCE)]
    return any(m.variant.curve is not None for m, _ in pairs)
