"""Geometric augmentation moves images and lines alike; light conditions; shadows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.synth import conditions, geometric

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

LINE = np.array([[12.3, 20.7], [70.4, 80.2]])


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def dotted(size: tuple[int, int] = (100, 90)) -> Image:
    """Black, with a soft dot at each end of LINE: the first red, the second green."""
    y, x = np.mgrid[: size[0], : size[1]] + 0.5
    image = np.zeros((*size, 3), np.float32)
    for channel, (px, py) in enumerate(LINE):
        image[..., channel] = 200 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 1.5**2))
    return image


def centroid(channel: NDArray[np.floating]) -> tuple[float, float]:
    y, x = np.mgrid[: channel.shape[0], : channel.shape[1]] + 0.5
    weights = np.where(channel > 30, channel - 30, 0)
    return float((x * weights).sum() / weights.sum()), float((y * weights).sum() / weights.sum())


def is_well_inside(point: NDArray[np.floating], image: Image) -> bool:
    return bool((point > 6).all() and point[0] < image.shape[1] - 6 and point[1] < image.shape[0] - 6)


def check_dots(image: Image, lines: list[NDArray[np.floating]]) -> int:
    """The dots are where the moved line ends; how many of them are in the image."""
    seen = 0
    for channel, point in enumerate(lines[0]):
        if is_well_inside(point, image):
            np.testing.assert_allclose(centroid(image[..., channel]), point, atol=0.2)
            seen += 1
    return seen


MOVES = [geometric.crop, geometric.zoom, geometric.rotate, geometric.flip]


@pytest.mark.parametrize("move", MOVES, ids=lambda f: f.__name__)
def test_lines_move_with_their_image(move: Callable[..., tuple[Image, list[NDArray[np.floating]]]]) -> None:
    image, seen, moved = dotted(), 0, 0
    for seed in range(12):
        result, lines = move(image, [LINE], rng(seed))
        assert result.dtype == np.float32
        seen += check_dots(result, lines)
        moved += not np.allclose(lines[0], LINE)
    assert seen >= 8
    assert moved >= 11  # a crop may keep the corner
    np.testing.assert_array_equal(image, dotted())


def test_only_crops_change_the_size() -> None:
    for move in (geometric.zoom, geometric.rotate, geometric.flip):
        assert move(dotted(), [LINE], rng(3))[0].shape == (100, 90, 3)
    for seed in range(5):
        height, width = geometric.crop(dotted(), [LINE], rng(seed))[0].shape[:2]
        assert 50 <= height <= 100
        assert 45 <= width <= 90


def test_flipping_twice_restores_the_image() -> None:
    once = geometric.flip(dotted(), [LINE], rng(1))
    again, lines = geometric.flip(*once, rng(1))
    np.testing.assert_array_equal(again, dotted())
    np.testing.assert_allclose(lines[0], LINE)


def test_five_crops_and_their_flips() -> None:
    versions = geometric.crops_and_flips(dotted(), [LINE], rng(4))
    assert len(versions) == 10
    for (part, _), (flipped, _) in zip(versions[::2], versions[1::2], strict=True):
        assert part.shape == flipped.shape
        np.testing.assert_allclose(np.sort(part.ravel()), np.sort(flipped.ravel()))
        assert not np.array_equal(part, flipped)
    assert sum(check_dots(*version) for version in versions) >= 10


def test_composing_over_a_background() -> None:
    cables = np.zeros((2, 2, 4), np.float32)
    cables[0, 0], cables[0, 1] = (200, 100, 50, 1), (200, 100, 50, 0.25)
    background = np.full((2, 2, 3), 80, np.float32)
    np.testing.assert_allclose(geometric.over(cables, background)[0, 0], [200, 100, 50])
    np.testing.assert_allclose(geometric.over(cables, background)[0, 1], [110, 85, 72.5])
    np.testing.assert_allclose(geometric.over(cables, background)[1], 80)


def scene() -> Image:
    coarse = rng(5).uniform(40, 200, (5, 5, 3)).astype(np.float32)
    return np.clip(cv2.resize(coarse, (64, 64), interpolation=cv2.INTER_CUBIC), 40, 200)


def test_low_light_is_darker_and_noisier_where_it_is_bright() -> None:
    for seed in range(6):
        flat = np.repeat(np.float32([[[50.0]], [[200.0]]]), 3, 2).repeat(50, 0).repeat(400, 1)
        dark = conditions.low_light(flat, rng(seed))
        assert dark.mean() < 0.8 * flat.mean()
        assert dark[50:].std() > 1.3 * dark[:50].std()
        assert dark[50:].mean() == pytest.approx(4 * dark[:50].mean(), rel=0.1)


def test_infrared_is_grey_and_warm_or_cold_bright() -> None:
    signs = set()
    for seed in range(8):
        seen = conditions.infrared(scene(), rng(seed))
        np.testing.assert_array_equal(seen[..., 0], seen[..., 2])
        luma = scene() @ np.array([0.299, 0.587, 0.114])
        correlation = np.corrcoef(luma.ravel(), seen[..., 0].ravel())[0, 1]
        assert abs(correlation) > 0.9
        signs.add(correlation > 0)
    assert signs == {True, False}


def test_shadows_darken_along_the_cables_shifted() -> None:
    image, line = np.full((100, 120, 3), 180, np.float32), np.array([[-50.0, 50.0], [170.0, 50.0]])
    seen = 0
    for seed in range(8):
        shaded = conditions.cable_shadows(image, [line], rng(seed))
        assert shaded.max() <= 180.001
        profile = 180 - shaded[:, 60, 0]
        if profile.max() > 1:
            seen += 1
            shift = rng(seed).uniform(-0.3, 0.3, 2)[1] * 100
            assert (profile * (np.arange(100) + 0.5)).sum() / profile.sum() == pytest.approx(
                50 + shift, abs=0.6
            )
            assert 5 < profile.max() < 95
    assert seen == 8


def test_a_quarter_of_images_is_in_low_light_or_infrared() -> None:
    image, line = scene()[:16, :16], np.array([[2.0, 2.0], [9.0, 9.0]])
    changed = [conditions.augment_further(image, [line], rng(seed))[0] for seed in range(300)]
    untouched = np.mean([np.array_equal(result, image) for result in changed])
    assert untouched == pytest.approx(0.75**13, abs=0.03)
