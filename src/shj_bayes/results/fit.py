"""``fit.json``, ``summary.json`` and ``residual.json``: what a fit says of a device, its recordings and its model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Literal

from shj_bayes.errors import InferenceError
from shj_bayes.recording.recording import Finding
from shj_bayes.results.codec import Stored

SCHEMA: Literal["shj-bayes/fit/2"] = "shj-bayes/fit/2"
Sha256 = Annotated[str | None, {"pattern": "^([0-9a-f]{64})?$"}]


class Trust(StrEnum):
    """How far the draws of a fit may be trusted."""

    RELIABLE = "reliable"
    TENTATIVE = "tentative"
    UNUSABLE = "unusable"


USABLE = frozenset(Trust) - {Trust.UNUSABLE}


class Remark(StrEnum):
    """What the data do not say of a parameter."""

    UNDETERMINED = "undetermined"
    AGAINST_PRIOR = "against-prior"
    AGAINST_EARLIER = "against-earlier"


@dataclass(frozen=True, kw_only=True)
class ParameterRow:
    """A parameter in the table of a fit."""

    name: str
    unit: Annotated[str, {"description": "1 for numbers without unit"}]
    mean: float
    sd: float
    q05: float
    q50: float
    q95: float
    ess_bulk: float | None
    ess_tail: float | None
    rhat: float | None


@dataclass(frozen=True, kw_only=True)
class PriorRecord:
    """Prior law of a parameter; `Prior` is its mathematics, and needs scipy."""

    name: str
    unit: str
    law: str
    a: float
    b: float
    source: str


@dataclass(frozen=True, kw_only=True)
class ModelRecord:
    """The model that was fitted."""

    variant: str  # of the law
    effects: tuple[str, ...] = ()
    speed: bool = True  # whether the law depends on it
    noise: str
    free_between_runs: tuple[str, ...]
    priors: str  # their family
    priors_statement: str = ""
    priors_sha256: Sha256


@dataclass(frozen=True, kw_only=True)
class ChannelScale:
    """The scale on which curves over a further channel are stated: its range, and where they are 0."""

    unit: str
    low: float
    high: float
    reference: float


@dataclass(frozen=True, kw_only=True)
class ZeroError:
    """What the load cell reads at no load, kN."""

    mean: float
    sd: float


@dataclass(frozen=True, kw_only=True)
class RunInput:
    """A recording, and how it was read."""

    name: str
    sha256: Sha256
    format: str
    columns: Mapping[str, str]
    units: Mapping[str, str]
    extras: Mapping[str, str] = field(default_factory=dict)  # further channels: name and unit
    n_samples: int
    rate_Hz: float
    duration_s: float
    n_half_cycles: int
    start_force_kN: float = 0.0
    motion_method: str
    displacement_noise_mm: float
    zero_error_kN: Annotated[
        ZeroError | None,
        {"description": "error of the load cell's zero at the posterior means of the parameters"},
    ] = None
    findings: tuple[Finding, ...]

    @property
    def simulated(self) -> bool:
        """Whether the recording says that it is simulated."""
        return self.format == "simulated" or any(finding.code == "simulated" for finding in self.findings)


@dataclass(frozen=True, kw_only=True)
class SamplingRecord:
    """How the posterior was sampled."""

    n_ensembles: int
    n_walkers: int
    n_steps_kept: int
    n_steps_dropped: int
    tau_steps: Mapping[str, float | None]  # autocorrelation time by parameter
    acceptance: tuple[float, ...]  # of each ensemble
    n_failed_evaluations: int
    pareto_k: Annotated[
        float | None,
        {"description": "of the weights that take the draws from averages to all samples; null if infinite"},
    ] = None


@dataclass(frozen=True, kw_only=True)
class CyclesRecord:
    """How the intervals compare with the scatter from cycle to cycle, by parameter."""

    n_pieces: int = 0
    scatter_over_posterior: Mapping[str, float] = field(default_factory=dict)
    widening: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """Averages of a run's samples."""

    n_blocks: int
    n_samples: int


@dataclass(frozen=True, kw_only=True)
class RemarkRecord:
    """A parameter of which the data do not say what a reader may expect."""

    parameter: str
    kind: Remark
    q50: float
    prior_q05: float
    prior_q95: float


@dataclass(frozen=True, kw_only=True)
class FitRecord(Stored, file="fit.json", command="shj-bayes fit", error=InferenceError):
    """Content of ``fit.json``."""

    schema: Literal["shj-bayes/fit/1", "shj-bayes/fit/2"] = SCHEMA
    device: str
    seed: int
    key: Annotated[str, {"description": "digest of all that the result depends on"}]
    verdict: Trust
    reasons: Annotated[tuple[str, ...], {"minItems": 1}]
    created: str
    versions: Mapping[str, str]
    model: ModelRecord
    channels: Mapping[str, ChannelScale] = field(default_factory=dict)
    prior_laws: tuple[PriorRecord, ...]
    inputs: Annotated[tuple[RunInput, ...], {"minItems": 1}]
    sampling: SamplingRecord
    cycles: CyclesRecord = CyclesRecord()
    noise_at_rest: Annotated[
        float | None,
        {"description": "standard deviation of the white noise at rest over that at speed, as taken for the posterior"},
    ] = None
    reduction: tuple[Reduction, ...] = ()
    parameters: Annotated[tuple[ParameterRow, ...], {"minItems": 1}]
    convergence: Trust | None = None  # verdict on the chains alone
    remarks: tuple[RemarkRecord, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)  # SHA-256 of the other files of the fit
    digest: str = ""

    @property
    def undetermined(self) -> frozenset[str]:
        """Parameters that the recordings do not determine."""
        return frozenset(remark.parameter for remark in self.remarks if remark.kind == Remark.UNDETERMINED)

    @property
    def sha256_of_inputs(self) -> tuple[str | None, ...]:
        """Digests of the recordings, by which what belongs together is known."""
        return tuple(entry.sha256 for entry in self.inputs)

    def parameter(self, name: str) -> ParameterRow | None:
        """Row of the parameter table; None where the model has no such parameter."""
        return next((row for row in self.parameters if row.name == name), None)


@dataclass(frozen=True, kw_only=True)
class SummaryRecord(Stored, file="summary.json", command="shj-bayes fit"):
    """Content of ``summary.json``: the parameter table alone."""

    schema: Literal["shj-bayes/fit/1", "shj-bayes/fit/2"] = SCHEMA
    parameters: Annotated[tuple[ParameterRow, ...], {"minItems": 1}]
