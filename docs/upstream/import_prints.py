"""`import mujoco.mjx` prints to stdout where Warp is not installed."""

import contextlib
import io
import sys

sys.modules["warp"] = None  # as if it were not installed
printed = io.StringIO()
with contextlib.redirect_stdout(printed):
    import mujoco.mjx  # noqa: F401
print("printed:", printed.getvalue().splitlines())
assert printed.getvalue(), "it is silent now"
