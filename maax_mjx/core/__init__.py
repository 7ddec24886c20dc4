"""Environments, how modules make one, and the state that they step."""
