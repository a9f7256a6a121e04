"""Which column is time, displacement and force, and in which unit: by option, else by header, never by guess."""

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import RecordingError, did_you_mean, shown
from shj_bayes.recording import limits
from shj_bayes.recording.recording import Column, Finding
from shj_bayes.recording.tables import (
    Table,
    beside,
    clock_of,
    described,
    evaluate,
    listed,
    one_axis,
    same_clock,
    seconds_of,
    usual_step,
)
from shj_bayes.recording.units import ROLES, TARGET, Role, factor, is_weight, multiplier, parse_units, role_of

TENSION = "tension"  # of the bolts: the force over it is a coefficient of friction
# Headers that mean the channel and nothing else; a header that merely contains one of the words is a weaker claim.
_EXACT: dict[Role, set[str]] = {
    "time": {
        *("time", "t", "elapsed time", "running time", "test time", "total time", "timestamp", "zeit", "temps"),
        "x value",  # of LabVIEW
    },
    "displacement": {"displacement", "disp", "displ", "stroke", "slip", "u", "x", "d", "deformation", "weg"},
    "force": {"force", "load", "f", "p", "axial force", "shear force", "axial load", "kraft"},
}
_CONTAINS: dict[Role, set[str]] = {
    "time": {"time", "zeit", "temps", "timestamp"},
    "displacement": {"displacement", "disp", "stroke", "slip", "lvdt", "deflection", "deformation", "weg", "hub"},
    "force": {"force", "load", "kraft"},
}
_RUN = {"run", "run no", "run nr", "run number", "run id", "run index", "test run", "lauf"}
_OPTION = re.compile(r"\s*(?P<role>\w+)\s*=(?P<what>.*)$", re.DOTALL)
_HOW = "--columns time=...,displacement=...,force=... (column name, number, or a formula such as #7 - 49.087*#6)"


class RawChannels(NamedTuple):
    """The three channels in s, mm and kN, before any check."""

    # time_s to force_kN: shape (n_rows,): NaN where the file has no number
    time_s: FloatArray
    displacement_mm: FloatArray
    force_kN: FloatArray
    # columns, units: what was read for each role
    columns: dict[str, str]
    units: dict[str, str]
    findings: tuple[Finding, ...]  # what was assumed
    # named, assumed, told: roles whose column the user named, whose unit nobody states, whose unit the file alone does
    named: frozenset[str] = frozenset()
    assumed: frozenset[str] = frozenset()
    told: frozenset[str] = frozenset()
    run_rows: tuple[int, ...] = ()  # rows at which a run column says that a further run begins
    extras: tuple[Column, ...] = ()  # further channels that were asked for, at all rows


def choose(
    table: Table, columns: str | None = None, units: str | None = None, rate_Hz: float | None = None
) -> RawChannels:
    """Pick and convert the three channels of a table; arguments are those of `shj_bayes.recording.reader.read`.

    `RecordingError` if a channel is missing, ambiguous or in a unit that is not its own.
    """
    asked, given, findings = parse_columns(columns), parse_units(units), list[Finding]()
    own = _own_times(table, asked)
    apart = own is not None and not same_clock(*own)
    if own is not None and apart and (rate_Hz is not None or "time" in asked):
        raise RecordingError(
            f"{table.name}: displacement has {described(own[0])}, force {described(own[1])}, in the file itself; leave "
            "--rate and time=... out"
        )
    if rate_Hz is not None:
        check_rate(rate_Hz, asked)
        _rate_agrees(rate_Hz, table, given, own)
    times = candidates(table, "time")[0]
    one_time = len(times) == 1 or (not times and "wf_increment" in table.scalars)  # for all channels
    timed = own is not None and (apart or (rate_Hz is None and "time" not in asked and not one_time))
    roles = [role for role in ROLES if role != "time" or rate_Hz is None]
    values, chosen = _columns(table, [role for role in roles if role != "time" or not timed], asked, findings)
    axis_s = own[0] if own else None
    if own and apart:
        axis_s = _laid(values, own, table.name, findings)
    if timed and axis_s is not None:
        told = all(column.clock_told for value in values.values() for column in value.made_of)
        chosen["time"] = "times of the channels"
        values["time"] = Column("time", axis_s, "s" if told else None)
        given = {role: unit for role, unit in given.items() if role != "time" or not told}
    n = _length(values, table)
    used, arrays = dict[str, str](), dict[Role, FloatArray]()
    if rate_Hz is not None:
        arrays["time"], used["time"], chosen["time"] = np.arange(n) / rate_Hz, "s", f"sample number / {rate_Hz:g} Hz"
        message = f"no time column is read: a constant rate of {rate_Hz:g} Hz is assumed, as given"
        findings.append(Finding("rate-given", "assumed", f"{message}; speeds are as good as it"))
    for role in roles:
        missing = f"{table.name} gives no unit for {chosen[role]!r}"
        used[role] = unit = _unit(role, values[role], given, findings, missing)
        scale = _factor(unit, role, chosen[role], table)
        if role == "force" and is_weight(unit):
            message = f"force: 1 {unit} is taken for the weight of that mass, {scale:.6g} kN"
            findings.append(Finding("unit-weight", "assumed", message))
        arrays[role] = np.asarray(values[role].values * scale, dtype=np.float64)
    if not arrays["time"].ndim:  # a sampling interval
        step, name = float(arrays["time"]), chosen["time"] or "wf_increment"
        if not 0 < step < np.inf:
            raise RecordingError(f"time: the sampling interval {name} is {step:g} s; it must be above zero")
        arrays["time"] = np.arange(n, dtype=np.float64) * step
        message = f"time is made from the constant interval {name} = {step:g} s"
        findings.append(Finding("time-from-step", "assumed", message))
    others = {name: evaluate(text, table) for name, text in asked.items() if name not in ROLES}
    extras = tuple(_extra(name, value, axis_s, n, table) for name, value in others.items())
    run, run_rows = _run_column(table, values, axis_s if apart else None, findings)
    read = [run, *(column for value in (*values.values(), *others.values()) for column in value.made_of)]
    known = {id(one) for column in read if column for one in (column, column.clock_s)}
    rest = [c for c in table.columns if known.isdisjoint((id(c), id(c.values)))]
    if names := [(c.header if table.has_header else "") or c.name for c in rest]:
        findings.append(Finding("columns-ignored", "note", f"columns not used: {listed(names)}"))
    return RawChannels(
        **{f"{role}_{TARGET[role]}": arrays[role] for role in ROLES},
        columns=chosen,
        units=used,
        findings=tuple(findings),
        named=frozenset(asked),
        assumed=frozenset(r for r in roles if r not in given and values[r].values.ndim and not values[r].unit),
        told=frozenset(r for r in roles if r not in given and (values[r].unit or not values[r].values.ndim)),
        run_rows=run_rows,
        extras=extras,
    )


def choose_history(table: Table) -> tuple[FloatArray, FloatArray, tuple[Finding, ...]]:
    """Pick time (s) and displacement (mm) of a table without a force: by header, else the first two columns.

    Rows without a number are left out and told; `RecordingError` where they are many, or there are no two columns.
    """
    roles: tuple[Role, Role] = ("time", "displacement")
    findings = list(table.findings)
    named = [by_header(table, role, []) for role in roles]
    columns = [column for column in named if column is not None]
    if len(columns) < len(roles):
        columns = list(table.columns[: len(roles)])
    if len(columns) < len(roles) or columns[0].values.size != columns[1].values.size:
        raise RecordingError(f"{table.name}: a history needs two columns of equal length, time and displacement")
    time, moved = (
        column.values * _factor(column.unit or TARGET[role], role, column.label, table)
        for role, column in zip(roles, columns, strict=True)
    )
    known = np.isfinite(time) & np.isfinite(moved)
    n_left = int(known.size - known.sum())
    if n_left > limits.BAD_CELL_SHARE * known.size or not limits.MIN_HISTORY <= known.size <= limits.MAX_HISTORY:
        raise RecordingError(
            f"{table.name}: {n_left} of {known.size} rows hold no number in time or displacement; allowed are "
            f"{limits.BAD_CELL_SHARE:.0%}, of {limits.MIN_HISTORY} to {limits.MAX_HISTORY} rows; correct them, or thin "
            "the history"
        )
    if n_left:
        message = f"{n_left} of {known.size} rows hold no number in time or displacement, and are left out"
        findings.append(Finding("rows-left-out", "warning", message, n_left))
    return time[known], moved[known], tuple(findings)


def _own_times(table: Table, asked: dict[str, str]) -> tuple[FloatArray, FloatArray] | None:
    """Find the times of displacement and force, s, where both channels have their own."""
    if all(column.clock_s is None for column in table.columns):
        return None
    clocks = []
    for role in ("displacement", "force"):
        header = None if role in asked else by_header(table, role, [])
        columns = evaluate(asked[role], table).made_of if role in asked else (header,) if header else ()
        clocks.append(clock_of(columns))
    return None if clocks[0] is None or clocks[1] is None else (clocks[0], clocks[1])


def _laid(
    values: dict[Role, Column], own: tuple[FloatArray, FloatArray], name: str, findings: list[Finding]
) -> FloatArray:
    """Put displacement and force on one axis, in place; give its times, s."""
    x, f = values["displacement"], values["force"]
    axis_s = one_axis(own[0], own[1], name)
    values["displacement"] = replace(x, values=np.interp(axis_s, own[0], x.values), parts=x.made_of)
    values["force"] = replace(f, values=f.values[np.searchsorted(own[1], axis_s)], parts=f.made_of)
    step = usual_step(axis_s)
    both = bool(
        np.all(np.min(np.abs(axis_s[:, None] - own[0][beside(own[0], axis_s)]), axis=1) < limits.SAME_INSTANT * step)
    )
    how = "both were read" if both else "the force was read; the displacement is on straight lines between its readings"
    message = (
        f"displacement has {described(own[0])}, force {described(own[1])}: they are laid on one axis of {axis_s.size} "
        f"instants at {1.0 / step:.4g} Hz, at which {how}; of {own[1].size} forces {own[1].size - axis_s.size} are not "
        "used"
    )
    findings.append(Finding("own-times", "assumed", message))
    return axis_s


def _columns(
    table: Table, roles: Sequence[Role], asked: dict[str, str], findings: list[Finding]
) -> tuple[dict[Role, Column], dict[str, str]]:
    """Values of the channels, and what each was read from: by option, else by header."""
    values: dict[Role, Column] = {}
    chosen: dict[str, str] = {}
    for role in roles:
        if role in asked:
            values[role], chosen[role] = evaluate(asked[role], table), asked[role]
        elif column := by_header(table, role, findings):
            values[role], chosen[role] = column, column.label
        else:
            values[role], chosen[role] = _no(table, role, asked), ""
        for column in values[role].made_of:
            n_rows, n_words = column.values.size, column.n_words
            if n_words > limits.BAD_CELL_SHARE * n_rows:
                message = (
                    f"{role}: {n_words} of {n_rows} cells hold text; allowed are {limits.BAD_CELL_SHARE:.0%}; write "
                    "all numbers with one decimal sign, and take words out"
                )
                findings.append(Finding("text-cells", "unusable", message, n_words))
    return values, chosen


def _extra(name: str, value: Column, axis_s: FloatArray | None, n: int, table: Table) -> Column:
    """Take a further channel; a force, such as a bolt tension, in kN, anything else in the unit of its header."""
    clock = None if axis_s is None else clock_of(value.made_of)
    if axis_s is not None and clock is not None and clock.size == value.values.size and not same_clock(clock, axis_s):
        at = np.interp(axis_s, clock, value.values, left=np.nan, right=np.nan)  # its times are its own
        value = replace(value, values=at)
    if value.values.size != n or not value.values.ndim:
        raise RecordingError(f"{table.name}: {name} has {value.values.size} rows, the force {n}; choose another column")
    unit = value.unit or ""
    if role_of(unit) == "force" or (name == TENSION and (not unit or is_weight(unit))):
        return Column(name, value.values * (factor(unit, "force") if unit else 1.0), "kN")
    return Column(name, value.values, unit)


def parse_columns(option: str | None) -> dict[str, str]:
    """Read ``--columns``: name, number or formula by role or name of a further channel; names may have commas."""
    found: dict[str, str] = {}
    for part in re.split(r",(?=\s*\w+\s*=)", option or ""):
        if not part.strip():
            continue
        match = _OPTION.match(part)
        role = match["role"].lower() if match else ""
        if match is None or not match["what"].strip() or len(role) > limits.MAX_EXTRA_NAME:
            raise RecordingError(f"--columns: cannot read {part.strip()!r}; write {_HOW}")
        if role not in ROLES and (meant := did_you_mean(role, ROLES)):
            raise RecordingError(f"--columns: {role!r} is no channel of the law{meant} Write {_HOW}")
        if role in found:
            raise RecordingError(
                f"--columns names {role} twice: {found[role]!r} and {match['what'].strip()!r}; name it once"
            )
        found[role] = match["what"].strip()
    if len(found) > len(ROLES) + limits.MAX_EXTRAS:
        raise RecordingError(f"--columns names {len(found)} channels; allowed are 3 and {limits.MAX_EXTRAS} more")
    return found


def candidates(table: Table, role: Role) -> tuple[list[Column], bool]:
    """Columns whose header may be a channel, and whether it says so exactly and not by a word in a longer header."""
    columns = table.columns if table.has_header else ()
    exact = [c for c in columns if _words(c.name) in _EXACT[role]]
    return exact or [c for c in columns if set(_words(c.name).split()) & _CONTAINS[role]], bool(exact)


def by_header(table: Table, role: Role, findings: list[Finding]) -> Column | None:
    """Find a channel by its header, None where none fits; `RecordingError` where several fit equally well."""
    found, exact = candidates(table, role)
    if len(found) > 1:
        groups = list(dict.fromkeys(c.group for c in found if c.group))
        group = f", or take one of the groups with --sheet, as in --sheet {groups[0]!r}" if len(groups) > 1 else ""
        raise RecordingError(
            f"{table.name}: {len(found)} columns could be {role}: {', '.join(c.label for c in found)}; "
            f"say which with --columns {role}=...{group}"
        )
    if found and not exact:
        findings.append(Finding("column-by-word", "assumed", f"column {found[0].header!r} is taken for the {role}"))
    return found[0] if found else None


def roles_named(name: str) -> set[Role]:
    """Channels that a name may stand for."""
    words = _words(name)
    return {role for role in ROLES if words in _EXACT[role] or set(words.split()) & _CONTAINS[role]}


def _words(name: str) -> str:
    """Header in lower case with blanks between the words."""
    return " ".join(re.split(r"[\s_\-./]+", name.strip().lower())).strip()


def _no(table: Table, role: Role, asked: dict[str, str]) -> Column:
    """Refuse a file in which a channel cannot be found; say what would name all that are missing at once."""
    if role == "time" and "wf_increment" in table.scalars:
        return Column("", np.asarray(table.scalars["wf_increment"]))
    missing = f"no {role} column{'' if table.has_header else ' and no header'}"
    step = ", or name the single number that is the interval" if table.scalars else ""
    rate = f"; if it was sampled at a constant rate, give it with --rate HZ{step}" if role == "time" else ""
    likely = []
    for other in (r for r in ROLES if r not in asked and not candidates(table, r)[0]):
        places = [i for i, c in enumerate(table.columns, start=1) if c.unit and role_of(c.unit) == other]
        likely += [f"{other}={places[0]}"] if len(places) == 1 else []
    perhaps = f"; going by the units, perhaps --columns {','.join(likely)}" if likely else ""
    raise RecordingError(f"{table.name}: {missing} found; {table.summary}; name it with {_HOW}{rate}{perhaps}")


def check_rate(rate_Hz: float, asked: dict[str, str]) -> None:
    """Refuse a sampling rate, Hz, that is none, or that is given beside a time column (`RecordingError`)."""
    if not 1e-6 <= rate_Hz <= 1e7:
        raise RecordingError(f"--rate {shown(rate_Hz, 20)} Hz: allowed is 1e-6 to 1e7 Hz")
    if "time" in asked:
        raise RecordingError(f"both --rate {rate_Hz:g} and --columns time={asked['time']} are given; give one of them")


def _rate_agrees(
    rate_Hz: float, table: Table, given: dict[Role, str], own: tuple[FloatArray, FloatArray] | None
) -> None:
    """Refuse a sampling rate that the file's own clock, or the times of its channels, contradict."""
    steps: dict[str, list[float]] = {"wf_increment": [table.scalars.get("wf_increment", 0.0)]}
    column = found[0] if len(found := candidates(table, "time")[0]) == 1 else None
    times = None if column is None else seconds_of(replace(column, unit=given.get("time") or column.unit))
    times = np.zeros(0) if times is None else times[np.isfinite(times)]
    if column is not None and times.size > 1 and times[-1] > times[0]:
        # A clock printed with few digits repeats its times, and one with gaps ends late: each shows in one of the two.
        mean = float(times[-1] - times[0]) / (times.size - 1)
        steps[f"column {column.label!r}"] = [float(np.median(np.diff(times))), mean]
    if own is not None:
        steps["the time of the channels"] = [usual_step(own[0])]
    for name, told in steps.items():
        said = [1.0 / step for step in told if 0 < step < np.inf]
        if said and all(abs(rate / rate_Hz - 1) > limits.RATE_AGREES for rate in said):
            raise RecordingError(
                f"{table.name}: {name} says {said[0]:.4g} Hz, --rate {rate_Hz:g} Hz; leave --rate out, which is for "
                "files without time; where the time is wrong, correct it, or take its column out"
            )


def _length(values: dict[Role, Column], table: Table) -> int:
    """Give the common number of rows; only time may be a single number (the sampling interval)."""
    sizes = {role: value.values.size for role, value in values.items() if value.values.ndim}
    for role in ("displacement", "force"):
        if role not in sizes:
            raise RecordingError(f"{table.name}: {role} is a single number; it must be a column; {table.summary}")
    if len(set(sizes.values())) > 1:
        shown = ", ".join(f"{role} {size}" for role, size in sizes.items())
        raise RecordingError(
            f"{table.name}: the columns have different lengths ({shown}); choose columns of equal length"
        )
    return sizes["displacement"]


def _unit(role: Role, value: Column, given: dict[Role, str], findings: list[Finding], missing: str) -> str:
    """Take the unit by option, else by header, else the tool's own, which is said aloud: `missing` begins the words."""
    header = value.unit
    if role in given:
        own = None if header is None else multiplier(header, role)
        same = header == given[role] or (own is not None and np.isclose(own, factor(given[role], role), rtol=1e-9))
        if header is not None and not same:
            message = f"{role}: the header says {header}, --units says {given[role]}; {given[role]} is used"
            findings.append(Finding("unit-overruled", "warning", message))
        return given[role]
    if header is not None:
        return header
    message = f"{role}: {missing}; {TARGET[role]} is assumed; if not, use --units"
    findings.append(Finding("unit-assumed", "assumed", message))
    return TARGET[role]


def _factor(unit: str, role: Role, column: str, table: Table) -> float:
    """Multiplier of a unit; a refusal names the file and the column."""
    try:
        return factor(unit, role)
    except RecordingError as error:
        raise RecordingError(f"{table.name}, column {column!r}: {error}") from error


def _run_column(
    table: Table, values: dict[Role, Column], axis_s: FloatArray | None, findings: list[Finding]
) -> tuple[Column | None, tuple[int, ...]]:
    """Column that numbers the runs, and the rows, or instants of an axis, at which its number changes."""
    used = {id(column) for value in values.values() for column in value.made_of}
    for column in table.columns:
        if _words(column.name) not in _RUN or id(column) in used:
            continue
        rows = np.flatnonzero(np.isfinite(column.values))
        change = np.flatnonzero(np.diff(column.values[rows])) + 1
        numbers = column.values[rows[[0, *change.tolist()]]] if rows.size else np.zeros(0)
        shortest = np.min(np.diff([0, *change.tolist(), rows.size]))
        # A number that comes again, or for a few rows only, counts something else.
        if change.size and np.unique(numbers).size == numbers.size and shortest >= limits.MIN_SAMPLES:
            findings.append(Finding("run-column", "assumed", f"column {column.label!r} numbers {numbers.size} runs"))
            at = rows[change]
            if column.clock_s is not None and axis_s is not None:
                at = np.searchsorted(axis_s, column.clock_s[at])
            return column, tuple(at.tolist())
    return None, ()
