"""Strips of pixels along lines: what lies on a line, on both sides of it, and beyond its ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Floats, Floats32, ImageArray, Indices, Mask, RealArray
    from lsnet.lines.polylines import Polylines

OFFSETS_PX = np.array([*range(8), 9, 11, 14, 18, 24, 32, 40], np.float32)  # across the line, to one side
ACROSS_PX = np.concatenate([-OFFSETS_PX[:0:-1], OFFSETS_PX])  # O = 29, fine near the line
ALONG, BEYOND, BEYOND_STEP_PX = 64, 10, 6.0  # places along a line, and beyond each end
PLACES = ALONG + 2 * BEYOND
SAMPLES = 2  # averaged at each place
DIRECTION_PX = 24.0  # over which the direction of an end is measured
SMOOTH = 5  # samples to both sides over which directions are averaged


def cut_strips(image: ImageArray, lines: Polylines, number: Indices) -> tuple[Floats32, Floats32]:
    """Cut a strip along C of the lines.

    Returns:
        (4, C, O, T) red, green, blue and grey, where T = 84 places: 10 before the line, 64 along it, 10
        behind it; and (2, C, T) x and y of the places, in pixels, which can be outside the image.
    """
    places, normals = (
        values.reshape(-1, PLACES, SAMPLES, 2).transpose(3, 2, 0, 1).astype(np.float32, order="C")
        for values in _places(lines, number)
    )
    samples = normals[..., None, :] * ACROSS_PX[:, None]
    samples += places[..., None, :] - np.float32(0.5)
    x, y = samples.reshape(2, SAMPLES, len(number), -1)
    one, other = (
        cv2.remap(image, x[k], y[k], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for k in range(SAMPLES)
    )
    colours = cv2.addWeighted(one, 0.5, other, 0.5, 0)
    strips = np.empty((4, *colours.shape[:2]), np.float32)
    strips[:3] = cv2.split(colours)
    strips[3] = cv2.cvtColor(colours.astype(np.float32), cv2.COLOR_RGB2GRAY)
    return strips.reshape(4, -1, len(ACROSS_PX), PLACES), places.mean(axis=1)


def is_inside(places: RealArray, image_size: tuple[int, int]) -> Mask:
    """Return which places (2, ...), x and y, are inside an image of (height, width)."""
    height, width = image_size
    x, y = places
    return np.asarray((x >= 0) & (x < width) & (y >= 0) & (y < height))


def _places(lines: Polylines, number: Indices) -> tuple[Floats, Floats]:
    """Return (C, 168, 2) sampled places of C of the lines, and the unit normals there."""
    inner, beyond = ALONG * SAMPLES, BEYOND * SAMPLES
    points = lines.spaced(inner + 2, number)
    back = (inner * DIRECTION_PX / np.maximum(lines.lengths_px[number], 1)).astype(np.intp)
    back = np.minimum(np.maximum(back, 2), inner // 3)
    line = np.arange(len(points))
    before = _units(points[:, 0] - points[line, back])[:, None]
    behind = _units(points[:, -1] - points[line, -1 - back])[:, None]
    steps = ((np.arange(beyond) + 0.5) * BEYOND_STEP_PX / SAMPLES)[:, None]
    ends = points[:, :1] + before * steps[::-1], points[:, -1:] + behind * steps
    # Sums of the slopes around each point: the differences of sums of points.
    slopes = (points[:, 2:] - points[:, :-2]) / 2
    edges = np.repeat(slopes[:, :1], SMOOTH + 1, axis=1), np.repeat(slopes[:, -1:], SMOOTH, axis=1)
    sums = np.cumsum(np.concatenate([edges[0], slopes, edges[1]], axis=1), axis=1)
    along = sums[:, 2 * SMOOTH + 1 :] - sums[:, : -2 * SMOOTH - 1]
    along = np.concatenate([np.repeat(-before, beyond, 1), along, np.repeat(behind, beyond, 1)], axis=1)
    along = _units(along)
    return np.concatenate([ends[0], points[:, 1:-1], ends[1]], axis=1), np.stack(
        [-along[..., 1], along[..., 0]], axis=-1
    )


def _units(vectors: RealArray) -> RealArray:
    """(..., 2) vectors of length 1."""
    return vectors / np.maximum(np.hypot(vectors[..., 0], vectors[..., 1]), 1e-6)[..., None]
