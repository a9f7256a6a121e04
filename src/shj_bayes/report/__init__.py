"""Numbers to pages: one self-contained page per device, one per campaign and one for the published tables.

data (files of a fit) -> numbers, residuals (arrays) -> figures (draw only) -> words -> templates.
"""
