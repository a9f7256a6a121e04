"""What the paper says of its tables, computed from them."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.population.compare import permutation_test
from shj_bayes.population.device import DEVICE_TABLES, Claim, Holding, PublishedRow, published_rows
from shj_validation.contrasts import two_way_anova

COATINGS = ("Sweep blasted", "Alkyd 70", "Alkyd 100", "Zinc 70", "Zinc 100")
PAIRS = ((4, 5), (6, 7))


def losses_percent(rows: Sequence[PublishedRow]) -> FloatArray:
    """Loss of sliding force from the first to the second run, per cent of the first."""
    return np.round(100.0 * (1.0 - np.array([row.ratio for row in rows])), 9)


def coated_table(value: Callable[[PublishedRow], float], rows: Sequence[PublishedRow]) -> FloatArray:
    """Return one number per coated device, shape (coating, corroded no/yes, replicate)."""
    found = {(row.table, row.row): value(row) for row in rows}
    return np.array([[[found[table, coating] for table in pair] for pair in PAIRS] for coating in COATINGS])


def subsets_that_match(rows: Sequence[PublishedRow]) -> tuple[tuple[int, ...], ...]:
    """Find the tables in which 6 rows lose 10 %, 5 lose 30 % and 2 lose 50 to 60 %, rounded to 10 %."""
    matching = []
    tenth = np.round(losses_percent(rows), -1)
    table = np.array([row.table for row in rows])
    for size in range(1, len(DEVICE_TABLES) + 1):
        for chosen in itertools.combinations(DEVICE_TABLES, size):
            held = tenth[np.isin(table, chosen)]
            if [int(np.sum(m)) for m in (held == 10, held == 30, held >= 50)] == [6, 5, 2] and held.max() <= 60:
                matching.append(chosen)
    return tuple(matching)


def degradation_counts(rows: Sequence[PublishedRow]) -> tuple[int, ...]:
    """Rows that lose up to 10, 10 to 20, 20 to 30, 30 to 40, 40 to 50, 50 to 60 and over 60 per cent."""
    edges = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    return tuple(np.bincount(np.searchsorted(edges, losses_percent(rows), side="left"), minlength=7).tolist())


def pair_spread(
    value: Callable[[PublishedRow], float], rows: Sequence[PublishedRow], which: int | None = None
) -> float:
    """Pooled standard deviation of the logarithm within pairs of nominally identical devices.

    Parameters
    ----------
    value : callable
        Positive number of a row.
    rows : sequence of PublishedRow
        Published rows.
    which : {None, 0, 1}
        Both pairings, only Tables 4 and 5, or only Tables 6 and 7.

    Returns
    -------
    float
        Root of the mean squared difference over 2.
    """
    logs = np.log(coated_table(value, rows))
    difference = logs[..., 0] - logs[..., 1]
    return float(np.sqrt(np.mean((difference if which is None else difference[:, which]) ** 2) / 2.0))


def _degradation(rows: Sequence[PublishedRow]) -> list[Claim]:
    loss = losses_percent(rows)
    table = np.array([row.table for row in rows])
    means = tuple(float(loss[table == t].mean()) for t in DEVICE_TABLES)
    within = int(np.sum((loss >= 20) & (loss <= 30)))
    below = int(np.sum(loss <= 30))
    matching = subsets_that_match(rows)
    worst = rows[int(np.argmax(loss))]
    return [
        Claim(
            "most_20_to_30",
            "the degradation of most connections was about 20 to 30 %",
            Holding.NO,
            {"rows_20_to_30": within, "rows": len(rows), "counts": degradation_counts(rows)},
            f"{within} of {len(rows)} devices lost between 20 and 30 %; they spread evenly from 8 to 40 %.",
        ),
        Claim(
            "most_below_30",
            "most cases do not exceed 30 %",
            Holding.PARTLY,
            {"rows_up_to_30": below, "rows_above_30": len(rows) - below, "rows": len(rows)},
            f"{below} of {len(rows)} devices lost 30 % or less; {len(rows) - below} lost more.",
        ),
        Claim(
            "counts_of_figure_10",
            "6 cases of 10 %, 5 of 30 %, and 2 that reach 50 to 60 %",
            Holding.PARTLY,
            {"tables": matching[0] if matching else (), "matching_choices": len(matching)},
            "True, once rounded to 10 %, only of Tables "
            + " and ".join(", ".join(str(t) for t in chosen) for chosen in matching)
            + f" taken alone; the replicates of Tables 5 and 7 and the worst case ({loss.max():.0f} %) are left out.",
        ),
        Claim(
            "up_to_60",
            "degradation up to 60 % for some coatings",
            Holding.NO,
            {"worst_percent": float(loss.max()), "table": worst.table},
            f"{worst.row} of Table {worst.table} lost {loss.max():.0f} %.",
        ),
        Claim(
            "greater_when_coated",
            "degradation was greater for coated than for uncoated devices",
            Holding.PARTLY,
            {"mean_percent_per_table": means},
            f"Mean loss {means[0]:.1f} % uncoated, {means[1]:.1f} and {means[2]:.1f} % coated, but only "
            f"{means[3]:.1f} and {means[4]:.1f} % coated and corroded; the 100 % coverage devices "
            "drive the difference.",
        ),
    ]


def _corrosion(rows: Sequence[PublishedRow]) -> Claim:
    force = coated_table(lambda row: row.values["Fy", 1], rows)
    log = np.log(force)
    change = 100.0 * (np.exp(log[:, 1].mean(axis=1) - log[:, 0].mean(axis=1)) - 1.0)
    mean_change = 100.0 * float(np.exp(np.mean(log[:, 1] - log[:, 0])) - 1.0)
    (exact, least, arrangements), (plain, *_) = (
        permutation_test([(row[1], row[0]) for row in x]) for x in (log, force)
    )
    variance = two_way_anova(log)
    return Claim(
        "corrosion_no_effect",
        "corrosion had no notable effect beyond the variation between devices",
        Holding.OPEN,
        {
            "change_percent_per_coating": tuple(change.tolist()),
            "mean_change_percent": mean_change,
            "permutation_p_log": exact,
            "permutation_p_kN": plain,
            "anova_f_log": variance.f_columns,
            "anova_p_log": variance.p_columns,
            "arrangements": arrangements,
            "permutation_least": least,
        },
        f"The first-run sliding force changes by {', '.join(f'{c:+.0f}' for c in change)} % ({', '.join(COATINGS)}), "
        f"{mean_change:+.0f} % on average; exact stratified permutation p = {exact:.3f} on the logarithm "
        f"and {plain:.3f} in kN (least attainable {least:.4f}). "
        "Two devices per coating cannot exclude a loss of a quarter, nor prove one; 'no notable effect' is not what "
        "these tables show.",
    )


def _coating(rows: Sequence[PublishedRow]) -> Claim:
    force = two_way_anova(np.log(coated_table(lambda row: row.values["Fy", 1], rows)))
    ratio = two_way_anova(np.log(coated_table(lambda row: row.ratio, rows)))
    plain = two_way_anova(coated_table(lambda row: row.ratio, rows))
    gamma = two_way_anova(coated_table(lambda row: row.gamma, rows))
    return Claim(
        "coating_matters",
        "coatings differ in force, degradation and speed dependence",
        Holding.OPEN,
        {
            "f_force_log": force.f_rows,
            "p_force_log": force.p_rows,
            "f_ratio_log": ratio.f_rows,
            "p_ratio_log": ratio.p_rows,
            "p_ratio_plain": plain.p_rows,
            "f_gamma": gamma.f_rows,
            "p_gamma": gamma.p_rows,
        },
        f"Between coatings p = {force.p_rows:.2f} for the sliding force, {ratio.p_rows:.2f} for the ratio (logarithms; "
        f"{plain.p_rows:.2f} for the ratio itself) and {gamma.p_rows:.2f} for 1/dep. The answer for the ratio depends "
        "on the scale, which is what two devices per coating amount to.",
    )


def _velocity(rows: Sequence[PublishedRow]) -> list[Claim]:
    negative = tuple(sum(row.gamma < 0 for row in rows if row.table == t) for t in DEVICE_TABLES)
    alkyd = {row.table: row.gamma for row in rows if row.row == "Alkyd 100"}
    same = sum(all(row.values[q, 1] == row.values[q, 2] for q in ("K", "beta", "dep")) for row in rows)
    dep = {(row.table, row.row): row.values["dep", 1] for row in rows}
    zinc = dep[6, "Zinc 70"] + dep[7, "Zinc 70"]
    return [
        Claim(
            "coatings_turn_negative",
            "coatings make the speed coefficient negative, except Alkyd 100 %",
            Holding.PARTLY,
            {"negative_per_table": negative, "alkyd_100": tuple(alkyd[t] for t in (4, 5, 6, 7))},
            f"Negative in {negative[1]} of 5 devices of Table 4, {negative[2]} of 5 of Table 5, {negative[3]} of 5 of "
            f"Table 6 and {negative[4]} of 5 of Table 7. Alkyd 100 % has {alkyd[4]:+.3f} and {alkyd[5]:+.3f} s/mm in "
            "two nominally identical devices; with one peak speed, position and speed cannot be told apart.",
        ),
        Claim(
            "unchanged_between_runs",
            "K, beta and dep do not change between runs, which validates the model",
            Holding.NO,
            {"rows_identical": same, "rows": len(rows)},
            f"K, beta and dep are identical to the digit in {same} of {len(rows)} devices: "
            "they were held, not found again.",
        ),
        Claim(
            "average_of_dep",
            "the two last values of Figure 9 equal zero, and zero means the strongest dependence",
            Holding.NO,
            {"sum_of_dep": zinc, "mean_gamma": 0.5 * (1 / dep[6, "Zinc 70"] + 1 / dep[7, "Zinc 70"])},
            "The zeros are the mean of dep = +90 and -90 mm/s; the mean of 1/dep is zero as well, "
            "which is no dependence.",
        ),
    ]


def _replicates(rows: Sequence[PublishedRow]) -> Claim:
    force = coated_table(lambda row: row.values["Fy", 1], rows)
    identical = int(np.sum(force[..., 0] == force[..., 1]))
    spread = {
        "K": pair_spread(lambda row: row.values["K", 1], rows),
        "Fy": pair_spread(lambda row: row.values["Fy", 1], rows),
        "Fy_second": pair_spread(lambda row: row.values["Fy", 2], rows),
        "ratio": pair_spread(lambda row: row.ratio, rows),
    }
    return Claim(
        "slight_differences",
        "the second set of tests confirmed the first with slight differences",
        Holding.NO,
        {**{f"sd_log_{k}": v for k, v in spread.items()}, "pairs_identical_Fy": identical, "pairs": 10},
        f"{identical} of 10 pairs print the same first-run force, the others differ so much that the standard "
        f"deviation between identical devices is {100 * spread['Fy']:.0f} % overall (logarithm; second run "
        f"{100 * spread['Fy_second']:.0f} %). One spread for all sets describes neither.",
    )


def paper_claims() -> tuple[Claim, ...]:
    """Every claim checked, with the numbers, from the shipped tables.

    Returns
    -------
    tuple of Claim
    """
    rows = published_rows()
    return (*_degradation(rows), _corrosion(rows), _coating(rows), *_velocity(rows), _replicates(rows))
