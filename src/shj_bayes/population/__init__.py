"""Device to device: what a new device of a set will be like, and how two sets compare.

quantities -> device -> hierarchy (on grid) -> predict -> compare -> results.
"""
