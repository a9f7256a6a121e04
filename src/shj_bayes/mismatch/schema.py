"""Words of ``diagnosis.json`` that are read without what diagnoses: layouts, written and read, and verdicts."""

from enum import StrEnum

SCHEMA = "shj-bayes/diagnosis/2"
READ = (SCHEMA, "shj-bayes/diagnosis/1")


class Verdict(StrEnum):
    """What a diagnosis found."""

    ADEQUATE = "adequate"
    NAMED = "named"
    FAMILY = "family"
    UNKNOWN = "unknown"
