"""Independent simulators of a friction connection: state equations on a fine grid, none of the catalogue's formulas."""
