"""Environments: what they are, how modules make one, what a state is."""
