"""From a population to numbers for design, each with unit, clause, formula, inputs, n and what it is for.

sample, spread, delivered, parts -> bands and codes (one file each, found from the tree) -> sheet, which agreement
checks -> files, loops_file; bounds -> opensees, link_elements. The speed guard stands before them all; diagnosed
brings in what was found missing.
"""

from shj_bayes.margins.bounds import Bound, bounds
from shj_bayes.margins.diagnosed import Cases, Diagnosed, cases, find_diagnosis
from shj_bayes.margins.files import to_json, to_table, write_margins
from shj_bayes.margins.loops_file import loops, write_loops
from shj_bayes.margins.request import Request
from shj_bayes.margins.row import Margin
from shj_bayes.margins.sample import Motion
from shj_bayes.margins.sheet import Sheet, margins
from shj_bayes.margins.speed_guard import Guard

__all__ = [
    "Bound",
    "Cases",
    "Diagnosed",
    "Guard",
    "Margin",
    "Motion",
    "Request",
    "Sheet",
    "bounds",
    "cases",
    "find_diagnosis",
    "loops",
    "margins",
    "to_json",
    "to_table",
    "write_loops",
    "write_margins",
]
