"""The words in a picture of a single world."""

import numpy as np
from PIL import Image, ImageFont

from maax_mjx.viewer.solid import BACKED, caption


def test_words_are_on_a_pale_box_where_a_wall_is_behind_them():
    picture = Image.new("RGB", (320, 240))
    caption(picture, ["0.50 s", "hiders +2  sum +42"], ImageFont.load_default(12))
    drawn = np.asarray(picture)
    rows, columns = np.nonzero(drawn.any(axis=2))
    box = drawn[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
    assert box.all(axis=2).all(), "one box"
    assert np.median(box) == round(255 * BACKED), "through which the wall shows"
    assert box.min() < 100, "and words in it"
    assert box.shape[0] < 60
    assert not drawn[80:].any()


def test_no_words_and_more_than_fit_are_no_mistake():
    for lines in ([], ["long " * 50] * 50):
        caption(Image.new("RGB", (60, 40)), lines, ImageFont.load_default(12))
