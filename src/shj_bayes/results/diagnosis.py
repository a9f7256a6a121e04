"""``diagnosis.json``: what the law leaves out of a device; ``residual.json``: how much a fit leaves unexplained."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Literal, NamedTuple, Self

from shj_bayes.recording.smoothing import Refusal
from shj_bayes.results.codec import IF_KNOWN, Probability, ProbabilityOrNone, Stored
from shj_bayes.results.fit import Trust

SCHEMA: Literal["shj-bayes/diagnosis/2"] = "shj-bayes/diagnosis/2"
SIGMA_90 = 1.6449  # standard deviations to either side that hold 90 % of a normal law
NOTHING_MISSING = "nothing of a size that matters"  # words for a set without classes
FEWEST_CYCLES = 3  # what comes again twice may be shape; what is there once or twice may be chance
FAIR_PERCENT = 2.0  # of Fy: a load cell's own drift stays below
POOR_PERCENT = 5.0  # of Fy: more than nominally identical devices differ by
Action = Annotated[str, {"enum": ("capacity", "added", "motion")}]
Direction = Annotated[str, {"enum": ("push", "pull", "both")}]


class DiagnosisVerdict(StrEnum):
    """What a diagnosis found."""

    ADEQUATE = "adequate"
    NAMED = "named"
    FAMILY = "family"
    UNKNOWN = "unknown"


class DependenceId(NamedTuple):
    """A class by its action and its coordinate; its word is ``capacity over travel`` and the like."""

    action: str
    coordinate: str

    def __str__(self) -> str:
        """Word of the class."""
        return f"{self.action} over {self.coordinate}"

    @classmethod
    def read(cls, word: str) -> Self:
        """Read the word of a class.

        Raises
        ------
        ValueError
            If it is none.
        """
        action, coordinate = word.split(" over ")
        return cls(action, coordinate)


@dataclass(frozen=True, kw_only=True)
class DrawsInShort:
    """Draws of a number in short; files of the first schema may lack the quantiles."""

    mean: float
    sd: float
    q05: float | None = None
    q50: float | None = None
    q95: float | None = None


@dataclass(frozen=True, kw_only=True)
class Shift:
    """A parameter of the base law without and with what was found."""

    before: DrawsInShort
    after: DrawsInShort


@dataclass(frozen=True, kw_only=True)
class EffectParameter(DrawsInShort):
    """A parameter of an effect."""

    unit: str


@dataclass(frozen=True, kw_only=True)
class EffectRecord:
    """A mechanism that was found."""

    id: str
    form: str = ""
    family: str
    title: str = ""
    statement: str
    equation: str
    cause: str = ""
    shows: str = ""
    partial: bool = False  # it explains a part of what was left out
    probability: ProbabilityOrNone
    rivals: tuple[str, ...] = ()  # effects that may stand in its place
    size_kN: float | None = None
    parameters: Mapping[str, EffectParameter]


@dataclass(frozen=True, kw_only=True)
class Member:
    """An effect of a family that the recording cannot tell apart."""

    id: str
    probability: ProbabilityOrNone


@dataclass(frozen=True, kw_only=True)
class CurveRecord:
    """A curve over a coordinate, with its 90 % band."""

    at: tuple[float, ...]
    mean: tuple[float, ...]
    q05: tuple[float, ...]
    q95: tuple[float, ...]
    unit: str


@dataclass(frozen=True, kw_only=True)
class DependenceRecord:
    """A coordinate that the force depends on beyond the base law."""

    coordinate: str
    unit: str
    action: Action
    direction: Direction = "both"
    probability: Probability
    evidence: float | None = None  # over the base law, nats
    size_percent: float | None = None
    range_percent: float | None = None
    curve: CurveRecord | None = None
    period: float | None = None
    matches: tuple[str, ...] = ()  # effects within the band


@dataclass(frozen=True, kw_only=True)
class SetProbability:
    """Classes that may be there together."""

    classes: tuple[str, ...]
    probability: float


@dataclass(frozen=True, kw_only=True)
class EvidenceRecord:
    """Log weights of sets of classes, and how each class would be written in the model of the device.

    Sizes and changes are to first order where a class is not in the model; the first `fitted` sets were fitted, the
    others are of first order.
    """

    classes: tuple[str, ...]  # ids of all that were looked for
    log_odds: float  # of each before the test
    own: Mapping[str, str]  # effect that stands for a class in the model that is shown
    written: Mapping[str, str]  # effect that would stand for each other class
    # per cent of Fy that the base law could not make, or where the class is not in the model, that the model could not
    size_percent: Mapping[str, float]
    change_percent: Mapping[str, float]  # of a curve from one end of its coordinate to the other
    sets: tuple[tuple[Annotated[int, {"minimum": 0}], ...], ...]  # each a list of positions in `classes`
    nats: tuple[float, ...]  # log weight of each over that of the empty set
    fitted: int


@dataclass(frozen=True, kw_only=True)
class Location:
    """Where the base law fails."""

    coordinate: str
    interval: tuple[float, float]
    unit: str
    # half-cycles it is about; ``both`` signs the residual with the direction of motion, so that friction too high in
    # push and pull alike shows as one number
    direction: Direction
    runs: tuple[int, ...]  # runs in which it is seen
    size_kN: float  # mean residual there
    share: float  # part of the residual's sum of squares that lies there
    p_value: float  # chance of such a mean if nothing were missing, times the number of regions that were looked at


@dataclass(frozen=True, kw_only=True)
class Period:
    """A length after which a misfit comes again."""

    length: float
    unit: str
    coordinate: str


@dataclass(frozen=True, kw_only=True)
class Unknown:
    """What no effect explains."""

    coordinate: str | None = None
    shape: tuple[Mapping[str, float | None], ...] = ()  # rows of a table over the coordinate, which comes first
    formula: str | None = None
    period: Period | None = None
    size_kN: float | None = None
    # in files of the first schema
    words: str | None = field(default=None, metadata=IF_KNOWN)
    formula_words: str | None = field(default=None, metadata=IF_KNOWN)


@dataclass(frozen=True, kw_only=True)
class FitQuality:
    """How well a model fits."""

    rmse_kN: float
    noise_kN: float
    heldout_rmse_kN: float
    energy_error_percent: float  # mean over cycles


@dataclass(frozen=True, kw_only=True)
class Dropped:
    """A class that was found, and left out again as it does not improve cycles that were left out."""

    class_: str
    elpd_gain: float | None = None
    without_kN: float | None = None
    with_kN: float | None = None


@dataclass(frozen=True, kw_only=True)
class HeldOutRecord:
    """Gain of the model that is shown on cycles that were left out."""

    scheme: str = "not stated"
    elpd_gain: float
    se: float
    rmse_se_kN: float | None = None
    n_blocks: int
    dropped: tuple[Dropped, ...] = ()


@dataclass(frozen=True)
class Alias:
    """Two effects that look alike under this displacement history; one alone when the base law takes it up."""

    pair: tuple[str, str]  # effect ids; the second is ``base law`` for an effect that the base parameters absorb
    # cosine between what the base law leaves of both; for ``base law`` the share that it takes
    correlation: Annotated[float, {"minimum": -1.0001, "maximum": 1.0001}]


@dataclass(frozen=True, kw_only=True)
class CandidateRecord:
    """An effect that was tried, and why it was kept or dropped."""

    id: str
    title: str = ""
    family: str = ""
    score: float | None
    elpd_gain: float | None
    probability: ProbabilityOrNone
    size_kN: float | None = None
    kept: bool = False
    reason: str


@dataclass(frozen=True, kw_only=True)
class EnergyRecord:
    """Energy of each cycle, J."""

    cycle: tuple[float, ...] = ()
    measured_J: tuple[float, ...] = ()
    before_J: tuple[float, ...] = ()
    after_J: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class ChannelRecord:
    """A further channel: the range of one that the force was held against, or why it was not."""

    name: str
    coordinate: str
    unit: str
    range: tuple[float, float] | None
    reference: float | None
    refused: Refusal | None
    share: Probability


@dataclass(frozen=True, kw_only=True)
class Sampled:
    """How the intervals were found."""

    how: str
    verdict: Trust


@dataclass(frozen=True, kw_only=True)
class DiagnosedModel:
    """The model that a diagnosis looks beyond."""

    variant: str
    priors: str
    noise: str
    given: tuple[str, ...] = ()  # effects that were known to be there
    without: tuple[str, ...] = ()  # effects that were not looked for


@dataclass(frozen=True, kw_only=True)
class Input:
    """A recording."""

    name: str
    sha256: str | None


@dataclass(frozen=True, kw_only=True)
class DiagnosisRecord(Stored, file="diagnosis.json", command="shj-bayes diagnose"):
    """Content of ``diagnosis.json``."""

    schema: Literal["shj-bayes/diagnosis/2", "shj-bayes/diagnosis/1"] = SCHEMA
    device: str = "Device"
    verdict: DiagnosisVerdict
    reason: str = ""
    p_value: Probability
    coordinates: tuple[DependenceRecord, ...] = ()  # most probable first
    sets: tuple[SetProbability, ...] = ()
    evidence: EvidenceRecord | None = None
    effects: tuple[EffectRecord, ...]
    modelled: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # parameters of effects in the model
    family: tuple[Member, ...]
    location: tuple[Location, ...]
    unknown: Unknown | None = None
    left_over_percent: float | None = None
    before: FitQuality
    after: FitQuality
    heldout: HeldOutRecord
    shift: Mapping[str, Shift]
    aliases: tuple[Alias, ...]
    candidates: tuple[CandidateRecord, ...]
    energy: EnergyRecord = EnergyRecord()
    fy_kN: float | None = None
    channels: tuple[ChannelRecord, ...] = ()
    next_test: str | None = None
    seed: int | None = None
    quick: bool = False
    sampling: Sampled | None = None
    model: DiagnosedModel | None = None
    inputs: tuple[Input, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    seconds: float | None = None
    simulated: bool = False
    key: str = ""  # of the fit that it looks beyond

    @property
    def sha256_of_inputs(self) -> tuple[str | None, ...]:
        """Digests of the recordings, by which what belongs together is known."""
        return tuple(entry.sha256 for entry in self.inputs)

    @property
    def nothing_missing(self) -> float:
        """Probability that nothing of a size that matters is missing, where the sets that hold 95 % count it in."""
        return sum(one.probability for one in self.sets if not one.classes)


@dataclass(frozen=True)
class LeftOver(Stored, file="residual.json", command="shj-bayes fit"):
    """Content of ``residual.json``: how much of the force the model leaves unexplained.

    A size, not a test. Whether the cycles scatter more than the model allows is judged by the fit, and whether physics
    is missing by the diagnosis; what they found is repeated here, so that no page says anything else.
    """

    schema: Literal["shj-bayes/residual/1", "shj-bayes/residual/2"] = field(
        default="shj-bayes/residual/2", kw_only=True
    )
    # root mean square of the residual beyond the scatter from one sample to the next, per cent of the sliding force
    unexplained_percent: Annotated[float, {"minimum": 0}]
    n_cycles: Annotated[int, {"minimum": 0}]  # full cycles of all runs
    # largest factor by which the fit widened an interval since the cycles scatter more than the model and its noise
    # allow; 1 where they do not
    widening: Annotated[float, {"minimum": 1}] = 1.0
    # verdict of the diagnosis of the same recordings; empty where there is none
    diagnosed: Annotated[str, {"enum": ("", *DiagnosisVerdict)}] = ""
    # of the model: ``good``, ``fair``, ``poor``, or ``undecided`` where there are too few cycles to say
    grade: Literal["", "good", "fair", "poor", "undecided"] = ""

    def __post_init__(self) -> None:
        """Grade the model."""
        fair = self.widening > 1.0 or self.unexplained_percent > FAIR_PERCENT
        poor = self.unexplained_percent > POOR_PERCENT
        grade = "undecided" if self.n_cycles < FEWEST_CYCLES else "poor" if poor else "fair" if fair else "good"
        object.__setattr__(self, "grade", grade)
