"""Numbers to pages: one self-contained page per device, one per campaign and one for the published tables.

numbers (arrays behind the figures) -> figures (draw only), words -> pages, by templates.
"""
