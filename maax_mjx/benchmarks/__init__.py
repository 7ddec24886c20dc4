"""Benchmarks: one module each, with a `COMMAND` that measures and writes JSON."""

BENCHMARKS = (
    "breakdown",
    "devices",
    "engines",
    "fidelity",
    "first_step",
    "grabs",
    "gradients",
    "hostile",
    "layouts",
    "learners",
    "learning",
    "load",
    "memory",
    "objects",
    "outer",
    "plots",
    "profile",
    "sampling",
    "scaling",
    "soak",
    "stages",
    "step",
    "train_speed",
    "updates",
)
"""Names of the modules that run as `maax-mjx bench NAME`; the others are what these share."""
