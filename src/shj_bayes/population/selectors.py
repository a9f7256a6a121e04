"""What may be compared: two sets by name, or two kinds of sets (coated, corroded, a coverage) stratum by stratum."""

import re
from collections.abc import Callable
from dataclasses import replace

from shj_bayes.errors import PopulationError
from shj_bayes.population.device import Tags
from shj_bayes.population.posterior import PopulationResult

Kind = tuple[Callable[[Tags], bool], Callable[[Tags], Tags]]
"""Which sets belong, and their tags without what is compared: sets with the same rest form a stratum."""
Stratum = tuple[list[int], list[int]]
"""Positions of the sets on both sides; all else is alike."""
BARE = {"", "none", "bare", "uncoated", "plain", "blasted", "machined", "polished", "mill scale", "as rolled"}
"""Words for a surface without a coating; ``sweep blasted`` and the like are too."""
WORDS = "coated, uncoated, corroded, uncorroded, or a coverage such as '70 %'"


def strata_of(result: PopulationResult, first: str, second: str) -> tuple[str, str, tuple[Stratum, ...]]:
    """Find the sets to compare: two sets by name, or two kinds of sets.

    Gives both sides by name, and the positions of their sets, stratum by stratum; all else is alike within a stratum.
    `PopulationError` if a set is unknown, both are the same, or no two sets differ in what is compared alone.
    """
    kinds = _kind(result, first), _kind(result, second)
    if kinds[0] is None and kinds[1] is None:
        i, j = result.index(first), result.index(second)
        if i == j:
            raise PopulationError(f"a set cannot be compared with itself ({first!r}); name two different sets")
        return result.set_names[i], result.set_names[j], (([i], [j]),)
    if kinds[0] is None or kinds[1] is None:
        raise PopulationError(f"compare two sets, or two kinds of sets ({WORDS}); got {first!r} and {second!r}")
    sides: list[dict[Tags, list[int]]] = [{}, {}]
    for i, group in enumerate(result.sets):
        for side, kind in zip(sides, kinds, strict=True):
            assert kind is not None
            if kind[0](group.tags):
                side.setdefault(kind[1](group.tags), []).append(i)
    found = tuple((a, sides[1][rest]) for rest, a in sides[0].items() if rest in sides[1])
    if not found or any(set(a) & set(b) for a, b in found):
        raise PopulationError(
            f"no two sets differ in '{first}' against '{second}' alone; the tags of the sets (material, coating, "
            "coverage_percent, corroded in the manifest) say what each is; or name two sets: "
            f"{', '.join(map(repr, result.set_names[:12]))}"
        )
    return first, second, found


def is_bare(coating: str) -> bool:
    """Whether a coating is none: bare steel, whatever was done to its surface."""
    words = re.sub(r"[\s_-]+", " ", coating.strip().casefold())
    return words in BARE or words.endswith(" blasted")


def members(result: PopulationResult, strata: tuple[Stratum, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the sets on both sides of a comparison, in the order of the population."""
    first, second = (
        tuple(result.set_names[i] for i in sorted({i for stratum in strata for i in stratum[side]})) for side in (0, 1)
    )
    return first, second


def _kind(result: PopulationResult, words: str) -> Kind | None:
    """Read a kind of sets from words; None for the name of a set, which goes first."""
    folded = words.strip().casefold()
    if folded in {name.casefold() for name in result.set_names}:
        return None
    if folded in ("corroded", "uncorroded", "not corroded"):
        wanted = folded == "corroded"
        return (lambda tags: tags.corroded is wanted), (lambda tags: replace(tags, corroded=False))
    if folded in ("coated", "uncoated", "not coated"):
        bare = folded != "coated"
        return (lambda tags: is_bare(tags.coating) is bare), (
            lambda tags: replace(tags, coating="", coverage_percent=None)
        )
    match = re.fullmatch(r"(?:coverage\s*)?(\d+(?:\.\d+)?)\s*%?", folded)
    if match:
        percent = float(match[1])
        return (lambda tags: tags.coverage_percent == percent), (lambda tags: replace(tags, coverage_percent=None))
    return None
