"""Segments as pixels (Section IV-A): a confidence map, smoothed and binarised."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Floats32, Mask
    from lsnet.segments import Segments

SIGMA_PX = 1.0  # of the Gaussian, whose width the paper leaves open: the default of scikit-image's `gaussian`


def confidence_map(segments: Segments, width_px: int = 1) -> Floats32:
    """Draw segments as 8-connected Bresenham lines; (H, W) float32, the highest score at each pixel.

    A line of width W is drawn as W lines of one pixel side by side: exactly W pixels in each column of a
    flat line, or in each row of a steep one. (OpenCV's own thick lines are wider than requested.)
    """
    drawn = np.zeros(segments.image_size, np.float32)
    last = np.array([segments.image_size[1] - 1, segments.image_size[0] - 1] * 2)
    pixels = np.clip(np.floor(segments.endpoints).astype(int), 0, last)
    for i in np.argsort(segments.scores, kind="stable"):  # the highest score last, on top
        x1, y1, x2, y2 = pixels[i].tolist()
        is_flat = abs(x2 - x1) >= abs(y2 - y1)
        for shift in range(-((width_px - 1) // 2), width_px // 2 + 1):
            dx, dy = (0, shift) if is_flat else (shift, 0)
            ends = (x1 + dx, y1 + dy), (x2 + dx, y2 + dy)
            cv2.line(drawn, *ends, float(segments.scores[i]), 1, cv2.LINE_8)
    return drawn


def smoothed(confidence: Floats32, sigma_px: float = SIGMA_PX) -> Floats32:
    """Filter the map by a Gaussian."""
    return np.asarray(cv2.GaussianBlur(confidence, (0, 0), sigma_px), np.float32)


def otsu_mask(confidence: Floats32) -> Mask:
    """Return the pixels above Otsu's threshold of the map."""
    grey = np.round(np.clip(confidence, 0, 1) * 255).astype(np.uint8)
    _, mask = cv2.threshold(grey, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    return np.asarray(mask > 0)
