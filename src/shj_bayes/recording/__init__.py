"""What came from the laboratory, in the order it happens: file -> table -> columns -> checks -> recording -> motion."""

from shj_bayes.recording.check import describe, to_dict
from shj_bayes.recording.columns import Channels, choose
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.protocol import Block, exact_motion, table_1
from shj_bayes.recording.quality import inspect, repair
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Finding, Recording, Source
from shj_bayes.recording.tables import Column, Table, read_table
from shj_bayes.recording.writer import write_csv

__all__ = [  # noqa: RUF022 - in the order of the pipeline
    "Finding",
    "Source",
    "Recording",
    "Motion",
    "Block",
    "table_1",
    "exact_motion",
    "Column",
    "Table",
    "read_table",
    "Channels",
    "choose",
    "repair",
    "inspect",
    "read",
    "motion_of",
    "describe",
    "to_dict",
    "write_csv",
]
