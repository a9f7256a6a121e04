"""Posteriors, design margins and missing physics for sliding steel friction connections.

The package is the method, one room per step:
recording -> model -> inference -> mismatch -> population -> report.
"""

__version__ = "0.1.0"
