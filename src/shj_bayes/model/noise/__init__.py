"""Measurement noise: one model is one file here; `filter` holds the likelihood that all of them share."""
