"""From devices to numbers for design, each with unit, clause, formula, inputs, n and what it is for.

specimen (a device as it was tested, with its models) and asked (the displacement history) -> virtual_test (what the
models do in it) -> quantities, trial (beside what was measured) -> population -> bands and codes (one file each, found
from the tree) -> sheet, which agreement checks -> files, loops_file; bounds -> opensees, link_elements. diagnosed
brings in what was found missing.
"""

from shj_bayes.margins.bounds import Bound, bounds
from shj_bayes.margins.diagnosed import Diagnosed, find_diagnosis
from shj_bayes.margins.files import to_json, to_table, write_margins
from shj_bayes.margins.loops_file import loops, write_loops
from shj_bayes.margins.request import Request
from shj_bayes.margins.row import Margin
from shj_bayes.margins.sheet import Sheet, margins, pool
from shj_bayes.margins.specimen import Specimen, read_specimen, specimens_of_table
from shj_bayes.margins.trial import Trial, try_all

__all__ = [
    "Bound",
    "Diagnosed",
    "Margin",
    "Request",
    "Sheet",
    "Specimen",
    "Trial",
    "bounds",
    "find_diagnosis",
    "loops",
    "margins",
    "pool",
    "read_specimen",
    "specimens_of_table",
    "to_json",
    "to_table",
    "try_all",
    "write_loops",
    "write_margins",
]
