"""Rivals tell what they find in our terms."""

import cv2
import numpy as np

from lsnet.rivals.lsd import LSD, SCORE_LENGTH_PX


def test_lsd_finds_the_edges_of_a_band() -> None:
    image = np.full((120, 160, 3), 60, np.uint8)
    cv2.rectangle(image, (20, 50), (139, 69), (200, 200, 200), -1)
    (found,) = LSD().detect([image])
    long = found.segments.above(1 - np.exp(-100 / SCORE_LENGTH_PX))
    assert sorted(np.round(long.endpoints[:, [1, 3]].mean(1)).tolist()) == [50.0, 70.0]
    lengths = np.hypot(*(long.endpoints[:, 2:] - long.endpoints[:, :2]).T)
    np.testing.assert_allclose(long.scores, 1 - np.exp(-lengths / 100), atol=1e-5)
    np.testing.assert_array_equal(found.lines.pieces().endpoints, found.segments.endpoints)


def test_lsd_of_a_plain_image_finds_nothing() -> None:
    (found,) = LSD().detect([np.full((40, 40, 3), 90, np.uint8)])
    assert (len(found.segments), len(found.lines)) == (0, 0)
