"""Strips of pixels along lines: what lies on a line, on both sides of it, and beyond its ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, Floats32, ImageArray, Mask, RealArray

OFFSETS_PX = np.array([*range(8), 9, 11, 14, 18, 24, 32, 40], np.float32)  # across the line, to one side
ACROSS_PX = np.concatenate([-OFFSETS_PX[:0:-1], OFFSETS_PX])  # O = 29, fine near the line
ALONG, BEYOND, BEYOND_STEP_PX = 64, 10, 6.0  # places along a line, and beyond each end
SAMPLES = 2  # averaged at each place
DIRECTION_PX = 24.0  # over which the direction of an end is measured
SMOOTH = 5  # samples to both sides over which directions are averaged


def cut_strips(image: ImageArray, polylines: Sequence[RealArray]) -> tuple[Floats32, Floats]:
    """Cut a strip along each of C polylines.

    Returns:
        (C, T, O, 3) colours, where T = 84 places: 10 before the line, 64 along it, 10 behind it; and
        (C, T, 2) x, y of the places, in pixels, which can be outside the image.
    """
    placed = [_places(polyline) for polyline in polylines]
    places, normals = (np.stack(part) for part in zip(*placed, strict=True))
    at = places[:, :, None] + normals[:, :, None] * ACROSS_PX[:, None] - 0.5
    count = len(polylines)
    x, y = (at[..., k].reshape(count, -1).astype(np.float32) for k in (0, 1))
    colours = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shape = (count, ALONG + 2 * BEYOND, SAMPLES)
    strips = np.asarray(colours).reshape(*shape, len(ACROSS_PX), 3).mean(axis=2, dtype=np.float32)
    return np.round(strips), places.reshape(*shape, 2).mean(axis=2)


def is_inside(places: Floats, image_size: tuple[int, int]) -> Mask:
    """Return which places (..., 2) are inside an image of (height, width)."""
    height, width = image_size
    x, y = places[..., 0], places[..., 1]
    return np.asarray((x >= 0) & (x < width) & (y >= 0) & (y < height))


def _places(polyline: RealArray) -> tuple[Floats, Floats]:
    """Return (168, 2) sampled places of a polyline (K, 2), and the unit normals there."""
    inner, beyond = ALONG * SAMPLES, BEYOND * SAMPLES
    points, length = resample(polyline, inner + 2)
    back = max(2, min(inner // 3, int(inner * DIRECTION_PX / max(length, 1.0))))
    before, behind = (_unit(points[i] - points[j]) for i, j in ((0, back), (-1, -1 - back)))
    steps = ((np.arange(beyond) + 0.5) * BEYOND_STEP_PX / SAMPLES)[:, None]
    places = np.concatenate([points[0] + before * steps[::-1], points[1:-1], points[-1] + behind * steps])
    slopes = np.pad(np.gradient(points, axis=0)[1:-1], ((SMOOTH, SMOOTH), (0, 0)), mode="edge")
    window = np.ones(2 * SMOOTH + 1)
    along = np.stack([np.convolve(slopes[:, k], window, "valid") for k in (0, 1)], axis=1)
    along = np.concatenate([np.tile(-before, (beyond, 1)), along, np.tile(behind, (beyond, 1))])
    along /= np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-6)[:, None]
    return places, np.stack([-along[:, 1], along[:, 0]], axis=1)


def resample(polyline: RealArray, count: int) -> tuple[Floats, float]:
    """Return (count, 2) evenly spaced points of a polyline (K, 2), ends included, and its length."""
    steps = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(polyline, axis=0).T))])
    at = np.linspace(0, steps[-1], count)
    return np.stack([np.interp(at, steps, polyline[:, k]) for k in (0, 1)], axis=1), float(steps[-1])


def _unit(vector: RealArray) -> RealArray:
    return vector / max(float(np.hypot(*vector)), 1e-6)
