"""A recording as one web page: viser's scenes, which play without a server."""

from __future__ import annotations

import html
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from maax_mjx.common.checks import check_bool, check_count, check_path, check_positive
from maax_mjx.core.env import Environment
from maax_mjx.viewer.between import smooth
from maax_mjx.viewer.camera import place_camera
from maax_mjx.viewer.film import Picked, film, paced
from maax_mjx.viewer.nodes import Nodes, own_server
from maax_mjx.viewer.scene import offsets
from maax_mjx.viewer.stage import Stage

ENDINGS = (".html", ".htm")
FPS = 30
HEIGHT = 500
SHAPE_OF_PAGE = (16, 10)
TITLE = "<title>Viser</title>"
"""Of viser's pages."""
WORDS = 0.2
"""Height of the words above a world, as a share of its edge."""


class Replay:
    """A recording as a web page, which a notebook shows in its cell.

    Attributes:
        html: the page, whole: it fetches nothing.
        n_frames: how many frames it has.
        seconds: how long it plays.
    """

    def __init__(self, page: str, n_frames: int, seconds: float):
        self.html, self.n_frames, self.seconds = page, n_frames, seconds

    def save(self, path: str | Path) -> Path:
        """Writes the page into a file that ends in .html."""
        path = check_path("path", path, ENDINGS)
        path.write_text(self.html, encoding="utf-8")
        return path

    def _repr_html_(self) -> str:
        # A frame of its own keeps the page's styles and keys apart from the notebook's.
        return (
            f'<iframe srcdoc="{html.escape(self.html, quote=True)}" width="100%" height="{HEIGHT}" '
            'style="border: 1px solid #ddd" allowfullscreen></iframe>'
        )

    def __repr__(self) -> str:
        size = len(self.html) / 1e6
        return f"Replay({self.n_frames} frames, {self.seconds:.1f} s, {size:.1f} MB; .save('replay.html') writes it)"


def replay(
    env: Environment,
    states: Any,
    path: str | Path | None = None,
    *,
    worlds: Picked = None,
    speed: float = 1.0,
    fps: int = FPS,
    vision: bool = False,
    lidar: bool = False,
    camera: str | Mapping[str, Any] = "default",
    shadows: bool = True,
) -> Replay:
    """Makes a web page that plays worlds: with play, pause, a time line, speeds, and a camera to turn by mouse.

    One file that opens offline: 0.8 MB for what plays it, and 0.03 to 0.05 MB for every 10 s of a world. Of states up
    to 0.2 s apart, as in games of long steps, it also shows moments in between, on straight ways.

    Args:
        env: the environment.
        states: a `Recording`; a list of states of single worlds or of batches; or one state with the leading axis
            (n_frames,) or axes (n_frames, n_worlds), as `jax.lax.scan` stacks them.
        path: where to write the page, a file that ends in .html; None writes none.
        worlds: which of a batch, an index or several, side by side; None is the first one, or all of a recording.
        speed: of the page's 1x; 1 is real time.
        fps: frames per second of the page, at most; states in between are left out.
        vision: whether to show who sees where and whom; needs `LineOfSight`.
        lidar: whether to show the rays of `Lidar`, which it needs.
        camera: where it begins: "default", "top", or a dict with any of azimuth and elevation in degrees, distance in
            metres and lookat (3,).
        shadows: whether things cast shadows, which take a browser without a GPU most of its time.

    Returns:
        The page. At the end of a notebook's cell it shows itself.

    Raises:
        ValueError: an argument out of its range, states of another environment, a sense that it does not have.
        MissingLibraryError: viser is not installed.
    """
    shadows = check_bool("shadows", shadows)
    speed, fps = check_positive("speed", speed), check_count("fps", fps, minimum=1)
    if path is not None:
        path = check_path("path", path, ENDINGS)
    stage = Stage(env, vision=vision, lidar=lidar)
    shown = smooth(film(env, states, worlds), fps / speed)
    shown = shown.at(paced(shown.times / speed, fps))
    n_worlds = len(shown.states[0])
    edge = shown.edge
    places = offsets(n_worlds, edge)
    extent = places.max(axis=0)[:2] + edge
    with own_server("replay") as server:
        nodes = Nodes(server, stage, place_camera(camera, extent, SHAPE_OF_PAGE, WORDS * edge), shadows)
        serializer = server.get_scene_serializer()
        moments = [
            [stage.frame(state, row) for state, row in zip(states_now, returns, strict=True)]
            for states_now, returns in zip(shown.states, shown.returns, strict=True)
        ]
        nodes.fill(moments, places)
        last = 0.0
        for frames, time in zip(moments, shown.times / speed, strict=True):
            serializer.insert_sleep(max(float(time) - last, 0.0))
            last = float(time)
            for w, frame in enumerate(frames):
                nodes.show(w, frame, places[w])
            nodes.next()
        # The last frame stays as long as the others before the page begins again.
        serializer.insert_sleep(last / max(len(shown.times) - 1, 1))
        made = Replay(_titled(serializer.as_html(), env), len(shown.times), last)
    if path is not None:
        made.save(path)
    return made


def _titled(page: str, env: Environment) -> str:
    """The page with the game's name as its title."""
    name = env.made_from.name if env.made_from else "maax_mjx"
    return page.replace(TITLE, f"<title>{html.escape(name)}</title>", 1)
