"""Several worlds in one picture: each in a tile of its own, with its words above it."""

from __future__ import annotations

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import maax_mjx as maax
from maax_mjx.viewer.gallery import LINE, arrange, initials, lift
from maax_mjx.viewer.palette import SKY, as_bytes

N, SIZE = 8, (640, 480)


@given(n=st.integers(1, 40), width=st.integers(64, 2000), height=st.integers(64, 2000), lines=st.integers(0, 6))
def test_tiles_are_apart_and_fill_the_picture(n, width, height, lines):
    gallery = arrange(n, (width, height), lines)
    wide, high = gallery.tile
    seen = np.zeros((height, width), int)
    for i in range(n):
        x, y = gallery.corner(i)
        assert 0 <= x <= width - wide
        assert 0 <= y <= height - high - gallery.strip
        seen[y : y + high + gallery.strip, x : x + wide] += 1
    assert seen.max() == 1
    fits = gallery.fitting(["word"] * lines)
    assert len(fits) * gallery.letters * LINE <= gallery.strip or n == 1
    assert len(fits) == lines or n > 1
    assert gallery.strip <= 0.3 * (high + gallery.strip) + 3
    if n == 1:
        assert (gallery.tile, gallery.strip) == ((width, height), 0)


def test_names_are_short_where_there_is_no_room():
    assert [initials(name) for name in ("hider_0", "seeker_12", "ball")] == ["h0", "s12", "ball"]
    assert arrange(N, SIZE, 3).is_narrow
    assert not arrange(1, SIZE, 3).is_narrow


@pytest.mark.slow
def test_every_world_is_seen_in_its_tile():
    """Where it stands changes nothing of it; floors are nearly half of the picture, agents some pixels."""
    env = maax.make("hide_and_seek_quadrant", impl="c", n_boxes=1, n_ramps=1)
    states = maax.Worlds(env, N).reset(jax.random.key(0))
    try:
        images = [maax.render(env, states, worlds=order, size=SIZE, view="3d") for order in (range(N), range(N)[::-1])]
    except maax.MissingLibraryError as error:
        pytest.skip(str(error))
    gallery = arrange(N, SIZE, 3)
    wide, high = gallery.tile
    for i in range(N):
        cut = []
        for image, place in zip(images, (i, N - 1 - i), strict=True):
            x, y = gallery.corner(place)
            tile = image[y : y + high + gallery.strip, x : x + wide]
            assert (tile[: gallery.strip].min(axis=2) < 100).any(), "words in their strip"
            cut.append(tile[gallery.strip :])
        # Words of the row above reach over by a line of their edges.
        np.testing.assert_array_equal(cut[0][4:-4, 4:-4], cut[1][4:-4, 4:-4])
        hue = cut[0].astype(int)
        blue, red = hue[..., 2] - hue[..., 0] > 60, hue[..., 0] - hue[..., 2] > 60
        assert blue.sum() > 2 * 40
        assert red.sum() > 2 * 40
    assert (np.abs(images[0].astype(int) - as_bytes(SKY)).max(axis=2) > 2).mean() > 0.45


@given(st.lists(st.tuples(*[st.integers(0, 40)] * 2, st.integers(1, 30), st.integers(1, 12)), max_size=12))
def test_words_lie_over_none_before_them(drawn):
    """However they crowd, and those in nobody's way stay."""
    taken = []
    for x, y, wide, high in drawn:
        up = lift((x, y, x + wide, y + high), taken)
        box = (x, y - up, x + wide, y + high - up)
        apart = [box[2] <= t[0] or t[2] <= box[0] or box[3] <= t[1] or t[3] <= box[1] for t in taken]
        assert all(apart)
        was = [x + wide <= t[0] or t[2] <= x or y + high <= t[1] or t[3] <= y for t in taken]
        assert up == 0 if all(was) else up > 0
        taken.append(box)
