"""Pictures and moving pictures of worlds: `maax.render`, `maax.video`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from maax_mjx.common.checks import check_choice, check_count, check_path, check_positive
from maax_mjx.common.errors import MissingLibraryError, brought_by
from maax_mjx.common.progress import progress
from maax_mjx.core.env import Environment
from maax_mjx.viewer.between import smooth
from maax_mjx.viewer.camera import place_camera
from maax_mjx.viewer.film import Film, Picked, film, one_time
from maax_mjx.viewer.scene import Frame
from maax_mjx.viewer.stage import Stage

VIEWS = ("auto", "3d", "plan")
FPS = 30
GIF_FPS = 25
LARGEST = 8192
"""Pixels a side, which OpenGL draws everywhere."""
SOON = 2.0
"""Seconds without a bar."""
COLOURS = 128
"""Colours of a gif, which can have 256: fewer make a smaller file, and the worlds have few."""

Size = tuple[int, int]
Draw = Callable[[Sequence[Frame]], np.ndarray]


def render(
    env: Environment,
    state: Any,
    *,
    worlds: Picked = None,
    size: Size = (640, 480),
    camera: str | Mapping[str, Any] = "default",
    view: str = "auto",
    vision: bool = False,
    lidar: bool = False,
) -> np.ndarray:
    """Draws a state.

    Args:
        env: the environment.
        state: of one world or of a batch.
        worlds: which of a batch, an index or several, side by side; None is the first one.
        size: width and height in pixels, 16 to 8192.
        camera: in three dimensions: "default" (from the south, above), "top", or a dict with any of azimuth and
            elevation in degrees, distance in metres and lookat (3,), as MuJoCo counts them.
        view: "3d", which needs OpenGL; "plan", from above and flat, which needs none; "auto" is "3d" where there is
            OpenGL.
        vision: whether to show who sees where and whom; needs `LineOfSight`.
        lidar: whether to show the rays of `Lidar`, which it needs.

    Returns:
        (height, width, 3) uint8.

    Raises:
        ValueError: an argument out of its range, a state of another environment, a sense that it does not have.
        MissingLibraryError: "3d" without OpenGL; the message says what brings it.
    """
    _check(size, view, camera)
    stage = Stage(env, vision=vision, lidar=lidar)
    shown = one_time(env, state, worlds)
    with _drawing(stage, shown, size, camera, view) as draw:
        return draw(_frames(stage, shown, 0))


def video(
    env: Environment,
    states: Any,
    path: str | Path,
    *,
    worlds: Picked = None,
    size: Size = (640, 480),
    speed: float = 1.0,
    fps: int | None = None,
    camera: str | Mapping[str, Any] = "default",
    view: str = "auto",
    vision: bool = False,
    lidar: bool = False,
) -> Path:
    """Writes a moving picture.

    Of states up to 0.2 s apart, as in games of long steps, it also shows moments in between, on straight ways.

    Args:
        env: the environment.
        states: a `Recording`; a list of states of single worlds or of batches; or one state with the leading axis
            (n_frames,) or axes (n_frames, n_worlds), as `jax.lax.scan` stacks them.
        path: a file that ends in .mp4 or .gif.
        worlds: which of a batch, an index or several, side by side; None is the first one, or all of a recording.
        size: width and height in pixels; of an .mp4, even numbers.
        speed: 1 is real time.
        fps: frames per second, of a .gif at most 50; None is 30, of a .gif 25, or fewer where the states are.
        camera: see `render`.
        view: see `render`.
        vision: see `render`.
        lidar: see `render`.

    Returns:
        The path.

    Raises:
        ValueError: an argument out of its range, states of another environment, a sense that it does not have.
        MissingLibraryError: "3d" without OpenGL, or an .mp4 without PyAV.
    """
    path = check_path("path", path, (".mp4", ".gif"))
    kind = path.suffix.lower()
    _check(size, view, camera)
    if kind == ".mp4" and (size[0] % 2 or size[1] % 2):
        raise ValueError(f"size: got {size}; takes even numbers for an .mp4")
    speed = check_positive("speed", speed)
    stage = Stage(env, vision=vision, lidar=lidar)
    shown = film(env, states, worlds)
    most = _most(fps, kind)
    shown = smooth(shown, most / speed)
    rate = most if fps is not None else min(most, shown.rate * speed)
    write = _write_mp4 if kind == ".mp4" else _write_gif
    moments = progress(_sampled(shown.times / speed, rate), f"drawing {kind}", unit="frames", delay=SOON, leave=False)
    with _drawing(stage, shown, size, camera, view) as draw:
        write(path, (draw(_frames(stage, shown, i)) for i in moments), rate, size)
    return path


def _check(size: Any, view: str, camera: Any) -> None:
    check_choice("view", view, VIEWS)
    # A plan has no camera; a wrong one is refused all the same.
    place_camera(camera, np.ones(2), (16, 16))
    if not isinstance(size, tuple | list) or len(size) != 2:
        raise ValueError(f"size: got {size!r}; takes (width, height) in pixels")
    for value in size:
        if check_count("size", value, minimum=16) > LARGEST:
            raise ValueError(f"size: got {size}; takes at most {LARGEST} pixels a side")


def _frames(stage: Stage, shown: Film, i: int) -> list[Frame]:
    return [stage.frame(state, row) for state, row in zip(shown.states[i], shown.returns[i], strict=True)]


@contextmanager
def _drawing(stage: Stage, shown: Film, size: Size, camera: Any, view: str) -> Iterator[Draw]:
    """A function that draws frames: in three dimensions, or flat."""
    from maax_mjx.viewer.solid import Solid

    size = (int(size[0]), int(size[1]))
    if view != "plan":
        try:
            solid = Solid(stage, len(shown.states[0]), shown.edge, size, camera)
        except MissingLibraryError:
            if view == "3d":
                raise
        else:
            with solid:
                yield solid.draw
            return
    from maax_mjx.viewer.plan import picture

    yield lambda frames: picture(stage, frames, size)


def _most(fps: int | None, kind: str) -> int:
    """Frames per second, at most."""
    if fps is None:
        return GIF_FPS if kind == ".gif" else FPS
    rate = check_count("fps", fps, minimum=1)
    if kind == ".gif" and rate > 50:
        raise ValueError(f"fps: got {fps}; takes at most 50 for a .gif, which cannot time more")
    return rate


def _sampled(times: np.ndarray, rate: float) -> np.ndarray:
    """Which frame is to be seen at every 1 / rate seconds."""
    # Frames come at multiples of the time step, which float does not hold exactly.
    ticks = np.arange(int(np.floor(times[-1] * rate + 1e-6)) + 1) / rate
    return np.searchsorted(times, ticks + 1e-6, side="right") - 1


def _write_gif(path: Path, pictures: Iterator[np.ndarray], rate: float, size: Size) -> None:
    flat = [Image.fromarray(picture).quantize(COLOURS) for picture in pictures]
    # The format counts in hundredths of a second: what rounding takes from one frame, the next gets.
    ends = np.round(100 * np.arange(1, len(flat) + 1) / rate).astype(int)
    durations = [int(10 * d) for d in np.diff(ends, prepend=0)]
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations, loop=0)


def _write_mp4(path: Path, pictures: Iterator[np.ndarray], rate: float, size: Size) -> None:
    try:
        import av
    except ImportError as error:
        raise MissingLibraryError(
            f"path: got {str(path)!r} and PyAV is not installed ({error}); {brought_by('viewer')}; a .gif needs none"
        ) from error
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=Fraction(rate).limit_denominator(10_000))
        stream.width, stream.height, stream.pix_fmt = size[0], size[1], "yuv420p"
        stream.options = {"crf": "20"}
        for picture in pictures:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        file.mux(stream.encode())
