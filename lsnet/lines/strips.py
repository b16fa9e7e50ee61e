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
    places, normals = _places(polylines)
    count = len(polylines)
    x, y = (
        (places[..., k, None] - 0.5 + normals[..., k, None] * ACROSS_PX).reshape(count, -1).astype(np.float32)
        for k in (0, 1)
    )
    colours = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    shape = (count, ALONG + 2 * BEYOND, SAMPLES)
    samples = np.moveaxis(np.asarray(colours).reshape(*shape, len(ACROSS_PX), 3), 2, 0)
    strips = sum(sample.astype(np.float32) for sample in samples) / np.float32(SAMPLES)
    return np.round(strips), places.reshape(*shape, 2).mean(axis=2)


def is_inside(places: Floats, image_size: tuple[int, int]) -> Mask:
    """Return which places (..., 2) are inside an image of (height, width)."""
    height, width = image_size
    x, y = places[..., 0], places[..., 1]
    return np.asarray((x >= 0) & (x < width) & (y >= 0) & (y < height))


def _places(polylines: Sequence[RealArray]) -> tuple[Floats, Floats]:
    """Return (C, 168, 2) sampled places of C polylines (K, 2), and the unit normals there."""
    inner, beyond = ALONG * SAMPLES, BEYOND * SAMPLES
    resampled = [resample(polyline, inner + 2) for polyline in polylines]
    points, lengths = np.stack([line for line, _ in resampled]), np.array([length for _, length in resampled])
    back = np.clip((inner * DIRECTION_PX / np.maximum(lengths, 1)).astype(np.intp), 2, inner // 3)
    line = np.arange(len(points))
    before = _units(points[:, 0] - points[line, back])[:, None]
    behind = _units(points[:, -1] - points[line, -1 - back])[:, None]
    steps = ((np.arange(beyond) + 0.5) * BEYOND_STEP_PX / SAMPLES)[:, None]
    ends = points[:, :1] + before * steps[::-1], points[:, -1:] + behind * steps
    slopes = np.pad(np.gradient(points, axis=1)[:, 1:-1], ((0, 0), (SMOOTH, SMOOTH), (0, 0)), mode="edge")
    along = np.lib.stride_tricks.sliding_window_view(slopes, 2 * SMOOTH + 1, axis=1).sum(axis=-1)
    along = np.concatenate([np.repeat(-before, beyond, 1), along, np.repeat(behind, beyond, 1)], axis=1)
    along = _units(along)
    return np.concatenate([ends[0], points[:, 1:-1], ends[1]], axis=1), np.stack(
        [-along[..., 1], along[..., 0]], axis=-1
    )


def resample(polyline: RealArray, count: int) -> tuple[Floats, float]:
    """Return (count, 2) evenly spaced points of a polyline (K, 2), ends included, and its length."""
    steps = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(polyline, axis=0).T))])
    at = np.linspace(0, steps[-1], count)
    return np.stack([np.interp(at, steps, polyline[:, k]) for k in (0, 1)], axis=1), float(steps[-1])


def _units(vectors: RealArray) -> RealArray:
    """(..., 2) vectors of length 1."""
    return vectors / np.maximum(np.hypot(vectors[..., 0], vectors[..., 1]), 1e-6)[..., None]
