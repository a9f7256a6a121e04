"""Two sets of a finished campaign, or of the tables, held against each other; pages are not needed for it."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from shj_bayes._util.files import need_population, write_text
from shj_bayes.commands.design import MOST_DRAWN, read_devices
from shj_bayes.margins.curves import CurveContrast, compare_curves
from shj_bayes.population.compare import ROPE, Comparison, compare, members, strata_of
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.results import load_population
from shj_bayes.report.sets import curve_words, pairs


def compare_sets(folder: Path, set_a: str, set_b: str, rope_percent: float = 10.0) -> tuple[dict[str, Any], str]:
    """Compare two sets of a folder that `campaign` or `tables` wrote: for machines, and for people.

    `set_a` and `set_b` are names of sets, or kinds: coated, uncoated, corroded, uncorroded, "70 %". `rope_percent` is
    the half-width of the region of practical equivalence.
    """
    need_population(folder)
    result = load_population(folder)
    first, second = members(result, strata_of(result, set_a, set_b)[2])
    rope = rope_percent / 100.0
    comparison = compare(result, set_a, set_b, rope=rope)
    curves = compare_curves(result, read_devices(folder, result)[1], set_a, set_b, rope=rope)
    table = comparison.to_table()
    who = [
        f"{side}: {name}" + ("" if sets == (name,) else f" ({', '.join(sets)})")
        for side, name, sets in (("a", comparison.set_a, first), ("b", comparison.set_b, second))
    ]
    columns = (
        f"P(a > b): the typical device of a is above that of b; P(same): they differ by less than {rope_percent:g} %; "
        "new a > new b: a new device of a is above one of b; Welch, permuted, Holm: p-values; spread a/b: standard "
        "deviation between devices of a over that of b."
    )
    lines = [*who, *comparison_lines(comparison), "", columns, "", *(f"- {c.sentence}" for c in comparison.contrasts)]
    lines += [f"- {curve_words(curve)}" for curve in curves]
    rows = table.astype(object).where(table.notna(), None).to_dict(orient="records")
    record = {
        "schema": "shj-bayes/comparison/1",
        "set_a": comparison.set_a,
        "set_b": comparison.set_b,
        "members": {"a": list(first), "b": list(second)},
        "strata": comparison.strata,
        "multiplicity": comparison.multiplicity,
        "contrasts": rows,
        "curves": curve_records(curves),
    }
    return record, "\n".join([*lines, "", comparison.multiplicity])


def curve_records(curves: Sequence[CurveContrast]) -> list[dict[str, Any]]:
    """Comparisons of curves for machines."""
    return [{**asdict(curve), "sentence": curve_words(curve)} for curve in curves]


def curves_of_pairs(folder: Path, result: PopulationResult) -> tuple[CurveContrast, ...]:
    """Compare the curves of the pairs of sets that a campaign page names, and write ``comparison-curves.csv``.

    Nothing is said of more devices than `MOST_DRAWN`.
    """
    few = sum(len(group.devices) for group in result.sets) <= MOST_DRAWN
    chosen = pairs(result) if few else ()
    specimens = read_devices(folder, result)[1] if chosen else ()
    found = tuple(c for pair in chosen for c in compare_curves(result, specimens, *pair, rope=ROPE))
    path = folder / "comparison-curves.csv"
    path.unlink(missing_ok=True)
    if found:
        write_text(path, pd.DataFrame([row for curve in found for row in curve.rows()]).to_csv(index=False))
    return found


def comparison_lines(comparison: Comparison) -> list[str]:
    """Comparison as a table of text, one line per quantity."""
    words = ("a / b or a - b", "90 %", "P(a > b)", "P(same)", "new a > new b", "Welch", "permuted (least)", "Holm")
    rows = [["", *words, "spread a/b"]]
    for c in comparison.contrasts:
        tests = c.tests
        exact = f"{_p(tests.permutation_p)} ({_p(tests.permutation_least)})"
        rows.append(
            [
                c.quantity + ("" if c.unit == "1" else f" {c.unit}"),
                f"{c.q50:.3g}",
                f"{c.q05:.3g} to {c.q95:.3g}",
                *(f"{x:.2f}" for x in (c.probability_level, c.probability_rope, c.superiority)),
                _p(tests.welch_p),
                exact if tests.permutation_p is not None else "-",
                f"{_p(c.holm_p)} {c.holm_test}".strip(),
                f"{c.spread_factor[1]:.2f}",
            ]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    first, *others = widths
    return [
        "   ".join([f"  {head:{first}}", *(f"{cell:>{width}}" for cell, width in zip(cells, others, strict=True))])
        for head, *cells in rows
    ]


def _p(value: float | None) -> str:
    """Write a p-value; a dash where the test cannot be made."""
    if value is None:
        return "-"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.0e}"
