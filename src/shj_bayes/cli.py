"""The commands. No logic lives here: each command reads its options, calls one room and prints.

The rooms are imported inside the commands, so that ``shj-bayes --help`` answers at once.
"""

import json
from collections.abc import Callable
from dataclasses import Field, dataclass, fields
from functools import reduce, wraps
from pathlib import Path
from types import NoneType
from typing import Any, get_args, get_type_hints

import click

import shj_bayes
from shj_bayes._util.files import make_writable, need_files, need_population
from shj_bayes._util.processes import no_interrupt_lost, quiet_libraries
from shj_bayes.errors import CampaignError, PlanError, RecordingError, ShjError, plain_lines, system_words
from shj_bayes.options import DIAGNOSES, DiagnoseOptions, FitOptions, MarginOptions, PlanOptions, flag_of
from shj_bayes.results.codec import to_json

Command = Callable[..., Any]
PATH, FOLDER = click.Path(path_type=Path), click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, exists=True, dir_okay=False)
RESULTS = click.argument("folder", type=PATH, metavar="DIR")
SOME_FAILED = 3  # exit status of a campaign that is done but for devices that failed
RESUMING = {"fit", "campaign", "demo"}  # go on where they were stopped
NAMED = 5  # failed devices that one line names


@dataclass(frozen=True)
class Output:
    """What a command prints: a record for machines, words for people, or nothing but errors."""

    as_json: bool = False
    quiet: bool = False

    @property
    def speaks(self) -> bool:
        """Whether people read it."""
        return not (self.as_json or self.quiet)

    def tell(self, line: str) -> None:
        """Say on standard error what is being done."""
        if self.speaks:
            _say(f"  {line}", err=True)

    def show(self, record: Any, text: str) -> None:
        """Print a result."""
        if self.as_json:
            _say(json.dumps(to_json(record), indent=1))
        elif not self.quiet:
            _say(text)


def _say(text: object, *, err: bool = False) -> None:
    """Print: every line that a command writes goes through here, so that nothing that is stored steers the terminal."""
    click.echo(plain_lines(str(text)), err=err)


class _Command(click.Command):
    """A command whose help ends with examples."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if examples := examples_of(str(self.name)):
            with formatter.section("Examples"):
                formatter.write_text("\b\n" + "\n".join(examples))


class _Group(click.Group):
    """Turn every expected error into one line and exit 1; Ctrl-C says how to go on."""

    command_class = _Command

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with no_interrupt_lost():
                return super().invoke(ctx)
        except ShjError as error:
            _say(f"shj-bayes: {error}", err=True)
        except OSError as error:
            _say(f"shj-bayes: {system_words(error)}", err=True)
        except KeyboardInterrupt:
            again = "goes on from the last checkpoint" if ctx.invoked_subcommand in RESUMING else "begins anew"
            _say(f"shj-bayes: stopped; the same command again {again}", err=True)
        ctx.exit(1)


def _options(*decorators: Command) -> Callable[[Command], Command]:
    """Apply several option decorators as one."""
    return lambda function: reduce(lambda inner, decorator: decorator(inner), reversed(decorators), function)


def _out(default: str | None = None) -> Command:
    """Output folder; an option without default must not be given one, or click takes it for optional."""
    presence: dict[str, Any] = {"required": True} if default is None else {"default": default, "show_default": True}
    return click.option("-o", "--out", type=FOLDER, help="Folder for the results.", **presence)


def _number(flag: str, name: str, default: float, words: str) -> Command:
    """Option that is a number."""
    return click.option(flag, name, type=type(default), default=default, show_default=True, help=words)


class _Choice(click.Choice[str]):
    """Words; the old name of the published model is still taken."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        old = value == "seed" and "published" in self.choices
        return super().convert("published" if old else value, param, ctx)


def _declared(kind: type, *names: str) -> Command:
    """Options of a command as a class declares them: of these names, in this order, or all."""
    known = {one.name: one for one in fields(kind)}
    hints = get_type_hints(kind)
    return _options(*(_click_option(kind, known[name], hints[name]) for name in names or known))


def _click_option(kind: type, one: Field[Any], hint: Any) -> Command:
    """Option as a field of a class declares it."""
    says = one.metadata
    how: dict[str, Any] = {"help": says["words"], "metavar": says["metavar"]}
    if says["commas"]:
        how |= {"default": "", "callback": lambda _, __, value: tuple(filter(None, map(str.strip, value.split(","))))}
    elif one.default is False:
        how["is_flag"] = True
    elif one.default == ():
        how["multiple"] = True
    elif one.default and says["shown"]:
        how |= {"default": one.default, "show_default": True}
    if one.default is not False:
        kinds = [kind for kind in get_args(hint) or (hint,) if kind not in (NoneType, Ellipsis)]
        how["type"] = FILE if Path in kinds else kinds[0]
        if says["choices"]:
            how["type"] = _Choice(says["choices"])
        elif says["typed"]:
            how["type"] = click.IntRange(*says["typed"])
    return click.option(flag_of(kind, one.name), one.name, **how)


def _stated(options: dict[str, Any]) -> dict[str, Any]:
    """Options that were given, or have a default of their own in the command."""
    return {name: value for name, value in options.items() if value is not None}


JSON = click.option("--json", "as_json", is_flag=True, help="Machine-readable result on standard output, nothing else.")
QUIET = click.option("--quiet", is_flag=True, help="Print nothing but errors.")


def _with_output(function: Command) -> Command:
    """Take ``--json`` and ``--quiet`` as one argument, `output`."""

    @JSON
    @QUIET
    @wraps(function)
    def command(*args: Any, as_json: bool, quiet: bool, **options: Any) -> Any:
        return function(*args, output=Output(as_json, quiet), **options)

    return command


WORKERS = click.option(
    "--workers", type=click.IntRange(1, 256), help="Processors to use; the numbers do not depend on it."
)
SEED = _declared(FitOptions, "seed")
RECORDINGS = click.argument("recordings", nargs=-1, required=True, type=PATH, metavar="REC...")
READING = _options(
    _declared(FitOptions, "columns", "units", "rate_Hz", "sheet"),
    click.option("--runs", "n_runs", type=click.IntRange(1), metavar="N", help="Runs that the files hold together."),
    click.option("--split", is_flag=True, help="Split files where several runs are found."),
    click.option("--one-run", is_flag=True, help="Each file is one run, whatever it looks like."),
)
ON_DEVICE = _options(
    RECORDINGS,
    _out(),
    READING,
    _declared(FitOptions, "priors", "priors_from", "model", "noise", "effects", "free", "max_steps", "seed"),
    _declared(DiagnoseOptions, "name"),
    click.option("--force", is_flag=True, help="Replace the result of another device in the folder."),
    WORKERS,
)


def _reading(n_runs: int | None, split: bool, one_run: bool, **options: Any) -> dict[str, Any]:
    """Options of reading, with the three on runs as one."""
    if (n_runs is not None) + split + one_run > 1:
        raise click.UsageError("--runs, --split and --one-run exclude one another; give one of them.")
    return options | {"runs": "split" if split else "one" if one_run else n_runs}


@click.group(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(shj_bayes.__version__, prog_name="shj-bayes")
def main() -> None:
    """Posteriors and design margins for sliding steel friction connections."""
    quiet_libraries()


@main.command()
@_out("shj-bayes-demo")
@SEED
@WORKERS
@QUIET
def demo(out: Path, seed: int, workers: int | None, quiet: bool) -> None:
    """Run the whole job on simulated data. They ship with the project."""
    from shj_bayes._util.files import shipped

    manifest = shipped("data", "examples", "campaign.toml")
    _run_campaign(manifest, out, seed=seed, workers=workers or 0, output=Output(quiet=quiet))


@main.command()
@RECORDINGS
@READING
@_with_output
def check(recordings: tuple[Path, ...], output: Output, **reading: Any) -> None:
    """Read recordings; say what was found, assumed and repaired. Exit status 1 when one of them cannot be used."""
    reading = _reading(**reading)
    if not output.as_json and not any(path.exists() for path in recordings):
        need_files(recordings, RecordingError)
    from shj_bayes.recording.runs import check_recording

    results = [result for path in recordings for result in check_recording(path, **reading)]
    output.show([facts for facts, _ in results], "\n\n".join(text for _, text in results))
    if not all(facts["usable"] for facts, _ in results):
        raise SystemExit(1)


@main.command()
@ON_DEVICE
@_with_output
def fit(
    recordings: tuple[Path, ...], out: Path, force: bool, workers: int | None, output: Output, **options: Any
) -> None:
    """Posterior of one device. Several recordings are its consecutive runs."""
    need_files(recordings, RecordingError)
    from shj_bayes.app.resume import kept_result
    from shj_bayes.results.fit import Trust

    name, options = options.pop("name"), _reading(**options)
    result = kept_result(recordings, out, options, name)
    if result is None:
        from shj_bayes.app.device import Work, fit_device, step_told

        speak = output.speaks
        work = Work(speak, workers or 0, force, step_told if speak else Work.tell)
        result = fit_device(recordings, out, FitOptions(**options), name=name, work=work)
    output.show(result.record, result.text)
    if result.record.verdict == Trust.UNUSABLE:
        raise ShjError(f"{result.record.device}: the posterior is unusable: {result.record.reasons[0]}")


@main.command()
@ON_DEVICE
@_declared(DiagnoseOptions, "without", "quick")
@_with_output
def diagnose(
    recordings: tuple[Path, ...], out: Path, force: bool, workers: int | None, output: Output, **options: Any
) -> None:
    """Find, name and model what the base law leaves out. Shows the fit before and after."""
    need_files(recordings, RecordingError)
    from shj_bayes.app.device import Work, diagnose_device

    wanted, name = DiagnoseOptions(options.pop("without"), options.pop("quick")), options.pop("name")
    work = Work(output.speaks, workers or 0, force, output.tell)
    result = diagnose_device(recordings, out, FitOptions(**_reading(**options)), wanted, name=name, work=work)
    output.show(result.record, result.text)


@main.command()
@click.argument("manifest", type=PATH)
@_out()
@SEED
@WORKERS
@click.option("--dask", "cluster", metavar="ADDRESS", help="Of a dask scheduler whose workers fit the devices.")
@click.option(
    "--diagnose",
    type=click.Choice(DIAGNOSES),
    help="Look for what the law leaves out; by default as the manifest says, quick where it says nothing.",
)
@_with_output
def campaign(manifest: Path, out: Path, workers: int | None, cluster: str | None, **options: Any) -> None:
    """Fit and diagnose all devices of a TOML manifest.

    Then population and report; the same command goes on where it stopped. Exit status 3 when it is done but for devices
    that failed.
    """
    if cluster is not None and workers:
        raise click.UsageError("--workers is for this machine and --dask for a cluster; give one of them.")
    if cluster is not None and not cluster.strip():
        raise click.UsageError("--dask needs an address, such as tcp://10.0.0.5:8786.")
    _run_campaign(manifest, out, workers=workers or 0, cluster=cluster or "", **options)


def _run_campaign(manifest: Path, out: Path, *, seed: int, output: Output, **how: Any) -> None:
    need_files([manifest], CampaignError)
    make_writable(out)
    from shj_bayes.app.campaign import run_campaign, summarise_campaign
    from shj_bayes.app.manifest import read_manifest

    plan, speak = read_manifest(manifest), output.speaks
    outcomes = run_campaign(plan, out, progress=speak, **how)
    result = summarise_campaign(outcomes, out, seed=seed, progress=speak)
    output.show(result.record, result.text)
    if not result.usable:
        raise CampaignError("no device could be used; the reasons stand above and in campaign.json")
    if failed := [f"{o.device.set_name}, {o.device.name} ({'; '.join(o.failures)})" for o in outcomes if o.failures]:
        more = f"; and {len(failed) - NAMED} more, in campaign.json" if len(failed) > NAMED else ""
        done = f"done, but {len(failed)} of {len(outcomes)} devices failed: {'; '.join(failed[:NAMED])}{more}"
        _say(f"shj-bayes: {done}", err=True)
        raise SystemExit(SOME_FAILED)


@main.command()
@click.argument("folder", type=PATH, default=Path("shj-bayes-bench"), metavar="[FOLDER]")
@click.option("--no-browser", is_flag=True, help="Print the file that opens it, and open nothing.")
@click.option("--shortcut", is_flag=True, help="Put an entry for it on the desk, and end.")
def bench(folder: Path, no_browser: bool, shortcut: bool) -> None:
    """Do the whole job in the browser, on this machine alone.

    FOLDER is an ordinary campaign folder, or a file that a bench made of one.
    """
    from shj_bayes.bench.server import opened, put_shortcut, serve

    place = opened(folder)
    if shortcut:
        _say(put_shortcut(place))
    else:
        serve(place, browser=not no_browser, tell=_say)


@main.command()
@_out("shj-bayes-tables")
@SEED
@_with_output
def tables(out: Path, seed: int, output: Output) -> None:
    """Bands and comparisons of the published tables. They give parameters alone, rounded."""
    make_writable(out)
    from shj_bayes.app.campaign import summarise_tables
    from shj_validation.paper_claims import paper_claims

    result = summarise_tables(out, paper_claims(), seed=seed, progress=output.speaks)
    output.show(result.record, result.text)


@main.command()
@RESULTS
@_declared(MarginOptions)
@_with_output
def margins(folder: Path, output: Output, **options: Any) -> None:
    """Draw up design margins. Of a campaign or of the tables in DIR: margins.html, .csv, .xlsx, .json."""
    need_population(folder)
    from shj_bayes.app.resume import design_margins

    design = design_margins(folder, MarginOptions(**_stated(options)), progress=output.speaks)
    output.show(design.record, f"{design.text}\n\nmargins: {folder / 'margins.html'}")


@main.command()
@RESULTS
@click.option(
    "--to", "target", type=click.Choice(["opensees", "sap2000", "etabs"]), required=True, help="And a link table."
)
@click.option("-o", "--out", type=FOLDER, help="By default a folder of that name in DIR.")
@click.option("--amplitude", "amplitude_mm", type=float, metavar="MM", help="Of the cycle; largest tested by default.")
@click.option("--draws", type=int, metavar="N", help="New devices of each set too, as materials for Monte Carlo.")
@_with_output
def export(
    folder: Path, target: str, out: Path | None, amplitude_mm: float | None, draws: int | None, output: Output
) -> None:
    """Write materials or links for structural analysis. Bounds of a campaign or of the tables in DIR."""
    need_population(folder)
    from shj_bayes.app.design import export_analysis

    files = export_analysis(folder, out, amplitude_mm, draws, target=target, progress=output.speaks)
    paths = [str(path) for path in files]
    output.show({"schema": "shj-bayes/export/1", "to": target, "files": paths}, "\n".join(paths))


@main.command()
@RESULTS
@click.argument("set_a", metavar="A")
@click.argument("set_b", metavar="B")
@click.option(
    "--rope",
    type=click.FloatRange(0, 100, min_open=True, max_open=True),
    default=10.0,
    show_default=True,
    metavar="PERCENT",
    help="Differences below this count as the same.",
)
@click.option("-o", "--out", type=FOLDER, help="Folder for comparison.csv, .xlsx and .json; DIR by default.")
@_with_output
def compare(folder: Path, set_a: str, set_b: str, rope: float, out: Path | None, output: Output) -> None:
    """Compare two sets of a campaign or of the tables.

    A and B are names of sets, or kinds of sets that are compared pair by pair: corroded and uncorroded, coated and
    uncoated, "70 %" and "100 %".
    """
    need_population(folder)
    from shj_bayes.app.design import compare_sets, write_comparison

    record, text = compare_sets(folder, set_a, set_b, rope)
    written = write_comparison(record, folder if out is None else out)
    output.show(record, f"{text}\n\ncomparison: {written}")


@main.command()
@click.option("-o", "--out", "stem", type=PATH, required=True, help="Stem of the files.")
@click.option("--dep", type=float, help="Speed dependence 1/gamma, mm/s; none by default.")
@_number("--K", "K", 18.0, "Stiffness, kN/mm.")
@_number("--Fy", "Fy", 80.0, "Sliding force of the first run, kN.")
@_number("--beta", "beta", 10.0, "Sharpness, 1 to 500.")
@_number("--ratio", "ratio", 0.875, "Fy of the second run / first.")
@_number("--sigma", "sigma", 1.0, "Force noise scale, kN.")
@_number("--phi", "phi", 0.8, "Lag-one correlation of the force noise.")
@_number("--sigma-slow", "sigma_slow", 0.0, "Slow noise on top of it, kN.")
@_number("--tau-slow", "tau_slow", 3.0, "Its correlation time, s.")
@_number("--displacement-noise", "displacement_noise_mm", 0.02, "Displacement noise, mm.")
@_number("--rate", "rate_Hz", 20.0, "Sampling rate, Hz.")
@_number("--last-cycles", "last_cycles", 5, "Cycles in the last block of Table 1.")
@_declared(FitOptions, "model", "seed")
@QUIET
def simulate(stem: Path, dep: float | None, quiet: bool, **options: Any) -> None:
    """Make recordings from stated parameters. Two runs of Table 1, with the truth beside them."""
    from shj_bayes.app.device import gamma_of, write_simulated
    from shj_bayes.model.simulate import Truth

    how = {key: options.pop(key) for key in ("seed", "rate_Hz", "last_cycles", "model")}
    for path in write_simulated(stem, Truth(gamma=gamma_of(dep), **options), **how):
        if not quiet:
            _say(path)


@main.command()
@click.argument("folders", nargs=-1, type=PATH, metavar="[DIR]...")
@click.option("-o", "--out", type=FOLDER, help="Folder for the plan.")
@_declared(PlanOptions, "question", "among")
@click.option("--rig", type=PATH, metavar="FILE", help="Limits of the rig, TOML.")
@_declared(
    PlanOptions, "max_stroke_mm", "max_speed_mm_s", "max_force_kN", "max_minutes", "rate_Hz", "histories", "priors"
)
@click.option("--example-rig", type=PATH, metavar="FILE", help="Write an example of rig.toml.")
@SEED
@_with_output
def plan(
    folders: tuple[Path, ...],
    out: Path | None,
    rig: Path | None,
    example_rig: Path | None,
    output: Output,
    **asked: Any,
) -> None:
    """Plan the next test of devices, or of a new one. Of those whose results are in DIR, or from --priors."""
    if example_rig is not None:
        from shj_bayes._util.files import shipped, write_text

        write_text(example_rig, shipped("data", "examples", "rig.toml").read_text(encoding="utf-8"))
        return
    if out is None:
        raise click.UsageError("Missing option '-o' / '--out'.")
    if bool(folders) == (asked["priors"] is not None):
        raise click.UsageError("Give the folder of a diagnosed device, or --priors for a plan before any test.")
    need_files([*folders, *([rig] if rig else [])], PlanError)
    from shj_bayes.app.plan import plan_next

    planned = plan_next(folders, out, PlanOptions(**_stated(asked)), rig=rig, tell=output.tell)
    output.show(planned.record, planned.text)


@main.command("open")
@RESULTS
@click.option(
    "--page", type=click.Choice(["report", "diagnosis", "margins", "plan"]), help="Page to open, where DIR has several."
)
@click.option("--pdf", is_flag=True, help="Print the page to PDF beside it, by an installed Chromium, Chrome or Edge.")
def open_(folder: Path, page: str | None, pdf: bool) -> None:
    """Open the page of a result, or print it to PDF. The browser reads it from the disk; nothing is served."""
    from shj_bayes.report.browse import open_page, page_of, write_pdf

    found = page_of(folder, page)
    if pdf:
        _say(write_pdf(found))
    elif open_page(found):
        _say(found)
    else:
        _say(f"no browser could be started; open this file yourself: {found.resolve()}")


@main.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print what makes a shell complete commands and options. The guide says where to put it."""
    from click.shell_completion import get_completion_class

    found = get_completion_class(shell)
    assert found is not None
    click.echo(found(main, {}, "shj-bayes", "_SHJ_BAYES_COMPLETE").source())


PROOF_SEED = 49042132  # of the project's own proof


@main.command()
@click.option("-n", "n", type=click.IntRange(1, 9999), default=200, show_default=True, help="Number of trials.")
@click.option("--seed", type=click.IntRange(0, 2**128 - 1), help=f"Of what is concealed.  [{PROOF_SEED}]")
@click.option("-o", "--out", type=FOLDER, help="Folder for the results.")
@click.option("--earlier", is_flag=True, help="Trials of the first kind: Table 1 and a test of several speeds.")
@click.option("--check", "checked", type=FOLDER, help="Check a finished proof.")
@click.option("--recordings", type=FOLDER, help="Real recordings, answer withheld.")
@click.option("--challenge", type=click.IntRange(1, 999), metavar="N", help="Write N devices without truth.")
@click.option("--score", "sheet", type=PATH, help="Score the answers to a challenge.")
@click.option("--full", is_flag=True, help="Every diagnosis in full: three times as long.")
@click.option("--open-now", is_flag=True, help="Open a stopped proof and score the trials diagnosed so far.")
@WORKERS
@_with_output
def prove(
    out: Path | None,
    checked: Path | None,
    recordings: Path | None,
    challenge: int | None,
    sheet: Path | None,
    seed: int | None,
    workers: int | None,
    output: Output,
    full: bool,
    **trials: Any,
) -> None:
    """Prove the diagnosis on concealed effects.

    Trials are sealed, diagnosed behind a fence, opened and scored; or --check of a finished proof. A --challenge is for
    any other tool, or the eye; its --score counts alike.
    """
    how: dict[str, Any] = {"workers": workers or 2, "progress": output.speaks}
    if checked is not None:
        from shj_validation.proof.check import check as check_proof

        lines = check_proof(checked, **how)
        output.show({"checked": lines}, "\n".join([*lines, "the transcript holds"]))
    elif sheet is not None:
        from shj_validation.proof.challenge import score_challenge

        scored = score_challenge(sheet, seed, out, progress=output.speaks)
        output.show(scored.record, scored.text)
    elif out is None:
        raise click.UsageError("Missing option '-o' / '--out'.")
    elif challenge is not None:
        from shj_validation.proof.challenge import make_challenge

        opening = make_challenge(out, challenge, seed, progress=output.speaks)
        words = f"kit: {out} (README.txt says how)\nseed: {opening}; keep it, and state it when the answers are in"
        output.show({"kit": str(out), "opening": str(opening)}, words)
    elif recordings is not None:
        from shj_validation.proof.real import prove_recordings

        real = prove_recordings(recordings, out, **how)
        output.show(real.record, real.text)
    else:
        from shj_validation.proof.run import prove as prove_effects

        proof = prove_effects(out, seed=PROOF_SEED if seed is None else seed, quick=not full, **trials, **how)
        output.show(proof.score, proof.text)


@main.command()
@JSON
def doctor(as_json: bool) -> None:
    """Say what is installed and whether it works. Also how fast this machine is."""
    from shj_bayes.app.device import examine

    record, text = examine()
    Output(as_json).show(record, text)
    if not record["works"]:
        raise ShjError("something does not work; the lines above say what")


EXAMPLES = """
shj-bayes bench lab
shj-bayes bench lab --no-browser
shj-bayes demo
shj-bayes demo -o first-look
shj-bayes check run1.csv run2.csv
shj-bayes check test.txt --columns time=1,displacement=5,force=7 --units ms,mm,N
shj-bayes fit run1.csv run2.csv -o results
shj-bayes fit test.txt -o other --columns time=1,displacement=5,force=7 --units ms,mm,N
shj-bayes fit run1.csv run2.csv -o freed --free K,gamma --priors general
shj-bayes diagnose run1.csv run2.csv -o results
shj-bayes diagnose run1.csv run2.csv -o look --quick
shj-bayes diagnose run1.csv -o results --without velocity
shj-bayes campaign campaign.toml -o spring
shj-bayes campaign campaign.toml -o spring --workers 4
shj-bayes campaign campaign.toml -o spring --dask tcp://10.0.0.5:8786
shj-bayes tables -o tables
shj-bayes margins spring
shj-bayes margins tables
shj-bayes compare tables "Zinc 70" "Zinc 70 corroded"
shj-bayes compare spring bare "zinc 70 %" --json
shj-bayes simulate -o made/a --K 18 --Fy 80 --dep 60
shj-bayes simulate -o made/b --beta 100 --dep -60 --ratio 0.7 --rate 10 --seed 7
shj-bayes prove -n 4 -o proof
shj-bayes prove -n 40 --seed 7 -o proof
shj-bayes prove --challenge 10 -o kit
shj-bayes prove --score kit/answers.csv
shj-bayes export spring --to opensees
shj-bayes plan results -o next
shj-bayes plan results -o next --max-speed 40 --max-minutes 20
shj-bayes plan results -o next --among velocity,prying
shj-bayes plan -o first --priors afc --rig rig.toml
shj-bayes plan --example-rig rig.toml
shj-bayes open results
shj-bayes open results --page diagnosis
shj-bayes open spring --pdf
shj-bayes completion bash
shj-bayes completion zsh
shj-bayes doctor
shj-bayes doctor --json
"""


def examples_of(name: str) -> list[str]:
    """Give the lines of `EXAMPLES` that call a command."""
    return [line for line in EXAMPLES.splitlines() if line.split()[1:2] == [name]]
