"""Design codes, one file each; `catalogue` finds them in the tree."""
