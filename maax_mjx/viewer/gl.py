"""An OpenGL context without a window, from whichever library there is."""

from __future__ import annotations

import ctypes
import importlib
import os
import platform
from typing import Any

from maax_mjx.physics import MissingLibraryError

LIBRARIES = {"egl": "libEGL.so.1", "osmesa": "libOSMesa.so.8"}
OFF = ("disable", "disabled", "off", "false", "0")


def open_context(width: int, height: int) -> Any:
    """A current OpenGL context, to be freed with `free()`.

    What MUJOCO_GL says, or on Linux EGL or else OSMesa, which need no screen; elsewhere what MuJoCo takes there. Not
    by MuJoCo's own choice, which it makes while it is imported, and on Linux for a window.

    Raises:
        MissingLibraryError: there is none; the message says what brings one.
    """
    chosen = os.environ.get("MUJOCO_GL", "").lower().strip()
    if chosen in OFF:
        raise MissingLibraryError(f"view: got '3d' and MUJOCO_GL={chosen} in the environment; unset it, or {PLAN}")
    tried = []
    for name in _backends(chosen):
        context, error = _try(name, width, height)
        if context is not None:
            return context
        tried.append(f"{name}: {error}")
    raise MissingLibraryError(
        f"view: got '3d' and there is no OpenGL ({'; '.join(tried)}); on Debian and Ubuntu `apt-get install libegl1` "
        "(with a GPU's driver or libgl1-mesa-dri) or `apt-get install libosmesa6` (on the CPU) brings it, and "
        f"MUJOCO_GL=egl or MUJOCO_GL=osmesa in the environment chooses; or {PLAN}"
    )


PLAN = "take view='plan', which needs none"


def backends() -> dict[str, str]:
    """What `open_context` tries: "works" for the library that it takes, for those before it why they do not."""
    found: dict[str, str] = {}
    # A process can try no second library after one that works.
    for name in _backends(os.environ.get("MUJOCO_GL", "").lower().strip()):
        context, error = _try(name, 16, 16)
        found[name] = error or "works"
        if context is not None:
            context.free()
            break
    return found


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
    if chosen in ("egl", "osmesa", "cgl"):
        return [chosen]
    if chosen in ("glfw", "glx", "wgl"):
        return ["glfw"]
    if system == "Linux":
        return [*LIBRARIES, *(["glfw"] if os.environ.get("DISPLAY") else [])]
    return ["cgl", "glfw"] if system == "Darwin" else ["glfw"]
