"""Words of ``diagnosis.json`` that are read without what diagnoses: layouts, written and read, verdicts, bands."""

from enum import StrEnum

SCHEMA = "shj-bayes/diagnosis/2"
READ = (SCHEMA, "shj-bayes/diagnosis/1")
SIGMA_90 = 1.6449  # standard deviations to either side that hold 90 % of a normal law


class Verdict(StrEnum):
    """What a diagnosis found."""

    ADEQUATE = "adequate"
    NAMED = "named"
    FAMILY = "family"
    UNKNOWN = "unknown"


NOTHING_MISSING = "nothing of a size that matters"  # words for a set without classes
