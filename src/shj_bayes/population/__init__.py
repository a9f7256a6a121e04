"""Device to device: what a new device of a set will be like, and how two sets compare.

quantities -> readings (off a force), device -> hierarchy (on grid) -> predict -> compare -> results.
"""
