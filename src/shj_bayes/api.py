"""The commands as functions, for scripts and notebooks: the same files, the same numbers.

Every function writes a folder as the command of its name does, and gives it back as a value. Without a folder it works
in a temporary one that lives as long as the value.
"""

import shutil
import weakref
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from html import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, ClassVar, Self

import pandas as pd

from shj_bayes.app.campaign import run_campaign, summarise_campaign, summarise_tables
from shj_bayes.app.design import compare_sets
from shj_bayes.app.device import Work, diagnose_device, fit_device, step_told
from shj_bayes.app.manifest import Manifest, read_manifest
from shj_bayes.app.plan import plan_next
from shj_bayes.errors import OptionError, ReportError, did_you_mean
from shj_bayes.options import DiagnoseOptions, FitOptions, PlanOptions
from shj_bayes.planning.plan import PlanRecord
from shj_bayes.population.results import PopulationRecord
from shj_bayes.recording.reader import read_frame
from shj_bayes.recording.recording import Recording
from shj_bayes.report.browse import open_page, page_of
from shj_bayes.report.diagnosis_words import sentences
from shj_bayes.results.campaign import CampaignRecord, read_campaign
from shj_bayes.results.codec import from_json, to_json
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import has, read, read_whole
from shj_validation.paper_claims import paper_claims


class _Held:
    """A temporary folder that is removed with the last result that holds it.

    ``tempfile.TemporaryDirectory`` does the same and warns that nobody closed it, which here is as it should be.
    """

    def __init__(self) -> None:
        self.folder = Path(mkdtemp(prefix="shj-bayes-"))
        weakref.finalize(self, shutil.rmtree, self.folder, ignore_errors=True)


OneRecording = str | Path | Recording | pd.DataFrame
Recordings = OneRecording | Sequence[OneRecording]


@dataclass(frozen=True, eq=False)
class _Result:
    """A folder of results."""

    _which: ClassVar[str | None] = None  # its page in a folder that holds several
    folder: Path  # where its files are
    record: dict[str, Any] = field(repr=False)  # what the command of the same name prints with ``--json``
    _held: _Held | None = field(default=None, repr=False)

    @property
    def page(self) -> Path:
        """The page of this result, one HTML file."""
        return page_of(self.folder, self._which)

    def open(self) -> bool:
        """Open the page in the browser; False when there is none."""
        return open_page(self.page)


class FitResult(_Result):
    """The posterior of one device; made by `fit` or `load`."""

    @property
    def verdict(self) -> str:
        """``reliable``, ``tentative`` or ``unusable``."""
        return str(self.record["verdict"])

    @property
    def summary(self) -> pd.DataFrame:
        """Parameter table: one row each, indexed by name, with unit, mean, sd, quantiles and convergence."""
        return pd.DataFrame(self.record["parameters"]).set_index("name")

    @cached_property
    def data(self) -> Any:
        """Posterior, priors and predictions as the installed ArviZ reads them; the guide to results says what is in it.

        An ``arviz.InferenceData`` up to ArviZ 0.23, an ``xarray.DataTree`` from version 1 on.
        """
        return read_whole(self.folder)

    @property
    def draws(self) -> pd.DataFrame:
        """Posterior draws, shape (n_draws, n_parameters), one column for each parameter; ready for corner."""
        names = list(self.summary.index)
        posterior: Any = self.data
        return pd.DataFrame({name: posterior.posterior[name].to_numpy().ravel() for name in names})

    def _repr_html_(self) -> str:
        reasons = "; ".join(self.record["reasons"])
        columns = ["unit", "mean", "sd", "q05", "q95"]
        table = self.summary[columns].to_html(float_format="{:.5g}".format)
        return f"<p><b>{escape(str(self.record['device']))}: {escape(self.verdict)}</b> ({escape(reasons)})</p>{table}"


class Diagnosis(_Result):
    """What the law leaves out of one device; made by `diagnose` or `load`."""

    _which = "diagnosis"

    @property
    def verdict(self) -> str:
        """``adequate``, ``named``, ``family`` or ``unknown``."""
        return str(self.record["verdict"])

    @property
    def fit(self) -> FitResult:
        """Posterior of the device as it was found to be; `InferenceError` after a first look, which has none."""
        return FitResult(self.folder, to_json(read(FitRecord, self.folder)), self._held)

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects that were named."""
        return tuple(str(effect["id"]) for effect in self.record["effects"])

    @property
    def candidates(self) -> pd.DataFrame:
        """Every effect tried, indexed by id: its gain on held-out cycles, and why it was kept or dropped."""
        return pd.DataFrame(self.record["candidates"]).set_index("id")

    @property
    def shift(self) -> pd.DataFrame:
        """Mean and spread of every base parameter before and after, indexed by name."""
        rows = {
            name: {f"{key}_{when}": row[when][key] for when in ("before", "after") for key in ("mean", "sd")}
            for name, row in self.record["shift"].items()
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def _repr_html_(self) -> str:
        words = " ".join(sentences(from_json(DiagnosisRecord, self.record)))
        table = self.shift.to_html(float_format="{:.5g}".format)
        return f"<p><b>{escape(str(self.record['device']))}: {escape(self.verdict)}</b>. {escape(words)}</p>{table}"


class NextTest(_Result):
    """Which test is next; made by `plan` or `load`."""

    _which = "plan"

    @property
    def compared(self) -> pd.DataFrame:
        """Protocols with what each is expected to give: the best first, then Table 1 and the files given."""
        rows = [*self.record["candidates"], *self.record["compared"]]
        return pd.DataFrame([{k: v for k, v in row.items() if k not in ("blocks", "simulated")} for row in rows])

    @property
    def history(self) -> pd.DataFrame:
        """Displacement of the best protocol at the rig's rate: columns ``time_s`` and ``displacement_mm``."""
        return pd.read_csv(self.folder / Path(str(self.record["candidates"][0]["file"])).name)


class CampaignResult(_Result):
    """Many devices and what they say about a new one; made by `Campaign.run`, `tables` or `load`."""

    @cached_property
    def bands(self) -> pd.DataFrame:
        """Bands of a new device: one row for each set and quantity, the content of ``population.csv``."""
        return pd.read_csv(self.folder / "population.csv")

    @property
    def devices(self) -> dict[tuple[str, str], FitResult]:
        """Fits by (set, device); devices that failed are not among them."""
        found = {}
        for group in self.record.get("sets", ()):
            for device in group["devices"]:
                place = self.folder / str(device["folder"])
                if device["status"] != "failed" and has(FitRecord, place):
                    record = to_json(read(FitRecord, place))
                    found[str(group["name"]), str(device["name"])] = FitResult(place, record, self._held)
        return found

    def compare(self, set_a: str, set_b: str) -> pd.DataFrame:
        """Compare two sets: a row for each quantity, with a sentence; `PopulationError` where there is no such set."""
        return pd.DataFrame(compare_sets(self.folder, set_a, set_b)[0]["contrasts"])

    def _repr_html_(self) -> str:
        columns = ["set", "n_devices", "quantity", "unit", "q05", "q50", "q95"]
        table = self.bands[columns].to_html(index=False, float_format="{:.4g}".format)
        return f"<p><b>A new device of each set</b>: 5, 50 and 95 %</p>{table}"


class Campaign(Manifest):
    """A campaign as its manifest describes it: its name, its devices, and whether they are simulated."""

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a manifest; `CampaignError` with the table and the value at fault."""
        return cls(*read_manifest(Path(path)))

    def run(
        self,
        out: str | Path | None = None,
        *,
        seed: int = 1,
        workers: int = 0,
        diagnose: str | None = None,
        progress: bool = False,
    ) -> CampaignResult:
        """Fit and diagnose what is missing or changed, then pool, compare and write the page.

        Parameters
        ----------
        out : str or Path, optional
            Folder for the results.
        seed : int
            Seed of the population; devices have theirs in the manifest.
        workers : int
            Devices at the same time, 0 for one per processor. Where processes are spawned (Windows, macOS), a script
            needs ``if __name__ == "__main__":`` around this call.
        diagnose : {"quick", "full", "off"}, optional
            How to look for what the law leaves out, in place of what the manifest says.
        progress : bool
            Show a progress bar.
        """
        folder, held = _place(out)
        outcomes = run_campaign(self, folder, workers=workers, diagnose=diagnose, progress=progress)
        result = summarise_campaign(outcomes, folder, seed=seed, progress=progress)
        return CampaignResult(folder, result.record, held)


def fit(recordings: Recordings, out: str | Path | None = None, *, name: str | None = None, **options: Any) -> FitResult:
    """Sample the posterior of one device; `ShjError` if a recording cannot be used or an option is not known.

    Parameters
    ----------
    recordings : path, Recording or DataFrame, or a sequence of them
        Consecutive runs of one device, in the order they were made; a data frame has one row for each sample.
    out : str or Path, optional
        Folder for the results; an unchanged finished fit there is kept, an unfinished one gone on with.
    name : str, optional
        Name of the device; that of the first file by default.
    **options
        Fields of `shj_bayes.options.FitOptions`, and of `shj_bayes.app.device.Work` (progress, threads, force).
    """
    folder, held = _place(out)
    shared, work = _sorted(options, FitOptions, Work)
    if work.progress:
        work = replace(work, tell=step_told)
    result = fit_device(_listed(recordings, shared), folder, shared, name=name, work=work)
    return FitResult(folder, to_json(result.record), held)


def diagnose(
    recordings: Recordings, out: str | Path | None = None, *, name: str | None = None, **options: Any
) -> Diagnosis:
    """Find what the law leaves out of one device.

    Arguments and errors are those of `fit`; further options are the fields of `shj_bayes.options.DiagnoseOptions`
    (without, quick).
    """
    folder, held = _place(out)
    shared, work, look = _sorted(options, FitOptions, Work, DiagnoseOptions)
    result = diagnose_device(_listed(recordings, shared), folder, shared, look, name=name, work=work)
    return Diagnosis(folder, to_json(result.record), held)


def plan(
    devices: str | Path | Sequence[str | Path] = (),
    out: str | Path | None = None,
    *,
    rig: str | Path | None = None,
    **options: Any,
) -> NextTest:
    """Plan the next test; `ShjError` if a folder, a limit or a question cannot be used.

    Parameters
    ----------
    devices : path, or a sequence of them
        Folders that `diagnose` or `fit` wrote; none for a plan from priors alone.
    out : str or Path, optional
        Folder for the plan.
    rig : str or Path, optional
        ``rig.toml``.
    **options
        Fields of `shj_bayes.options.PlanOptions`.
    """
    (asked,) = _sorted(options, PlanOptions)
    folder, held = _place(out)
    folders = [Path(devices)] if isinstance(devices, str | Path) else [Path(one) for one in devices]
    planned = plan_next(folders, folder, asked, rig=None if rig is None else Path(rig))
    return NextTest(folder, to_json(planned.record), held)


def tables(out: str | Path | None = None, *, seed: int = 1, progress: bool = False) -> CampaignResult:
    """Pool the published, rounded parameter tables alone; parameters as for `Campaign.run`."""
    folder, held = _place(out)
    result = summarise_tables(folder, paper_claims(), seed=seed, progress=progress)
    return CampaignResult(folder, result.record, held)


def load(folder: str | Path) -> FitResult | Diagnosis | CampaignResult | NextTest:
    """Read a finished result from what was given to ``-o`` or ``out``; of a fit and a diagnosis in one, the fit.

    `ReportError` if it holds no result, or one that is damaged.
    """
    place = Path(folder)
    for kind, result in (
        (FitRecord, FitResult),
        (DiagnosisRecord, Diagnosis),
        (CampaignRecord, CampaignResult),
        (PopulationRecord, CampaignResult),
        (PlanRecord, NextTest),
    ):
        if has(kind, place):
            return result(place, to_json(read_campaign(place) if kind is CampaignRecord else read(kind, place)))
    raise ReportError(f"{place} holds no finished result; name the folder that was given to -o")


def _listed(recordings: Recordings, options: FitOptions) -> list[Path | Recording]:
    """One recording or several, as a list; data frames are read with the options on columns and units."""
    out: list[Path | Recording] = []
    for item in [recordings] if isinstance(recordings, str | Path | Recording | pd.DataFrame) else recordings:
        if isinstance(item, pd.DataFrame):
            name, how = f"data frame {len(out) + 1}", {"columns": options.columns, "units": options.units}
            out.append(read_frame(item, name, rate_Hz=options.rate_Hz, **how))
        else:
            out.append(Path(item) if isinstance(item, str) else item)
    return out


def _sorted(given: dict[str, Any], *kinds: Any) -> Any:
    """One value of each kind from options by name; one that there is not is told with the nearest that there is."""
    names = [[field.name for field in fields(kind) if field.name != "tell"] for kind in kinds]
    known = [name for own in names for name in own]
    for name in given:
        if name not in known:
            raise OptionError(f"'{name}' is not an option; known are {', '.join(known)}{did_you_mean(name, known)}")
    return [kind(**{n: given[n] for n in own if n in given}) for kind, own in zip(kinds, names, strict=True)]


def _place(out: str | Path | None) -> tuple[Path, _Held | None]:
    """Folder of a result, and the temporary one that must be held on to."""
    if out is not None:
        return Path(out), None
    held = _Held()
    return held.folder, held
