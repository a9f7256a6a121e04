"""The commands of INTERFACE. No logic lives here: each command reads its options, calls one room and prints.

The rooms are imported inside the commands, so that ``shj-bayes --help`` answers at once.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

import shj_bayes
from shj_bayes.errors import CampaignError, ShjError

Command = Callable[..., Any]


class _Group(click.Group):
    """Turn every expected error into one line and exit 1; Ctrl-C says how to go on."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except ShjError as error:
            click.echo(f"shj-bayes: {error}", err=True)
        except OSError as error:
            where = f" ({Path(str(error.filename)).name})" if error.filename else ""
            reason = error.strerror or str(error)
            click.echo(f"shj-bayes: {reason}{where}; check the path, the rights and the free space", err=True)
        except KeyboardInterrupt:
            click.echo("shj-bayes: stopped; the same command again goes on from the last checkpoint", err=True)
        ctx.exit(1)


def _options(*decorators: Command) -> Callable[[Command], Command]:
    """Apply several option decorators as one."""

    def apply(function: Command) -> Command:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


def _out(default: str | None = None) -> Command:
    """Output folder; an option without default must not be given one, or click takes it for optional."""
    presence: dict[str, Any] = {"required": True} if default is None else {"default": default, "show_default": True}
    kind = click.Path(path_type=Path, file_okay=False)
    return click.option("-o", "--out", type=kind, help="Folder for the results.", **presence)


SEED = click.option(
    "--seed",
    type=click.IntRange(0, 2**32 - 1),
    default=1,
    show_default=True,
    help="Same seed and inputs, same numbers.",
)
WORKERS = click.option(
    "--workers", type=click.IntRange(1, 256), help="Processors to use; the numbers do not depend on it."
)
OUTPUT = _options(
    click.option("--json", "as_json", is_flag=True, help="Machine-readable result on standard output, nothing else."),
    click.option("--quiet", is_flag=True, help="Print nothing but errors."),
)
READING = _options(
    click.option("--columns", metavar="ROLE=COLUMN,...", help="time=, displacement=, force=: name, number or formula."),
    click.option("--units", metavar="mm,kN,s", help="Units, where the header does not say."),
    click.option("--rate", "rate_Hz", type=float, metavar="HZ", help="Sampling rate of files without time, Hz."),
)
RECORDINGS = click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="REC...")
MODEL = click.option(
    "--model",
    type=click.Choice(["seed", "continuous"]),
    default="seed",
    show_default=True,
    help="Eq. 1 as published, or without its jump at reversals.",
)
MODELLING = _options(
    click.option("--priors", default="afc", show_default=True, help="Family that ships (afc, general) or TOML file."),
    MODEL,
    click.option(
        "--noise",
        type=click.Choice(["ar1", "independent", "student"]),
        default="ar1",
        show_default=True,
        help="Noise model.",
    ),
    click.option("--free", default="", metavar="K,beta,gamma", help="Parameters that each run has for itself."),
    click.option(
        "--max-steps",
        type=click.IntRange(200, 1_000_000),
        default=10_000,
        show_default=True,
        help="Steps after which sampling stops even if it has not converged.",
    ),
)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(shj_bayes.__version__, prog_name="shj-bayes")
def main() -> None:
    """Posteriors and design margins for sliding steel friction connections."""


@main.command()
@_out("shj-bayes-demo")
@SEED
@WORKERS
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def demo(out: Path, seed: int, workers: int | None, quiet: bool) -> None:
    """Run the whole job on (simulated) data that ship with the project."""
    from shj_bayes.resources import shipped

    manifest = shipped("data", "examples", "campaign.toml")
    _run_campaign(manifest, out, seed=seed, workers=workers, quiet=quiet, as_json=False)


@main.command()
@RECORDINGS
@READING
@OUTPUT
def check(recordings: tuple[Path, ...], as_json: bool, quiet: bool, **reading: Any) -> None:
    """Read and check recordings; say what was found, assumed and repaired.

    Exit status 1 when one of them cannot be used.
    """
    from shj_bayes.pipeline import check_recording

    results = [check_recording(path, **reading) for path in recordings]
    if as_json:
        click.echo(json.dumps([facts for facts, _ in results], indent=1, allow_nan=False))
    elif not quiet:
        click.echo("\n\n".join(text for _, text in results))
    if not all(facts["usable"] for facts, _ in results):
        raise SystemExit(1)


@main.command()
@RECORDINGS
@_out()
@READING
@MODELLING
@SEED
@click.option("--name", help="Name of the device; by default that of the first file.")
@WORKERS
@OUTPUT
def fit(
    recordings: tuple[Path, ...],
    out: Path,
    name: str | None,
    workers: int | None,
    as_json: bool,
    quiet: bool,
    free: str,
    **options: Any,
) -> None:
    """Posterior of one device; several recordings are its consecutive runs.

    \b
    shj-bayes fit run1.csv run2.csv -o results
    shj-bayes fit test.txt -o results --columns time=1,displacement=5,force=7 --units ms,mm,N
    """  # noqa: D301  \b is click's mark for lines that stay as they are
    from shj_bayes.pipeline import Options, fit_device

    shared = Options(free=tuple(part.strip() for part in free.split(",") if part.strip()), **options)
    speak = not (as_json or quiet)
    result = fit_device(recordings, out, shared, name=name, progress=speak, threads=workers or 0)
    if as_json:
        click.echo(json.dumps(result.record, indent=1))
    elif speak:
        click.echo(result.text)
    if result.record["verdict"] == "unusable":
        raise ShjError(f"{result.record['device']}: the posterior is unusable: {result.record['reasons'][0]}")


@main.command()
@RECORDINGS
@_out()
@READING
@click.option("--priors", default="afc", show_default=True, help="Family that ships (afc, general) or TOML file.")
@MODEL
@click.option("--without", multiple=True, metavar="EFFECT", help="velocity: base law without it; others: not tried.")
@click.option("--quick", is_flag=True, help="A first look: approximate intervals, no sampling.")
@SEED
@click.option("--name", help="Name of the device; by default that of the first file.")
@WORKERS
@OUTPUT
def diagnose(
    recordings: tuple[Path, ...],
    out: Path,
    without: tuple[str, ...],
    quick: bool,
    name: str | None,
    workers: int | None,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Fit, then locate, name, model and show what the base law leaves out."""
    from shj_bayes.pipeline import Options, diagnose_device

    speak = not (as_json or quiet)
    result = diagnose_device(
        recordings,
        out,
        Options(**options),
        without=without,
        name=name,
        quick=quick,
        progress=speak,
        threads=workers or 0,
        tell=(lambda line: click.echo(f"  {line}", err=True)) if speak else (lambda _: None),
    )
    if as_json:
        click.echo(json.dumps(result.record, indent=1))
    elif speak:
        click.echo(result.text)


@main.command()
@click.argument("manifest", type=click.Path(path_type=Path))
@_out()
@SEED
@WORKERS
@OUTPUT
def campaign(manifest: Path, out: Path, seed: int, workers: int | None, as_json: bool, quiet: bool) -> None:
    """Fit every device of a TOML manifest, then population, comparison and report; resumes where it stopped."""
    _run_campaign(manifest, out, seed=seed, workers=workers, quiet=quiet, as_json=as_json)


def _run_campaign(manifest: Path, out: Path, *, seed: int, workers: int | None, quiet: bool, as_json: bool) -> None:
    from shj_bayes.campaign import read_manifest, run_campaign
    from shj_bayes.summary import summarise_campaign

    speak = not (quiet or as_json)
    plan = read_manifest(manifest)
    outcomes = run_campaign(plan, out, workers=workers or 0, progress=speak)
    result = summarise_campaign(plan, outcomes, out, seed=seed, progress=speak)
    if as_json:
        click.echo(json.dumps(result.record, indent=1))
    elif speak:
        click.echo(result.text)
    if not result.usable:
        raise CampaignError("no device could be used; the reasons stand above and in campaign.json")


@main.command()
@_out("shj-bayes-tables")
@SEED
@OUTPUT
def tables(out: Path, seed: int, as_json: bool, quiet: bool) -> None:
    """Bands and comparisons from the published, rounded parameter tables alone."""
    from shj_bayes.summary import summarise_tables

    result = summarise_tables(out, seed=seed, progress=not (quiet or as_json))
    if as_json:
        click.echo(json.dumps(result.record, indent=1))
    elif not quiet:
        click.echo(result.text)


@main.command()
@click.argument("folder", type=click.Path(path_type=Path), metavar="DIR")
@click.argument("set_a", metavar="A")
@click.argument("set_b", metavar="B")
@OUTPUT
def compare(folder: Path, set_a: str, set_b: str, as_json: bool, quiet: bool) -> None:
    """Compare two sets of a campaign or of the tables in DIR."""
    from shj_bayes.summary import compare_sets

    record, text = compare_sets(folder, set_a, set_b)
    if as_json:
        click.echo(json.dumps(record, indent=1))
    elif not quiet:
        click.echo(text)


@main.command()
@click.option("-o", "--out", "stem", type=click.Path(path_type=Path), required=True, help="Stem of the files.")
@click.option("--K", "K", type=float, default=18.0, show_default=True, help="Stiffness, kN/mm.")
@click.option("--Fy", "Fy", type=float, default=80.0, show_default=True, help="Sliding force of the first run, kN.")
@click.option("--beta", type=float, default=10.0, show_default=True, help="Sharpness, 1 to 500.")
@click.option("--dep", type=float, help="Speed dependence 1/gamma, mm/s; none by default.")
@click.option("--ratio", type=float, default=0.875, show_default=True, help="Fy of the second run / first.")
@click.option("--sigma", type=float, default=1.0, show_default=True, help="Force noise scale, kN.")
@click.option("--phi", type=float, default=0.8, show_default=True, help="Lag-one correlation of the force noise.")
@click.option("--displacement-noise", type=float, default=0.02, show_default=True, help="Displacement noise, mm.")
@click.option("--rate", "rate_Hz", type=float, default=20.0, show_default=True, help="Sampling rate, Hz.")
@click.option("--last-cycles", type=int, default=5, show_default=True, help="Cycles in the last block of Table 1.")
@MODEL
@SEED
@click.option("--quiet", is_flag=True, help="Print nothing but errors.")
def simulate(stem: Path, dep: float | None, quiet: bool, **options: Any) -> None:
    """Make recordings of two runs of Table 1 from stated parameters, with the truth beside them."""
    from shj_bayes.simulated import write_simulated

    for path in write_simulated(stem, dep_mm_s=dep, **options):
        if not quiet:
            click.echo(path)


@main.command()
@click.option("--json", "as_json", is_flag=True, help="Machine-readable result on standard output, nothing else.")
def doctor(as_json: bool) -> None:
    """Say what is installed, whether it works, how fast this machine is."""
    from shj_bayes.doctor import examine

    record, text = examine()
    click.echo(json.dumps(record, indent=1) if as_json else text)
    if not record["works"]:
        raise ShjError("something does not work; the lines above say what")
