"""The engines behind one interface: the overlay of a world's fields on the model, stepping, capacities."""

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.faults import contain, find_fault
from maax_mjx.physics.gradients import NotDifferentiableError
from maax_mjx.physics.select import IMPLS, MissingLibraryError, best_impl, check_impl, make_engine
from maax_mjx.physics.world import Fields, Overlay, World, model_fields, overlaid_model, union

__all__ = [
    "IMPLS",
    "Data",
    "Engine",
    "Fields",
    "MissingLibraryError",
    "NotDifferentiableError",
    "Overlay",
    "World",
    "best_impl",
    "check_impl",
    "contain",
    "find_fault",
    "make_engine",
    "model_fields",
    "overlaid_model",
    "union",
]
