"""Device to device: what a new device of a set will be like, and how two sets compare.

measurement -> device -> hierarchy -> correlation -> predict -> loops -> compare -> results, with the paper's tables in
published; tested is the range of strokes and speeds that may be spoken of.
"""
