"""Codec artefacts, against OpenCV's cosine transform and hand-made borders."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from lsnet.synth.compression import deblocked, quantised, video


def texture(height: int = 16, width: int = 24) -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 255, (height, width)).astype(np.float32)


def test_fine_step_changes_nothing() -> None:
    plane = texture()
    np.testing.assert_allclose(quantised(plane, 1e-3), plane, atol=0.01)


def test_coefficients_of_every_block_are_whole_steps_towards_zero() -> None:
    plane, step = texture(), 20.0
    result = quantised(plane, step)
    for y in range(0, 16, 8):
        for x in range(0, 24, 8):
            before, after = (cv2.dct(p[y : y + 8, x : x + 8].copy()) for p in (plane, result))
            np.testing.assert_allclose(after / step, np.round(after / step), atol=1e-3)
            assert (np.abs(after) <= np.abs(before) + step / 3 + 0.01).all()
            assert (np.abs(after) >= np.abs(before) - step * 2 / 3 - 0.01).all()


def test_small_jumps_between_blocks_are_softened_and_edges_are_kept() -> None:
    plane = np.zeros((16, 24), np.float32)
    plane[:, 8:16], plane[:, 16:] = 8, 100
    result = deblocked(plane.copy(), step=20.0)
    np.testing.assert_array_equal(result[3, 6:10], [0, 2, 6, 8])
    np.testing.assert_array_equal(result[:, 15:17], plane[:, 15:17])


@pytest.mark.parametrize("size", [(32, 32), (30, 45)])
def test_compression_keeps_size_and_colours_and_removes_detail(size: tuple[int, int]) -> None:
    colour = np.array([200, 90, 40], np.float32)
    noise = np.random.default_rng(2).normal(0, 6, (*size, 3)).astype(np.float32)
    result = video(colour + noise, np.random.default_rng(0))
    assert (result.shape, result.dtype) == ((*size, 3), np.float32)
    np.testing.assert_allclose(result.mean(axis=(0, 1)), colour, atol=6)
    assert result.std(axis=(0, 1)).max() < 0.7 * noise.std()
