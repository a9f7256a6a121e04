"""How a device is read and fitted: what users choose, checked without what fitting needs."""

from dataclasses import dataclass

from shj_bayes.commands.earlier import earlier
from shj_bayes.errors import ModelError, shown
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.law import variant_named
from shj_bayes.model.noise.catalogue import DEFAULT, noise_model
from shj_bayes.model.priors import Priors, read_priors
from shj_bayes.recording.columns import check_rate, parse_columns
from shj_bayes.recording.runs import Runs, check_runs
from shj_bayes.recording.units import parse_units

SEEDS, STEPS = (0, 2**32 - 1), (1, 1_000_000)


@dataclass(frozen=True)
class Options:
    """How to read and fit a device; the same words as on the command line.

    Parameters
    ----------
    columns, units : str or None
        Columns and units, where the file does not say.
    rate_Hz : float or None
        Sampling rate of files without time, Hz.
    sheet : str or None
        Sheet of a workbook, or group of a file that has groups.
    priors : str
        Shipped family or TOML file.
    model : {"published", "continuous"}
        Reversal rule.
    noise : str
        Noise model, ``slow`` or another one of ``--noise``.
    effects : tuple of str
        Physical effects that are known to be there, by their ids.
    free : tuple of str
        Parameters that each run has for itself.
    seed : int
        Same seed, same numbers.
    max_steps : int
        Steps after which to stop.
    runs : int, "split", "one" or None
        Number of runs that the files hold; ``"split"`` parts files where runs are found, ``"one"`` never does.
    priors_from : str or None
        Folder of an earlier fit, or of a campaign with ``#SET`` behind it, whose posterior stands in for the priors
        of the law.
    """

    columns: str | None = None
    units: str | None = None
    rate_Hz: float | None = None
    sheet: str | None = None
    priors: str = "afc"
    model: str = "published"
    noise: str = DEFAULT
    effects: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    seed: int = 1
    max_steps: int = 10_000
    runs: Runs = None
    priors_from: str | None = None

    def __post_init__(self) -> None:
        """Refuse choices that no fit could take, before any device is read."""
        object.__setattr__(self, "model", variant_named(self.model))
        for number, found, (low, high) in (("seed", self.seed, SEEDS), ("max_steps", self.max_steps, STEPS)):
            if not low <= found <= high:
                raise ModelError(f"{number} = {shown(found, 20)}; allowed is {low} to {high}")
        asked = parse_columns(self.columns)
        parse_units(self.units)
        if self.rate_Hz is not None:
            check_rate(self.rate_Hz, asked)
        check_runs(self.runs)
        if "velocity" in self.effects:
            raise ModelError(
                "the base law depends on speed already; take 'velocity' out of the effects (or --without velocity)"
            )
        self.device_model(1, None)

    def device_model(self, n_runs: int, priors: Priors | None) -> DeviceModel:
        """Model of a device with so many runs; without priors those of the default family stand in."""
        return DeviceModel(
            n_runs,
            priors or read_priors(),
            effects=effects_named(self.effects),
            noise=noise_model(self.noise),
            free=self.free,
            variant=self.model,
        )

    def check(self, n_runs: int) -> None:
        """Refuse priors that cannot be read, or that lack a law that a device of so many runs needs."""
        assert self.device_model(n_runs, self.read_priors()).laws_of_parameters

    def read_priors(self) -> Priors:
        """Priors of the family, with what earlier tests say where they are named."""
        family = read_priors(self.priors)
        return family if self.priors_from is None else earlier(self.priors_from).on(family)
