"""Timings, as ratios within one run; results as JSON."""
