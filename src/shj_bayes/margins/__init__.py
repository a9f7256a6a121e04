"""From devices to numbers for design, each with unit, clause, formula, inputs, n and what it is for.

specimen (a device as it was tested, with its models) and asked (the displacement history) -> virtual_test (what the
models do in it) -> quantities, trial (beside what was measured) -> population -> bands and codes (one file each, found
from the tree) -> sheet, which agreement checks -> files, loops_file; bounds -> opensees, link_elements. diagnosed
brings in what was found missing.
"""
