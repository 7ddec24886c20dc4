"""Moments between frames, so that games of long steps move smoothly."""

from __future__ import annotations

from typing import Any

import numpy as np

from maax_mjx.core.state import State
from maax_mjx.viewer.film import Film

LONGEST = 0.2
"""Seconds between frames over which a straight way is what happened, or near enough to look at."""


def smooth(film: Film, fps: float) -> Film:
    """The film with moments between its frames, evenly spaced, where it has clearly fewer than `fps` a second.

    Nothing is put between frames that are more than 0.2 s apart, nor over a reset.
    """
    states, returns, times = [film.states[0]], [film.returns[0]], [film.times[:1]]
    for i, gap in enumerate(np.diff(film.times)):
        n = max(1, round(gap * fps)) if gap <= LONGEST else 1
        shares = np.arange(1, n) / n
        states += [[between(a, b, s) for a, b in zip(film.states[i], film.states[i + 1], strict=True)] for s in shares]
        returns += [film.returns[i]] * len(shares)
        times.append(film.times[i] + gap * np.append(shares, 1.0))
        states.append(film.states[i + 1])
        returns.append(film.returns[i + 1])
    return Film(states, returns, np.concatenate(times))


def between(before: State, after: State, share: float) -> State:
    """A world on its way from one state to the next: things in between, everything else as it was.

    Args:
        before: of a single world, on the host.
        after: a later one, which is of no account where it is of another episode.
        share: of the way, in [0, 1].
    """
    if int(after.step) <= int(before.step):
        return before
    a, b = before.data, after.data

    def mixed(x: Any, y: Any) -> np.ndarray:
        return np.asarray(x + (y - x) * np.asarray(share, x.dtype))

    # The turn that is nearest to the mean of two matrices, and the mean of two quaternions of one sign.
    u, _, v = np.linalg.svd(mixed(a.geom_xmat, b.geom_xmat).reshape(-1, 3, 3))
    opposite = (a.xquat * b.xquat).sum(axis=-1, keepdims=True) < 0
    quat = mixed(a.xquat, np.where(opposite, -b.xquat, b.xquat))
    quat /= np.maximum(np.linalg.norm(quat, axis=-1, keepdims=True), 1e-9)
    places = {name: mixed(getattr(a, name), getattr(b, name)) for name in ("qpos", "xpos", "geom_xpos")}
    return before.replace(data=a.replace(geom_xmat=(u @ v).reshape(np.shape(a.geom_xmat)), xquat=quat, **places))
