"""Artefacts of video codecs such as H.264: coarse blocks, smoothed block borders, colour at half resolution.

Not a codec: one frame, one block size, and only the visible steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import FloatImage, Rng


BLOCK_PX = 8
ROUNDING = 1 / 3  # of a step: coefficients are rounded towards zero
STEPS = (8.0, 48.0)  # quantiser steps of about QP 22 to 38, grey levels


def video(image: FloatImage, rng: Rng) -> FloatImage:
    """Return an image transformed, quantised and smoothed; float32 (H, W, 3) RGB in [0, 255]."""
    step = float(np.exp(rng.uniform(*np.log(STEPS))))
    height, width = image.shape[:2]
    padded = cv2.copyMakeBorder(
        np.clip(image, 0, 255), 0, -height % (2 * BLOCK_PX), 0, -width % (2 * BLOCK_PX), cv2.BORDER_REPLICATE
    )
    luma, *colours = cv2.split(cv2.cvtColor(padded / 255, cv2.COLOR_RGB2YCrCb) * 255)
    halves = [cv2.resize(plane, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for plane in colours]
    planes = [deblocked(quantised(np.asarray(plane, np.float32), step), step) for plane in (luma, *halves)]
    size = (luma.shape[1], luma.shape[0])
    colours = [cv2.resize(plane, size, interpolation=cv2.INTER_LINEAR) for plane in planes[1:]]
    rgb = cv2.cvtColor(cv2.merge([planes[0], *colours]) / 255, cv2.COLOR_YCrCb2RGB)
    return np.asarray(rgb[:height, :width] * 255, np.float32)


def quantised(plane: FloatImage, step: float) -> FloatImage:
    """Round the cosine coefficients of each 8 x 8 block of (H, W), multiples of 8, to the step."""
    height, width = plane.shape
    blocks = plane.reshape(height // BLOCK_PX, BLOCK_PX, width // BLOCK_PX, BLOCK_PX).swapaxes(1, 2)
    basis = _cosines()
    coefficients = basis @ blocks @ basis.T
    levels = np.sign(coefficients) * np.floor(np.abs(coefficients) / step + ROUNDING)
    back = basis.T @ (levels * np.float32(step)) @ basis
    return np.asarray(back.swapaxes(1, 2).reshape(height, width), np.float32)


def _cosines() -> FloatImage:
    """Return the (8, 8) orthonormal cosine transform, one frequency per row."""
    k, i = np.arange(BLOCK_PX)[:, None], np.arange(BLOCK_PX)
    basis = np.cos(np.pi * k * (2 * i + 1) / (2 * BLOCK_PX)) * np.sqrt(2 / BLOCK_PX)
    basis[0] /= np.sqrt(2)
    return np.asarray(basis, np.float32)


def deblocked(plane: FloatImage, step: float) -> FloatImage:
    """Soften block borders where the jump is less than a step, and so probably not part of the scene."""
    for view in (plane, plane.T):
        before, after = view[BLOCK_PX - 1 : -1 : BLOCK_PX], view[BLOCK_PX::BLOCK_PX]
        jump = after - before
        softened = np.where(np.abs(jump) < step, jump / 4, 0)
        before += softened
        after -= softened
    return plane
