"""The tasks on which Baker et al. test what their agents learnt in hide-and-seek, one agent each."""
