"""Which engine steps an environment."""

from __future__ import annotations

import jax
import mujoco

from maax_mjx.physics.engine import Engine
from maax_mjx.physics.world import Overlay

IMPLS = ("auto", "c", "jax")


def check_impl(impl: str) -> str:
    """Refuses an unknown engine, without touching a JAX backend.

    Raises:
        ValueError: unknown, or not available yet.
    """
    if impl == "warp":
        raise ValueError(f"impl: 'warp' (MJX-Warp) is not part of this version yet; takes one of {IMPLS}")
    if impl not in IMPLS:
        raise ValueError(f"impl: got {impl!r}; takes one of {IMPLS}")
    return impl


def make_engine(impl: str, model: mujoco.MjModel, overlay: Overlay) -> Engine:
    """The engine for `model`. "auto" is `c` where JAX has only a CPU, and `jax` on accelerators."""
    impl = check_impl(impl)
    if impl == "auto":
        impl = "c" if jax.default_backend() == "cpu" else "jax"
    if impl == "c":
        from maax_mjx.physics.c_engine import CEngine

        return CEngine(model, overlay)
    from maax_mjx.physics.jax_engine import JaxEngine

    return JaxEngine(model, overlay)
