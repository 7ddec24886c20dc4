"""Choice of the engine that steps an environment."""

from __future__ import annotations

from importlib.util import find_spec

import jax
import mujoco

from maax_mjx.common.errors import MissingLibraryError
from maax_mjx.common.runtime import import_mjx
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.fields import Overlay

IMPLS = ("auto", "c", "jax", "warp")


def check_impl(impl: str) -> str:
    """Refuses an unknown engine, or one whose library is missing, without touching a JAX backend.

    Raises:
        ValueError: unknown.
        MissingLibraryError: "warp" where it is not installed.
    """
    if impl not in IMPLS:
        raise ValueError(f"impl: got {impl!r}; takes one of {IMPLS}")
    if impl == "warp" and not warp_is_installed():
        raise MissingLibraryError(
            'impl: got \'warp\' and warp-lang is not installed; the extra "cuda" brings it, pip install -e ".[cuda]" '
            "in a clone of maax_mjx"
        )
    return impl


def make_engine(
    impl: str, model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int, n_equalities: int
) -> Engine:
    """Makes the engine for `model`, with room for so many contacts of a world, and equalities active at once.

    "auto" is `warp` on NVIDIA where it is installed, `jax` on other accelerators, and `c` where JAX has only a CPU.

    Raises:
        ValueError: `c` where JAX computes on an accelerator, whose memory its host code does not see.
        RuntimeError: `jax` or `warp` where the installed MJX or Warp is not one that `mjx_internals` knows.
    """
    impl = check_impl(impl)
    if impl == "auto":
        impl = best_impl()
    if impl == "c" and jax.default_backend() != "cpu":
        raise ValueError(
            f"impl: got 'c' where JAX computes on {jax.default_backend()}; takes 'warp' or 'jax' there, "
            "or set JAX_PLATFORMS=cpu before JAX starts"
        )
    import_mjx()
    if impl == "c":
        from maax_mjx.physics.c_engine import CEngine

        return CEngine(model, overlay)
    if impl == "warp":
        from maax_mjx.physics.warp_engine import WarpEngine

        return WarpEngine(model, overlay, contacts_per_world, n_equalities)
    from maax_mjx.physics.jax_engine import JaxEngine

    return JaxEngine(model, overlay, contacts_per_world)


def warp_is_installed() -> bool:
    """Tells whether the library of the warp engine is installed, without importing it."""
    return find_spec("warp") is not None


def best_impl() -> str:
    """Name of the engine that "auto" is on this machine."""
    if jax.default_backend() == "cpu":
        return "c"
    nvidia = "cuda" in jax.local_devices()[0].client.platform_version.lower()
    return "warp" if nvidia and warp_is_installed() else "jax"
