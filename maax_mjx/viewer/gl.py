"""An OpenGL context without a window, from whichever library there is."""

from __future__ import annotations

import ctypes
import importlib
import os
import platform
from typing import Any

from maax_mjx.physics import MissingLibraryError

LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
OWN, WINDOWS = ("egl", "osmesa", "cgl"), ("glfw", "glx", "wgl")
OFF = ("disable", "disabled", "off", "false", "0")


def open_context(width: int, height: int) -> Any:
    """A current OpenGL context, to be freed with `free()`.

    What MUJOCO_GL says, or on Linux EGL or else OSMesa, which need no screen; elsewhere what MuJoCo takes there. Not
    by MuJoCo's own choice, which it makes while it is imported, and on Linux for a window.

    Raises:
        MissingLibraryError: there is none; the message says what brings one.
        ValueError: MUJOCO_GL is none of MuJoCo's.
    """
    chosen = _chosen()
    if chosen in OFF:
        raise MissingLibraryError(f"view: got '3d' and MUJOCO_GL={chosen} in the environment; unset it, or {PLAN}")
    context, errors = _first(width, height)
    if context is not None:
        return context
    tried = "; ".join(f"{name}: {error}" for name, error in errors.items())
    raise MissingLibraryError(
        f"view: got '3d' and there is no OpenGL ({tried}); on Debian and Ubuntu `apt-get install libegl1` "
        "(with a GPU's driver or libgl1-mesa-dri) or `apt-get install libosmesa6` (on the CPU) brings it, and "
        f"MUJOCO_GL=egl or MUJOCO_GL=osmesa in the environment chooses; or {PLAN}"
    )


PLAN = "take view='plan', which needs none"


def backends() -> dict[str, str]:
    """The libraries that `open_context` tries: "works" for the one that it takes, a reason for those before it."""
    context, errors = _first(16, 16)
    if context is not None:
        context.free()
    return {name: error or "works" for name, error in errors.items()}


def _first(width: int, height: int) -> tuple[Any, dict[str, str]]:
    """The first context that works or None, and by library tried what went wrong; "" for the one that works."""
    errors: dict[str, str] = {}
    # A process can try no second library after one that works.
    for name in _backends(_chosen()):
        context, errors[name] = _try(name, width, height)
        if context is not None:
            return context, errors
    return None, errors


def _chosen() -> str:
    chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
    if chosen not in ("", *OWN, *WINDOWS, *OFF):
        raise ValueError(f"MUJOCO_GL: got {chosen!r} in the environment; takes one of {[*OWN, *WINDOWS, *OFF]}")
    return chosen


def _try(name: str, width: int, height: int) -> tuple[Any, str]:
    """A current context or None, and what went wrong."""
    try:
        if name in LIBRARIES:
            ctypes.CDLL(LIBRARIES[name])
        context = importlib.import_module(f"mujoco.{name}").GLContext(width, height)
        context.make_current()
        return context, ""
    except Exception as error:
        # The libraries fail in ways of their own: OSError, ImportError, AttributeError, GLError.
        return None, str(error).splitlines()[0] if str(error) else type(error).__name__


def _backends(chosen: str) -> list[str]:
    system = platform.system()
    if chosen in OWN:
        return [chosen]
    if chosen in WINDOWS:
        return ["glfw"]
    if system == "Linux":
        return [*LIBRARIES, *(["glfw"] if os.environ.get("DISPLAY") else [])]
    return ["cgl", "glfw"] if system == "Darwin" else ["glfw"]
