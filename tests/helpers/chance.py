"""What chance is taken to be able to do."""

P_MIN = 1e-7
"""The p-value below which a test of a distribution fails.

A run of all tests computes a few hundred p-values; right code fails in one of some ten thousand runs.
Draws from a wrong distribution give p-values far below it, for samples are of hundreds and more.
"""
