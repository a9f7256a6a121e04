"""From devices to numbers for design, each with unit, clause, formula, inputs, n and what it is for.

specimen (a device as it was tested, with its models) and history (the displacement asked for) -> virtual_test (what the
models do in it, beside what was measured) -> population -> basis (bounds of the force), spread and codes (found
from the tree) -> sheet, which checks itself -> files, export; curves compares sets along a coordinate.
"""
