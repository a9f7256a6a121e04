"""Yesterday's posterior as today's prior: of the same device, or of the set that a new one belongs to.

The noise keeps the priors of its family: it belongs to the laboratory, not to the device. So does beta, whose law has
ends: an earlier interval as a law with ends would forbid what lies beyond it.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from shj_bayes._util.did_you_mean import did_you_mean
from shj_bayes._util.files import damage_told, file_digest
from shj_bayes.errors import PriorError
from shj_bayes.model.priors import Prior, Priors
from shj_bayes.population.hierarchy import ANY_SET
from shj_bayes.population.quantities import band_of
from shj_bayes.recording.recording import Finding, Recording
from shj_bayes.results.campaign import CampaignRecord, read_campaign
from shj_bayes.results.device import read_group
from shj_bayes.results.fit import FitRecord, Trust
from shj_bayes.results.store import has, read

LAW = ("K", "Fy", "gamma", "ratio")
NINETY = 3.289707  # standard deviations from 5 to 95 % of a normal law
LEAST_SPREAD = 0.01  # of a factor: no two tests of one device agree better


@dataclass(frozen=True)
class Earlier:
    """What is known from earlier tests."""

    statement: str  # of which device or set
    bands: Mapping[str, Sequence[float]]  # 5, 50 and 95 % by parameter of the law
    sha256: str  # digest of the files it comes from
    recordings: frozenset[str]  # digests of the recordings that it rests on

    def __post_init__(self) -> None:
        """Refuse bands that are none."""
        for name, band in self.bands.items():
            low, middle, high = band
            if not (-math.inf < low < middle < high < math.inf and (low > 0 or name == "gamma")):
                shown = ", ".join(f"{value:g}" for value in band)
                raise PriorError(
                    f"{name} of {self.statement} has 5, 50 and 95 % at {shown}; they must be finite, grow and, but "
                    "for gamma, be above zero; run the command again that made it"
                )

    def on(self, family: Priors) -> Priors:
        """Priors of a family with the laws of these parameters in place of its own."""
        laws = {name: replace(family.of(name), name=name) for name in self.bands}
        own = {name: _law(laws[name], band, self.statement) for name, band in self.bands.items()}
        digest = hashlib.sha256(f"{family.sha256} {self.sha256}".encode()).hexdigest()
        return replace(
            family,
            family=f"{family.family}, and the posterior of {self.statement}",
            statement=f"{family.statement} Taken from earlier tests: {', '.join(own)}, of {self.statement}.",
            sha256=digest,
            earlier=own,
        )

    def remarked(self, recordings: Sequence[Recording]) -> list[Recording]:
        """Warn of recordings that the prior rests on already: their evidence would count twice."""
        out = []
        for recording in recordings:
            if recording.source.sha256 and recording.source.sha256 in self.recordings:
                message = (
                    f"{recording.source.name} is in the posterior of {self.statement}, which is the prior here: what "
                    "it says counts twice, and the intervals are too narrow; give recordings that are new"
                )
                recording = recording.with_findings(Finding("recording-in-prior", "warning", message))  # noqa: PLW2901
            out.append(recording)
        return out


def earlier(where: str) -> Earlier:
    """Read what earlier tests say, from the folder of a fit, or of a campaign with ``#SET`` behind it.

    `PriorError` if there is neither, or no such set; `InferenceError` if the fit is damaged.
    """
    name, _, chosen = where.partition("#")
    folder = Path(name)
    if has(FitRecord, folder):
        if chosen:
            raise PriorError(
                f"--priors-from {where}: {name} is the fit of one device and has no sets; leave #{chosen} out"
            )
        return _of_device(folder)
    if (folder / "population.json").is_file():
        return _of_set(folder, chosen)
    raise PriorError(f"--priors-from {name}: there is no fit and no campaign in it; name the folder given to -o")


def _of_device(folder: Path) -> Earlier:
    record, draws = read(FitRecord, folder), read_group(folder, "posterior")
    if record.verdict == Trust.UNUSABLE:
        raise PriorError(f"--priors-from {folder.name}: its posterior is unusable; run that fit again first")
    names = [name for name in draws if name in LAW or name.startswith("ratio_")]
    bands = {name: band_of(draws[name]) for name in names}
    inputs = frozenset(map(str, record.sha256_of_inputs))
    return Earlier(f"device {record.device}", bands, record.digest, inputs)


def _of_set(folder: Path, chosen: str) -> Earlier:
    from shj_bayes.population.results import PopulationRecord  # noqa: PLC0415  (needs half of scipy)

    record = read(PopulationRecord, folder)
    with damage_told(f"population.json in {folder.name}", PriorError):
        sets = {one.name: one for one in record.sets if one.name != ANY_SET}
        names = list(sets)
        if not chosen and len(names) == 1:
            chosen = names[0]
        alike = [name for name in names if name.casefold() == chosen.casefold()]
        if chosen not in sets and len(alike) != 1:
            said = f"has no set '{chosen}'" if chosen else "holds several sets"
            hint = did_you_mean(chosen, names) if chosen else f"; write {folder}#SET"
            raise PriorError(f"--priors-from: {folder.name} {said}; there are {', '.join(names)}{hint}")
        name = chosen if chosen in sets else alike[0]
        bands = sets[name].new_device
        known = {q: tuple(float(bands[q][key]) for key in ("q05", "q50", "q95")) for q in LAW if q in bands}
        digest = file_digest(folder / PopulationRecord.FILE)
        return Earlier(f"a new device of set {name}", known, digest, _recordings(folder, name))


def _recordings(folder: Path, name: str) -> frozenset[str]:
    """Digests of the recordings of a set; none where the population rests on published tables."""
    if not has(CampaignRecord, folder):
        return frozenset()
    fits = [folder / device.folder for set_name, device in read_campaign(folder).devices if set_name == name]
    records = [read(FitRecord, fit) for fit in fits if has(FitRecord, fit)]
    return frozenset(str(sha256) for one in records for sha256 in one.sha256_of_inputs)


def _law(own: Prior, band: Sequence[float], statement: str) -> Prior:
    """Law of a parameter with the 5, 50 and 95 % of an earlier result."""
    low, middle, high = band
    own = replace(own, source=f"Posterior of {statement}.", earlier=True)
    if own.name == "gamma":
        return replace(own, law="normal", a=middle, b=max((high - low) / NINETY, 1e-6))
    spread = max(math.log(high / low) / NINETY, LEAST_SPREAD)
    return replace(own, law="lognormal", a=middle, b=spread)
