"""Protocols among which a plan chooses, and the rig that must be able to run them."""

from dataclasses import dataclass

import numpy as np

from shj_bayes.planning.proposals import first_protocols
from shj_bayes.planning.protocol import Protocol
from shj_bayes.planning.rig import Rig

DRAWN = 8


@dataclass(frozen=True)
class Candidates:
    """Where a search for the next test begins."""

    rig: Rig
    first: tuple[Protocol, ...]  # proposed ones, Table 1 first
    given: tuple[Protocol, ...] = ()  # those of the user, shown beside the best whatever they give

    @property
    def all(self) -> tuple[Protocol, ...]:
        """Every protocol, the proposed ones first."""
        return (*self.first, *self.given)


def proposals(rig: Rig, seed: int, given: tuple[Protocol, ...] = ()) -> Candidates:
    """Propose protocols, and put those of the user beside them; the same seed proposes the same."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
    return Candidates(rig, tuple(first_protocols(rig, rng, DRAWN)), given)
