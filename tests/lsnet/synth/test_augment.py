"""Augmentation: each technique alone, and how often they are applied."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.synth import augment
from lsnet.synth.augment import PHOTOMETRIC, elastic

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def photo(size: int = 64) -> Image:
    """A smooth coloured picture, 40 to 200."""
    coarse = rng(5).uniform(40, 200, (5, 5, 3)).astype(np.float32)
    return np.clip(cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC), 40, 200)


@pytest.mark.parametrize("technique", PHOTOMETRIC, ids=lambda f: f.__name__)
def test_each_technique_returns_a_new_image_of_the_same_kind(technique: Callable[..., Image]) -> None:
    image = photo()
    before = image.copy()
    results = [technique(image, rng(seed)) for seed in range(6)]
    np.testing.assert_array_equal(image, before)
    for result in results:
        assert (result.shape, result.dtype) == (image.shape, np.float32)
        assert np.isfinite(result).all()
        assert result.min() > -100
        assert result.max() < 355
    np.testing.assert_array_equal(technique(image, rng(3)), results[3])
    assert max(np.abs(result - image).mean() for result in results) > 0.5


def test_noise_is_normal_with_the_drawn_strength() -> None:
    image = np.full((200, 200, 3), 100, np.float32)
    kinds = set()
    for seed in range(8):
        noise = augment.gaussian_noise(image, rng(seed)) - image
        sigma = noise.std()
        assert 1.9 < sigma < 18.2
        assert abs(noise.mean()) < sigma / 30
        assert np.mean(np.abs(noise) < sigma) == pytest.approx(0.683, abs=0.02)
        kinds.add(bool(np.array_equal(noise[..., 0], noise[..., 1])))
    assert kinds == {True, False}  # grey and coloured


@pytest.mark.parametrize("blur", [augment.gaussian_blur, augment.motion_blur], ids=lambda f: f.__name__)
def test_blurs_spread_a_point_and_keep_its_sum_and_place(blur: Callable[..., Image]) -> None:
    image = np.zeros((41, 41, 3), np.float32)
    image[20, 20] = 200
    y, x = np.mgrid[:41, :41]
    for seed in range(8):
        blurred = blur(image, rng(seed))[..., 0]
        assert blurred.sum() == pytest.approx(200, rel=1e-3)
        assert blurred.max() < 199.9
        centroid = (blurred * x).sum() / blurred.sum(), (blurred * y).sum() / blurred.sum()
        assert np.hypot(centroid[0] - 20, centroid[1] - 20) < 0.75


def test_brightness_shifts_and_contrast_stretches() -> None:
    image = photo()
    shift = augment.brightness(image, rng(1)) - image
    assert shift.std() < 1e-3
    assert 0 < abs(shift.mean()) <= 60
    stretched = augment.contrast(image, rng(1))
    assert stretched.mean() == pytest.approx(image.mean(), abs=0.01)
    assert np.corrcoef(stretched.ravel(), image.ravel())[0, 1] == pytest.approx(1)


def test_saturation_and_hue_keep_the_mean_of_each_pixel() -> None:
    image = photo()
    for technique in (augment.saturation, augment.hue):
        changed = technique(image, rng(2))
        np.testing.assert_allclose(changed.mean(axis=2), image.mean(axis=2), atol=0.01)
    turned = augment.hue(image, rng(2))
    length = np.linalg.norm(image - image.mean(axis=2, keepdims=True), axis=2)
    np.testing.assert_allclose(
        np.linalg.norm(turned - turned.mean(axis=2, keepdims=True), axis=2), length, atol=0.01
    )


def test_grey_has_three_equal_channels_of_the_luma() -> None:
    grey = augment.grey(np.float32([[[200, 100, 50]]]), rng())
    np.testing.assert_allclose(grey, 0.299 * 200 + 0.587 * 100 + 0.114 * 50, rtol=1e-5)


def test_haze_is_thin_on_one_side_and_thick_on_the_other() -> None:
    image = np.zeros((10, 100, 3), np.float32)
    for seed in range(6):
        veil = augment.haze(image, rng(seed))[0, :, 0]
        assert min(veil[0], veil[-1]) == 0
        assert 15 < max(veil[0], veil[-1]) < 110
        assert np.abs(np.diff(veil, 2)).max() < 1e-3


@pytest.mark.parametrize("seed", range(6))
def test_elastic_moves_image_and_lines_together(seed: int) -> None:
    """A drawn line is found, row by row, where its moved points say."""
    column = 200.5
    x = np.arange(384) + 0.5
    profile = np.exp(-(((x - column) / 1.5) ** 2) / 2) * 200
    image = np.repeat(np.repeat(profile[None, :, None], 384, 0), 3, 2).astype(np.float32)
    line = np.column_stack([np.full(385, column), np.arange(385.0)])
    moved, (points,) = elastic(image, [line], rng(seed))
    assert (moved.shape, moved.dtype) == (image.shape, np.float32)
    rows = np.arange(12, 372)
    found = (moved[rows, :, 0] * x).sum(1) / moved[rows, :, 0].sum(1)
    said = np.interp(rows + 0.5, points[:, 1], points[:, 0])
    assert np.abs(found - said).max() < 0.25
    assert np.abs(points - line).max() > 0.2


def test_augment_leaves_about_three_quarters_of_each_technique_out() -> None:
    assert augment.PROBABILITY == 0.25
    image, line = photo(16), np.array([[2.0, 2.0], [9.0, 9.0]])
    results = [augment.augment(image, [line], rng(seed)) for seed in range(300)]
    moved = np.mean([not np.array_equal(lines[0], line) for _, lines in results])
    assert moved == pytest.approx(0.25, abs=0.08)
    untouched = np.mean([np.array_equal(changed, image) for changed, _ in results])
    assert untouched == pytest.approx(0.75**11, abs=0.04)
