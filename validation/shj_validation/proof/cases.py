"""What is concealed in each trial, drawn from one seed; and the canonical text of it that is sealed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from shj_bayes.errors import ModelError
from shj_validation.proof.device import Device, Nuisance
from shj_validation.proof.noise import ALL_NOISES, HUM, MEMORIES_S, NOISES
from shj_validation.proof.protocols import EARLIER, PEAK_SPEED_MM_S, duration, peak_speed
from shj_validation.proof.simulators.rig import RULES
from shj_validation.proof.simulators.simulator import Simulator, simulators_by_id

# Shares of the trials; half hold nothing: false alarms are rare, and counted on these.
NOTHING, OUTSIDE, TWO = 0.50, 0.15, 0.15
KINDS = ("nothing", "one", "two", "outside")
DEVELOPMENT = 1_000_000_007  # apart from the streams of every proof, whatever its number of trials
FIRST_SD = 3.0  # that a first reading is off where it is
HUM_HZ = 20.0  # least rate of a trial with hum: at 5 Hz 50 Hz is a slow wave, which a diagnosis rightly finds
MOST_READINGS = 250_000
SLIDES_MM = 14.0  # elastic part of a stroke: the smallest block must slide, or nearly so
SOFT = (2.0, 15.0)  # stiffness of a testing machine, times that of the device
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
class Design:
    """What the trials of a proof are drawn from.

    Parameters
    ----------
    protocols, noises, rules : sequence of str
        Displacement histories, kinds of force noise, reversal rules.
    rates : dict of float to float
        Sampling rate in Hz, and the share of the trials that are recorded at it.
    machine, first_off : float
        Shares of the trials whose displacement is measured at the machine, and whose first force reading is off.
    most_readings : int, optional
        Of a run: a longer test is recorded at a lower rate; and one with hum at `HUM_HZ` or more.
    """

    protocols: Sequence[str]
    noises: Sequence[str]
    rates: dict[float, float]
    machine: float = 0.0
    first_off: float = 0.0
    rules: Sequence[str] = RULES
    most_readings: int | None = None


# By schema of what is sealed. The first kind is kept so that its proofs can be made and checked for ever.
DESIGNS = {
    "shj-bayes/proof/1": Design(EARLIER, NOISES, {5.0: 0.40, 20.0: 0.45, 200.0: 0.15}),
    "shj-bayes/proof/2": Design(
        tuple(PEAK_SPEED_MM_S),
        ALL_NOISES,
        {5.0: 0.20, 10.0: 0.15, 20.0: 0.25, 50.0: 0.15, 100.0: 0.10, 250.0: 0.05, 1000.0: 0.10},
        machine=0.4,
        first_off=0.1,
        most_readings=MOST_READINGS,
    ),
    # To be looked at by eye and in spreadsheets: few readings, and no reversal rule to be told.
    "shj-bayes/challenge/1": Design(
        tuple(PEAK_SPEED_MM_S),
        ALL_NOISES,
        {5.0: 0.6, 10.0: 0.3, 20.0: 0.1},
        machine=0.4,
        first_off=0.1,
        rules=("continuous",),
        most_readings=MOST_READINGS,
    ),
}
PROOF_1, PROOF_2, CHALLENGE = DESIGNS


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
    protocol : str
        Displacement regime, see `shj_validation.proof.protocols`.
    rate_Hz : float
        Sampling rate of the recording, Hz.
    reversal : {"published", "continuous"}
        What the device does at a reversal: jump as Eq. (1) does, or unload from the force it has.
    entropy : int
        Where the noise of this trial starts from.
    first_sd : float
        What is added to the first force reading of each run, in standard deviations of the noise.
    machine_kN_mm : float
        Stiffness of the testing machine where displacement is measured at it; 0 where it is measured across the slip.
    """

    number: int
    kind: str
    effects: tuple[Concealed, ...]
    device: Device
    nuisance: Nuisance
    protocol: str
    rate_Hz: float
    reversal: str
    entropy: int
    first_sd: float = 0.0
    machine_kN_mm: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values, as they are sealed; what came later is stated only where it is not 0."""
        plain = asdict(self)
        return {k: v for k, v in plain.items() if v or k not in ("first_sd", "machine_kN_mm")}

    @classmethod
    def from_dict(cls, plain: dict[str, Any]) -> Key:
        """Rebuild a key from what was sealed."""
        values: dict[str, Any] = {"rate_Hz": 10.0, "reversal": "continuous"} | plain  # where a key does not state them
        values["effects"] = tuple(Concealed(**one) for one in plain["effects"])
        values["device"], values["nuisance"] = Device(**plain["device"]), Nuisance(**plain["nuisance"])
        return cls(**values)


def canonical(plain: dict[str, Any]) -> bytes:
    """Text of plain values that is the same wherever it is written: sorted keys, no spaces, shortest numbers."""
    return json.dumps(plain, sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")


def draw_keys(seed: int, n: int, schema: str = PROOF_1) -> list[Key]:
    """Draw the keys of all trials from one seed.

    The kinds are dealt like cards, so that their shares are as stated whatever the seed; the effects are dealt within
    their kind for the same reason, the forms within their effect, and protocols within their kind (in the first kind of
    proof they are drawn). Trial i draws the rest from its own stream: more trials leave the first ones alike in their
    streams, but not in what is dealt.

    Parameters
    ----------
    seed : int
        Of the proof.
    n : int
        Number of trials.
    schema : str
        One of `DESIGNS`.

    Returns
    -------
    list of Key
    """
    if n < 1:
        raise ModelError(f"{n} trials asked for; allowed is 1 or more")
    design = DESIGNS[schema]
    root = np.random.SeedSequence(seed)
    deal, *streams = root.spawn(n + 1)
    dealer = np.random.default_rng(deal)
    kinds = _kinds(n, dealer)
    hand = _Hand(dealer)
    decks = {} if schema == PROOF_1 else {kind: _Deck(design.protocols, dealer) for kind in KINDS}
    keys = []
    for number, (kind, stream) in enumerate(zip(kinds, streams, strict=True), start=1):
        chosen, protocols = hand.next(kind), design.protocols
        if decks:
            protocols = [decks[kind].next()]
            while not _allowed(protocols, chosen):
                protocols = [decks[kind].next()]
        keys.append(_draw(number, kind, chosen, np.random.default_rng(stream), replace(design, protocols=protocols)))
    return keys


def development_keys(
    seed: int,
    n: int,
    kind: str,
    *,
    effect: str | None = None,
    rate_Hz: float | None = None,
    design: Design = DESIGNS[PROOF_1],
    first: bool = False,
) -> list[Key]:
    """Draw keys of one kind for development, from streams that no proof uses; trial i is the same whatever `n` is.

    Parameters
    ----------
    seed : int
        Of development.
    n : int
        Number of trials.
    kind : {"nothing", "one", "two", "outside"}
        What the trials are for.
    effect : str, optional
        Effect of the catalogue (its forms in turn), or one simulator, that each trial holds.
    rate_Hz : float, optional
        In place of the drawn sampling rate.
    design : Design
        What is drawn from for each trial.
    first : bool
        Whether the first force reading of each run is off by `FIRST_SD`.

    Returns
    -------
    list of Key
    """
    if kind not in KINDS:
        raise ModelError(f"trials of kind '{kind}' are not known; choose one of {', '.join(KINDS)}")
    known = simulators_by_id().values()
    forms = [one for one in known if one.effect == effect] or [one for one in known if one.id == effect]
    if effect is not None and not forms:
        raise ModelError(f"no simulator is '{effect}'; choose one of {', '.join(simulators_by_id())}")

    def stream(*place: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(seed, spawn_key=(DEVELOPMENT, *place))

    place = KINDS.index(kind)
    hand = _Hand(np.random.default_rng(stream(place, 0)), forms)
    out = []
    for i in range(1, n + 1):
        key = _draw(i, kind, hand.next(kind), np.random.default_rng(stream(place, i)), design)
        drawn = max(key.rate_Hz, HUM_HZ) if key.nuisance.noise == HUM else key.rate_Hz
        sign = 1.0 if key.entropy % 2 else -1.0
        out.append(replace(key, rate_Hz=rate_Hz or drawn, first_sd=sign * FIRST_SD if first else key.first_sd))
    return out


def stated_key(
    name: str,
    size: float,
    *,
    seed: int,
    protocol: str = "paper",
    rate_Hz: float = 20.0,
    reversal: str = "continuous",
    **device: float,
) -> Key:
    """Make the key of a trial with one stated effect, for development, tests and worked stories.

    Parameters
    ----------
    name : str
        Simulator.
    size : float
        In its unit.
    seed : int
        Of everything else.
    protocol : str
        Displacement regime.
    rate_Hz : float
        Sampling rate, Hz.
    reversal : {"published", "continuous"}
        Reversal rule of the device.
    **device : float
        Parameters of the device that are stated too.

    Returns
    -------
    Key
    """
    one = simulators_by_id()[name]
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    drawn = replace(_device(rng, peak_speed(protocol)), **device)
    effects = (Concealed(one.id, size, one.draw(rng)),)
    kind = "one" if one.inside else "outside"
    nuisance = _nuisance(rng, drawn, protocol)
    return Key(1, kind, effects, drawn, nuisance, protocol, rate_Hz, reversal, int(rng.integers(2**62)))


class _Deck:
    """Cards dealt in shuffled rounds."""

    def __init__(self, cards: Iterable[str], rng: np.random.Generator) -> None:
        self._cards, self._rng = sorted(cards), rng
        self._left: list[str] = []

    def next(self) -> str:
        if not self._left:
            self._left = [self._cards[i] for i in self._rng.permutation(len(self._cards))]
        return self._left.pop()


class _Hand:
    """Decks of effects for each kind of trial, and of the forms of each effect; `first` replaces the first effect."""

    def __init__(self, rng: np.random.Generator, first: Sequence[Simulator] = ()) -> None:
        known = simulators_by_id()
        effects: dict[str, list[str]] = {}
        for one in known.values():
            effects.setdefault(one.effect, []).append(one.id)
        inside = {one.effect for one in known.values() if one.inside}
        cards = {"one": inside, "two": inside - set(ALONE), "outside": set(effects) - inside}
        self._decks = {kind: _Deck(own, rng) for kind, own in cards.items()}
        self._forms = {effect: _Deck(own, rng) for effect, own in effects.items()}
        self._first = _Deck([one.id for one in first], rng) if first else None

    def next(self, kind: str) -> list[Simulator]:
        if kind == "nothing":
            return []
        chosen = [simulators_by_id()[self._first.next()] if self._first else self._one(kind)]
        while kind == "two" and len(chosen) < 2:
            other = self._one(kind)
            # Two changes over one coordinate are one change, to whoever has only the recording.
            if not set(other.coordinates) & set(chosen[0].coordinates):
                chosen.append(other)
        return chosen

    def _one(self, kind: str) -> Simulator:
        return simulators_by_id()[self._forms[self._decks[kind].next()].next()]


def _kinds(n: int, rng: np.random.Generator) -> list[str]:
    """Kinds in their shares, shuffled; what is left over by rounding holds nothing."""
    one = round((1.0 - NOTHING - OUTSIDE - TWO) * n)
    two, outside = round(TWO * n), round(OUTSIDE * n)
    while one + two + outside > n - np.ceil(NOTHING * n):
        one -= 1
    kinds = ["one"] * one + ["two"] * two + ["outside"] * outside
    kinds += ["nothing"] * (n - len(kinds))
    return [kinds[i] for i in rng.permutation(n)]


def _allowed(protocols: Sequence[str], chosen: list[Simulator]) -> list[str]:
    """Protocols in which what is concealed can show at all; of the later ones every one is tried."""
    return [p for p in protocols if p not in EARLIER or all(p in one.protocols for one in chosen)]


def _draw(number: int, kind: str, chosen: list[Simulator], rng: np.random.Generator, design: Design) -> Key:
    """Device, sizes, nuisances, protocol, rate and reversal rule of one trial."""
    allowed = _allowed(design.protocols, chosen)
    protocol = allowed[int(rng.integers(len(allowed)))]
    device = _device(rng, peak_speed(protocol))
    effects = tuple(
        Concealed(
            one.id,
            float(np.exp(rng.uniform(*np.log(one.sizes))) * (rng.choice([-1.0, 1.0]) if one.signed else 1.0)),
            one.draw(rng),
        )
        for one in chosen
    )
    nuisance = _nuisance(rng, device, protocol, design.noises)
    rate = _rate(rng, design, protocol, nuisance.noise)
    rules = [rule for rule in design.rules if all(rule in one.rules for one in chosen)]
    rule = rules[int(rng.integers(len(rules)))]
    key = Key(number, kind, effects, device, nuisance, protocol, rate, rule, int(rng.integers(2**62)))
    if design.first_off and rng.random() < design.first_off:
        key = replace(key, first_sd=float(rng.choice([-1.0, 1.0])) * FIRST_SD)
    if design.machine and rng.random() < design.machine:
        # A spring in series springs back at the jump of the published rule, which is a reversal again: see rig.py.
        # While the device sticks it moves slower than the machine by K/machine: a law of speed must not show that, as
        # K does not take it up.
        soft = float(np.exp(rng.uniform(*np.log(SOFT)))) * device.K
        slides = 1.0 / (SLIDES_MM / (2 * device.Fy) - 1.0 / device.K)
        slow = device.K * (abs(device.gamma) * peak_speed(protocol) / (0.7 * SMALL) - 1.0)
        key = replace(key, machine_kN_mm=max(soft, slides, slow), reversal="continuous")
    return key


def _rate(rng: np.random.Generator, design: Design, protocol: str, noise: str) -> float:
    """Draw a sampling rate, Hz: not too many readings, and enough of them to show hum as hum."""
    if design.most_readings is None:
        return float(rng.choice(list(design.rates), p=list(design.rates.values())))
    least, most = HUM_HZ if noise == HUM else 0.0, design.most_readings / duration(protocol)
    rates = {hz: share for hz, share in design.rates.items() if least <= hz <= most}
    return float(rng.choice(list(rates), p=np.array(list(rates.values())) / sum(rates.values())))


def _device(rng: np.random.Generator, peak_speed: float) -> Device:
    """Within the range of the published Tables 3 to 7; the smallest block must slide, or nearly so."""
    while True:
        K, Fy = np.exp(rng.uniform(*np.log([6.0, 22.0]))), np.exp(rng.uniform(*np.log([22.0, 95.0])))
        if 2 * Fy / K < SLIDES_MM:
            break
    bound = min(1 / 30, LARGEST_SPEED_FACTOR / peak_speed)
    gamma = float(rng.choice([0.0, 1.0, -1.0])) * float(np.exp(rng.uniform(np.log(bound / 5), np.log(bound))))
    beta = float(np.exp(rng.uniform(np.log(8.0), np.log(100.0))))
    return Device(float(K), float(Fy), beta, gamma, float(rng.uniform(0.5, 0.95)))


def _nuisance(rng: np.random.Generator, device: Device, protocol: str, noises: Sequence[str] = NOISES) -> Nuisance:
    """Each below 1 % of Fy in the force it makes; rounded forces are rounded to more than their noise."""
    noise, noise_kN = (
        noises[int(rng.integers(len(noises)))],
        float(np.exp(rng.uniform(*np.log([0.004, 0.015])))) * device.Fy,
    )
    late = min(0.003, SMALL * device.Fy / (device.K * peak_speed(protocol)))
    return Nuisance(
        frame_kN_mm=float(rng.uniform(20.0, 80.0)) * device.K,
        lag_s=float(rng.uniform(0.0, late)),
        offset_kN=float(rng.uniform(-0.003, 0.003)) * device.Fy,
        force_step_kN=2.0 * noise_kN if noise == "rounded" else float(rng.choice([0.005, 0.02, 0.05])),
        displacement_step_mm=float(rng.choice([0.001, 0.005, 0.01])),
        noise=noise,
        noise_kN=noise_kN,
        displacement_noise_mm=float(rng.uniform(0.005, 0.02)),
        noise_memory_s=float(rng.choice(MEMORIES_S)),
    )
