"""The commands of INTERFACE. No logic lives here: each command reads its options, calls one room and prints.

The rooms are imported inside the commands, so that ``shj-bayes --help`` answers at once.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

import shj_bayes
from shj_bayes.errors import ShjError

Command = Callable[..., Any]


class _Group(click.Group):
    """Turn every expected error into one line and exit 1; Ctrl-C says how to go on and exits 130."""

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except ShjError as error:
            click.echo(f"shj-bayes: {error}", err=True)
            ctx.exit(1)
        except OSError as error:
            where = f" ({Path(str(error.filename)).name})" if error.filename else ""
            click.echo(f"shj-bayes: {error.strerror or error}{where}; check the path, the rights and the free space", err=True)
            ctx.exit(1)


def _options(*decorators: Command) -> Callable[[Command], Command]:
    def apply(function: Command) -> Command:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


OUT = click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder for the results.")
SEED = click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=1, show_default=True, help="Same seed and inputs, same numbers.")
QUIET = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
JSON = click.option("--json", "as_json", is_flag=True, help="Machine-readable result on standard output, nothing else.")
READING = _options(
    click.option("--columns", metavar="time=..,displacement=..,force=..", help="Column names, numbers (from 1) or formulas such as '#7-49.087*#6'."),
    click.option("--units", metavar="mm,kN,s", help="Units, where the header does not say."),
    click.option("--rate", type=float, metavar="HZ", help="Constant sampling rate of files without a time column, Hz."),
)
RECORDINGS = click.argument("recordings", nargs=-1, required=True, type=click.Path(path_type=Path), metavar="REC...")
MODELLING = _options(
    click.option("--priors", default="afc", show_default=True, help="Prior family that ships (afc, general), or a TOML file."),
    click.option("--model", type=click.Choice(["seed", "continuous"]), default="seed", show_default=True, help="Reversal rule of Eq. 1."),
    click.option("--noise", type=click.Choice(["ar1", "independent", "student"]), default="ar1", show_default=True, help="Noise model."),
    click.option("--free", default="", metavar="K,beta,gamma", help="Parameters that each run has for itself."),
)


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(shj_bayes.__version__, prog_name="shj-bayes")
def main() -> None:
    """Posteriors, design margins and missing physics for sliding steel friction connections."""


@main.command()
@RECORDINGS
@READING
@JSON
@QUIET
@click.pass_context
def check(ctx: click.Context, recordings: tuple[Path, ...], columns: str, units: str, rate: float, as_json: bool, quiet: bool) -> None:
    """Read and check recordings; say what was found, assumed and repaired."""
    from shj_bayes.recording.check import check_files

    results = check_files(recordings, columns=columns, units=units, rate_Hz=rate)
    if as_json:
        click.echo(json.dumps([result.to_dict() for result in results], indent=1))
    elif not quiet:
        click.echo("\n\n".join(result.text for result in results))
    if not all(result.usable for result in results):
        ctx.exit(1)


@main.command()
@RECORDINGS
@OUT
@READING
@MODELLING
@SEED
@click.option("--name", help="Name of the device; the first recording's name by default.")
@click.option("--max-steps", type=click.IntRange(200, 1_000_000), default=10_000, show_default=True, help="Steps after which to stop.")
@click.option("--workers", type=click.IntRange(1, 256), help="Threads; the numbers do not depend on it.")
@JSON
@QUIET
@click.pass_context
def fit(ctx: click.Context, recordings: tuple[Path, ...], out: Path, **options: Any) -> None:
    """Posterior of one device; several recordings are its consecutive runs."""
    from shj_bayes.campaign import fit_device

    result = fit_device(recordings, out, progress=_progress(options), **_fit_options(options))
    if options["as_json"]:
        click.echo(json.dumps(result.record, indent=1))
    elif not options["quiet"]:
        click.echo(result.text)
    if result.record["verdict"] == "unusable":
        ctx.exit(1)
