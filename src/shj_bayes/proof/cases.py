"""What is concealed in each trial, drawn from one seed; and the canonical text of it that is sealed."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from shj_bayes.errors import ModelError
from shj_bayes.proof.device import Device, Nuisance
from shj_bayes.proof.noise import NOISES
from shj_bayes.proof.protocols import PEAK_SPEED_MM_S
from shj_bayes.proof.simulators.simulator import Simulator, simulators_by_id

# Shares of the trials; at least half hold nothing (issue 4).
NOTHING, OUTSIDE, TWO = 0.50, 0.15, 0.15
RATE_HZ = 10.0
LARGEST_SPEED_FACTOR = 0.35  # of Fy by speed alone: the published rows reach a third at 10 mm/s
SMALL = 0.01  # of Fy: nuisances make less force than that
# Physics that cannot be put into one rig (one spring, one second contact) or that only names the same thing twice.
ALONE = ("inertia", "stick_slip", "two_stage")


@dataclass(frozen=True)
class Concealed:
    """One piece of physics in a trial.

    Parameters
    ----------
    id : str
        Simulator.
    size : float
        In its unit.
    shape : dict of str to float
        What else it needs.
    """

    id: str
    size: float
    shape: dict[str, float]


@dataclass(frozen=True)
class Key:
    """Everything that is concealed about a trial; with it the recordings can be made again to the byte.

    Parameters
    ----------
    number : int
        Number of the trial, from 1.
    kind : {"nothing", "one", "two", "outside"}
        What the trial is for.
    effects : tuple of Concealed
        What is concealed.
    device : Device
        The device.
    nuisance : Nuisance
        Imperfections of the test.
    protocol : {"paper", "improved"}
        Displacement regime.
    entropy : int
        Where the noise of this trial starts from.
    """

    number: int
    kind: str
    effects: tuple[Concealed, ...]
    device: Device
    nuisance: Nuisance
    protocol: str
    entropy: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as they are sealed."""
        return asdict(self)

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> Key:
        """Rebuild a key from what was sealed."""
        values = dict(plain)
        values["effects"] = tuple(Concealed(**one) for one in plain["effects"])
        values["device"], values["nuisance"] = Device(**plain["device"]), Nuisance(**plain["nuisance"])
        return cls(**values)


def canonical(plain: dict[str, Any]) -> bytes:
    """Text of plain values that is the same wherever it is written: sorted keys, no spaces, shortest numbers."""
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")


def draw_keys(seed: int, n: int) -> list[Key]:
    """Draw the keys of all trials from one seed.

    The kinds are dealt like cards, so that their shares are as stated whatever the seed; the effects are dealt within
    their kind for the same reason. Trial i draws the rest from its own stream: more trials leave the first ones alike
    in their streams, but not in what is dealt.

    Parameters
    ----------
    seed : int
        Of the proof.
    n : int
        Number of trials.

    Returns
    -------
    list of Key
    """
    if n < 1:
        raise ModelError(f"{n} trials asked for; allowed is 1 or more")
    root = np.random.SeedSequence(seed)
    deal, *streams = root.spawn(n + 1)
    dealer = np.random.default_rng(deal)
    kinds = _kinds(n, dealer)
    inside = [one for one in simulators_by_id().values() if one.inside]
    outside = [one for one in simulators_by_id().values() if not one.inside]
    decks = {"one": _Deck(inside, dealer), "two": _Deck([s for s in inside if s.id not in ALONE], dealer)}
    decks["outside"] = _Deck(outside, dealer)
    keys = []
    for number, (kind, stream) in enumerate(zip(kinds, streams, strict=True), start=1):
        chosen = [] if kind == "nothing" else [decks[kind].next()]
        if kind == "two":
            chosen.append(decks["two"].next_unlike(chosen[0]))
        keys.append(_draw(number, kind, chosen, stream))
    return keys


def stated_key(name: str, size: float, *, seed: int, protocol: str = "paper", **device: float) -> Key:
    """Make the key of a trial with one stated effect, for development, tests and worked stories.

    Parameters
    ----------
    name : str
        Simulator.
    size : float
        In its unit.
    seed : int
        Of everything else.
    protocol : {"paper", "improved"}
        Displacement regime.
    **device : float
        Parameters of the device that are stated too.

    Returns
    -------
    Key
    """
    one = simulators_by_id()[name]
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    drawn = replace(_device(rng, PEAK_SPEED_MM_S[protocol]), **device)
    effects = (Concealed(one.id, size, one.draw(rng)),)
    kind = "one" if one.inside else "outside"
    return Key(1, kind, effects, drawn, _nuisance(rng, drawn, protocol), protocol, int(rng.integers(2**62)))


class _Deck:
    """Simulators dealt in shuffled rounds."""

    def __init__(self, cards: list[Simulator], rng: np.random.Generator) -> None:
        self._cards, self._rng = cards, rng
        self._left: list[Simulator] = []

    def next(self) -> Simulator:
        if not self._left:
            self._left = [self._cards[i] for i in self._rng.permutation(len(self._cards))]
        return self._left.pop()

    def next_unlike(self, other: Simulator) -> Simulator:
        held = []
        while (card := self.next()).id == other.id:
            held.append(card)
        self._left += held
        return card


def _kinds(n: int, rng: np.random.Generator) -> list[str]:
    """Kinds in their shares, shuffled; what is left over by rounding holds nothing."""
    one = round((1.0 - NOTHING - OUTSIDE - TWO) * n)
    two, outside = round(TWO * n), round(OUTSIDE * n)
    while one + two + outside > n - np.ceil(NOTHING * n):
        one -= 1
    kinds = ["one"] * one + ["two"] * two + ["outside"] * outside
    kinds += ["nothing"] * (n - len(kinds))
    return [kinds[i] for i in rng.permutation(n)]


def _draw(number: int, kind: str, chosen: list[Simulator], stream: np.random.SeedSequence) -> Key:
    """Device, sizes, nuisances and protocol of one trial."""
    rng = np.random.default_rng(stream)
    allowed = [p for p in ("paper", "improved") if all(p in one.protocols for one in chosen)]
    protocol = allowed[int(rng.integers(len(allowed)))]
    device = _device(rng, PEAK_SPEED_MM_S[protocol])
    effects = tuple(
        Concealed(
            one.id,
            float(np.exp(rng.uniform(*np.log(one.sizes)))) * (rng.choice([-1.0, 1.0]) if one.signed else 1.0),
            one.draw(rng),
        )
        for one in chosen
    )
    return Key(number, kind, effects, device, _nuisance(rng, device, protocol), protocol, int(rng.integers(2**62)))


def _device(rng: np.random.Generator, peak_speed: float) -> Device:
    """Within the range of the published Tables 3 to 7; the smallest block must slide, or nearly so."""
    while True:
        K, Fy = np.exp(rng.uniform(*np.log([6.0, 22.0]))), np.exp(rng.uniform(*np.log([22.0, 95.0])))
        if 2 * Fy / K < 14.0:
            break
    bound = min(1 / 30, LARGEST_SPEED_FACTOR / peak_speed)
    gamma = float(rng.choice([0.0, 1.0, -1.0])) * float(np.exp(rng.uniform(np.log(bound / 5), np.log(bound))))
    beta = float(np.exp(rng.uniform(np.log(8.0), np.log(100.0))))
    return Device(float(K), float(Fy), beta, gamma, float(rng.uniform(0.5, 0.95)))


def _nuisance(rng: np.random.Generator, device: Device, protocol: str) -> Nuisance:
    """Each below 1 % of Fy in the force it makes."""
    late = min(0.003, SMALL * device.Fy / (device.K * PEAK_SPEED_MM_S[protocol]))
    return Nuisance(
        frame_kN_mm=float(rng.uniform(20.0, 80.0)) * device.K,
        lag_s=float(rng.uniform(0.0, late)),
        offset_kN=float(rng.uniform(-0.003, 0.003)) * device.Fy,
        force_step_kN=float(rng.choice([0.005, 0.02, 0.05])),
        displacement_step_mm=float(rng.choice([0.001, 0.005, 0.01])),
        noise=NOISES[int(rng.integers(len(NOISES)))],
        noise_kN=float(np.exp(rng.uniform(*np.log([0.004, 0.015])))) * device.Fy,
        displacement_noise_mm=float(rng.uniform(0.005, 0.02)),
    )
