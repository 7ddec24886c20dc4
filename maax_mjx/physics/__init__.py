"""The engines behind one interface: the overlay of a world's fields on the model, stepping, capacities."""

from maax_mjx.physics.data import Data
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.fields import Fields, Overlay, model_fields, overlaid_model, union
from maax_mjx.physics.gradients import NotDifferentiableError
from maax_mjx.physics.select import MissingLibraryError, best_impl, check_impl, impls, make_engine, register_engine

__all__ = [
    "Data",
    "Engine",
    "Fields",
    "MissingLibraryError",
    "NotDifferentiableError",
    "Overlay",
    "best_impl",
    "check_impl",
    "impls",
    "make_engine",
    "model_fields",
    "overlaid_model",
    "register_engine",
    "union",
]
