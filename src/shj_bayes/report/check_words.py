"""What a recording can tell before it is fitted, in words: `Identifiability` as rows and sentences."""

from shj_bayes.model.device import meaning_of
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.planning.identifiability import Doubt, Identifiability
from shj_bayes.report import words
from shj_bayes.report.words import ForceUnit, unit_for

DOUBTS = {
    Doubt.NEVER_SLIDES: (
        "No half-cycle slides fully, so that nothing is seen of the sliding force: its value would be that of the "
        "prior. Test with a larger amplitude, or look whether displacement and force are exchanged."
    ),
    Doubt.NO_TOP: (
        "No parameters of the law describe these recordings. Look at the loops: units, signs, and whether the columns "
        "are those of displacement and force."
    ),
}
BASE_LAW = "base law"
MOST_CONFUSIONS = 6


def unit_of(said: Identifiability) -> ForceUnit:
    """Choose the unit of forces by the sliding force."""
    return unit_for(next((row.mean for row in said.parameters if row.name == "Fy"), None))


def headline(said: Identifiability) -> str:
    """Say in a sentence at which force the device slides, and how stiff it is before."""
    unit, rows = unit_of(said), {row.name: row for row in said.parameters}
    K, Fy = rows["K"], rows["Fy"]
    at = f", at about {words.short(said.one_speed_mm_s)} mm/s" if said.one_speed_mm_s is not None else ""
    least = "" if said.least_kN is None else unit.shown(said.least_kN)
    slides = f"Slides at {least} or more as tested{at} (the smallest plateau of the last run). " if least else ""
    name, factor = unit.of(K.unit)
    stiff = f"{words.short(factor * K.mean)} {name}"
    return f"{slides}Fy, the force at standstill in the first run: {unit.shown(Fy.mean)}; initial stiffness: {stiff}."


def parameter_rows(said: Identifiability) -> list[dict[str, str]]:
    """Give the rows of a table: what each parameter is, its value, its width after and before the test."""
    unit, out = unit_of(said), []
    for row in said.parameters:
        name, factor = unit.of(row.unit)
        low, high, sd = factor * row.q05, factor * row.q95, factor * row.sd
        out.append(
            {
                "name": row.name,
                "meaning": meaning_of(row.name).meaning,
                "unit": "" if name == "1" else name,
                "value": words.rounded(factor * row.mean, sd),
                "expected": f"{words.rounded(low, sd)} to {words.rounded(high, sd)}",
                "before": f"{words.short(factor * row.prior_q05)} to {words.short(factor * row.prior_q95)}",
                "narrowed": f"{100.0 * row.narrowed:.2g} %",
            }
        )
    return out


def doubt_lines(said: Identifiability) -> list[str]:
    """Say why a fit would say nothing of the device; empty where it would."""
    return [DOUBTS[doubt] for doubt in said.doubts]


def check_lines(said: Identifiability, family: str) -> list[str]:
    """Say what to mind before a fit; `family` is that of the priors."""
    unit, out = unit_of(said), []
    units = {row.name: unit.of(row.unit) for row in said.parameters}
    out += [words.remark(one, *units[one.parameter], family=family) for one in said.remarks]
    if said.one_speed_mm_s is not None:
        out.append(words.alias_words(said.one_speed_mm_s))
    if said.few_readings:
        out.append(
            f"About {said.readings_of_knee:.0f} readings of a half-cycle lie on the way from one plateau to the other: "
            "K and beta rest on few of them. Record at a higher rate, or test more slowly."
        )
    if said.least_kN is not None and said.least_sd_kN is not None:
        least, sd = unit.factor * said.least_kN, unit.factor * said.least_sd_kN
        out.append(
            f"The smallest plateau force of the last run, on which displacements rest, is "
            f"{words.rounded(least, sd)} {unit.name}, and will be known to about ± {1.645 * sd:.2g} {unit.name} (90 %)."
        )
    return out


def confusion_rows(said: Identifiability) -> list[dict[str, str]]:
    """Give what this displacement history cannot tell apart, each with the cheapest test that would."""
    known, out = catalogue(), []
    for one in said.confusions[:MOST_CONFUSIONS]:
        first, second = ("the base law" if name == BASE_LAW else known[name].title for name in one.pair)
        test = next(known[name].next_test for name in one.pair if name in known)
        alike = f"{100.0 * abs(one.correlation):.0f} %"
        out.append({"first": first, "second": second, "alike": alike, "test": test})
    return out
