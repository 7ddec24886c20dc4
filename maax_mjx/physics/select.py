"""Choice of the engine that steps an environment."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

import jax
import mujoco

from maax_mjx.common.checks import check_choice, check_new_name, described
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.common.runtime import import_mjx
from maax_mjx.physics.engine import Engine
from maax_mjx.physics.fields import Overlay

AUTO = "auto"
MakeEngine = Callable[[mujoco.MjModel, Overlay, int, int], Engine]
"""`(model, overlay, contacts_per_world, n_equalities) -> Engine`: with room for that many contacts of one world, and
that many equalities active at once."""


def impls() -> tuple[str, ...]:
    """The names that `impl` takes: "auto", and those of all engines."""
    return (AUTO, *sorted(_ENGINES))


def register_engine(name: str, make: MakeEngine) -> None:
    """Gives an engine of your own a name, which `impl` then takes everywhere.

    Example:
        ```python
        class Halved(CEngine):  # from maax_mjx.physics.c_engine
            def step(self, fields, data, n_frames):
                return super().step(fields, data.replace(ctrl=data.ctrl / 2), n_frames)

        maax.register_engine("halved", lambda model, overlay, contacts, equalities: Halved(model, overlay))
        env = maax.make("hide_and_seek", impl="halved")
        ```

    Args:
        name: a new one.
        make: makes the engine when an environment first needs it; see `MakeEngine`.

    Raises:
        ValueError: a name that is taken, or something that cannot be called.
    """
    check_new_name(name, impls())
    if not callable(make):
        raise ValueError(f"make: got {make!r}; takes a function (model, overlay, contacts, equalities) -> Engine")
    _ENGINES[name] = make


def check_impl(impl: str) -> str:
    """Refuses an unknown engine, or one whose library is missing, without touching a JAX backend.

    Raises:
        ValueError: an unknown name, with the nearest ones.
        MissingLibraryError: "warp" where it is not installed.
    """
    check_choice("impl", impl, impls())
    if impl == "warp" and not warp_is_installed():
        raise MissingLibraryError(f"impl: got 'warp' and warp-lang is not installed; {brought_by('cuda')}")
    return impl


def make_engine(
    impl: str, model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int, n_equalities: int
) -> Engine:
    """Makes the engine for a model.

    "auto" is `warp` on NVIDIA where it is installed, `jax` on other accelerators, and `c` where JAX has only a CPU.

    Args:
        impl: the engine's name.
        model: the compiled model.
        overlay: the rows of its fields in which worlds differ.
        contacts_per_world: contact points of one world that the engine makes room for.
        n_equalities: equalities that can be active at once.

    Raises:
        ValueError: `c` where JAX computes on an accelerator, whose memory its host code does not see; or a registered
            engine that is none.
        MissingLibraryError: `jax` or `warp` where the installed MJX or Warp is not one that `mjx_internals` knows.
    """
    impl = best_impl() if check_impl(impl) == AUTO else impl
    engine = _ENGINES[impl](model, overlay, contacts_per_world, n_equalities)
    if not isinstance(engine, Engine):
        raise ValueError(f"impl: the engine registered as {impl!r} is {described(engine)}; takes an Engine")
    return engine


def _make_c(model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int, n_equalities: int) -> Engine:
    if jax.default_backend() != "cpu":
        raise ValueError(
            f"impl: got 'c' where JAX computes on {jax.default_backend()}; takes 'warp' or 'jax' there, "
            "or set JAX_PLATFORMS=cpu before JAX starts"
        )
    from maax_mjx.physics.c_engine import CEngine

    return CEngine(model, overlay)


def _make_jax(model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int, n_equalities: int) -> Engine:
    import_mjx()
    from maax_mjx.physics.jax_engine import JaxEngine

    return JaxEngine(model, overlay, contacts_per_world)


def _make_warp(model: mujoco.MjModel, overlay: Overlay, contacts_per_world: int, n_equalities: int) -> Engine:
    import_mjx()
    from maax_mjx.physics.warp_engine import WarpEngine

    return WarpEngine(model, overlay, contacts_per_world, n_equalities)


# Each imports its engine when it is called: MJX and Warp take seconds.
_ENGINES: dict[str, MakeEngine] = {"c": _make_c, "jax": _make_jax, "warp": _make_warp}


def warp_is_installed() -> bool:
    """Tells whether the library of the warp engine is installed, without importing it."""
    return find_spec("warp") is not None


def best_impl() -> str:
    """Name of the engine that "auto" is on this machine."""
    if jax.default_backend() == "cpu":
        return "c"
    nvidia = "cuda" in jax.local_devices()[0].client.platform_version.lower()
    return "warp" if nvidia and warp_is_installed() else "jax"
