"""Whole drawn scenes: clutter, cables, the same for the same seed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from photos import write_photos

from lsnet.synth import dataset, drawing, scene
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.cables import Finish
from lsnet.synth.clutter import borders, clutter, structures
from lsnet.synth.dataset import SyntheticScenes
from lsnet.synth.scene import add_cables
from lsnet.synth.streets import WIDEST_PX, add_street

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Image = NDArray[np.float32]


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize(("kind", "least_px"), [("calm", 0.9), ("busy", 2.9)])
def test_cables_are_as_wide_as_the_ground_needs(
    kind: str, least_px: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    widths = []
    monkeypatch.setattr(scene, "draw_cable", lambda _image, _arc, width_px, *_: widths.append(width_px[0]))
    image = np.full((64, 64, 3), 120, np.float32)
    if kind == "busy":
        image[:] = rng(0).choice([20, 220], (64, 64, 1))
    for seed in range(60):
        add_cables(image, rng(seed))
    assert least_px <= min(widths) < least_px + 0.5
    assert max(widths) <= 14


def test_roadside_keeps_the_ground_on_one_side() -> None:
    shares = []
    for seed in range(12):
        image = np.full((128, 128, 3), 77, np.uint8)
        borders.roadside(image, rng(seed))
        shares.append((image == 77).all(axis=2).mean())
    assert 0.05 < np.median(shares) < 0.95
    assert min(shares) < 0.5 < max(shares)


@pytest.mark.parametrize(
    "paint", [*clutter.KINDS, *clutter.YARD_KINDS, borders.road_bend], ids=lambda f: f.__name__
)
def test_clutter_paints_and_is_the_same_for_the_same_seed(paint: Callable[..., None]) -> None:
    images = [np.full((256, 256, 3), 120, np.uint8) for _ in range(5)]
    for image, seed in zip(images, (0, 1, 2, 3, 0), strict=True):
        paint(image, rng(seed))
    np.testing.assert_array_equal(images[0], images[4])
    assert any((image != 120).any() for image in images)


def test_shadows_are_dark_lines_with_visible_ground() -> None:
    """Of bright and dark stripes the same share of the light is left; small pictures have none."""
    ground = np.full((300, 300, 3), 200, np.uint8)
    ground[:, ::2] = 100
    for seed in range(5):
        shaded = ground.copy()
        structures.shadows(shaded, rng(seed))
        left = shaded / ground.astype(float)
        assert left.max() <= 1
        assert 0.3 < left.min() < 0.95
        assert 0.01 < (left.min(axis=2) < 0.97).mean() < 0.6
        np.testing.assert_allclose(left[:, ::2].mean(), left[:, 1::2].mean(), atol=0.01)
    small = np.full((128, 128, 3), 200, np.uint8)
    structures.shadows(small, rng())
    assert (small == 200).all()


def test_the_lines_of_a_street_are_its_wires_and_not_its_poles() -> None:
    """All wires are magenta and at least 2 px wide, poles are grey."""
    magenta = Finish((255.0, 0.0, 255.0), ambient=1.0, diffuse=0.0, specular=0.0, light=0.0, strand_px=0.0)
    for seed in range(6):
        image = np.full((300, 400, 3), 120, np.uint8)
        lines = add_street(image, rng(seed), lambda: magenta)
        is_wire = image[..., 0].astype(int) - image[..., 1] > 130
        touches = cv2.dilate(is_wire.astype(np.uint8), np.ones((3, 3), np.uint8))
        is_near = np.zeros(is_wire.shape, np.uint8)
        for line in lines:
            cv2.polylines(is_near, [np.round(line).astype(np.int32)], False, 1, round(2 * WIDEST_PX) + 2)
            x, y = np.floor(line).astype(int).T
            inside = (x >= 0) & (x < 400) & (y >= 0) & (y < 300)
            assert touches[y[inside], x[inside]].all()
        assert not (is_wire & (is_near == 0)).any()


def test_scenes_are_the_same_for_the_same_seed_and_index(tmp_path: Path) -> None:
    pool = BackgroundPool([BackgroundFolder(write_photos(tmp_path))])
    one, two = SyntheticScenes(pool, 96, seed=4), SyntheticScenes(pool, 96, seed=4)
    for i in (7, 0, 3):
        np.testing.assert_array_equal(one[i].image, two[i].image)
        assert all(np.array_equal(a, b) for a, b in zip(one[i].lines, two[i].lines, strict=True))
        assert (one[i].image.shape, one[i].image.dtype) == ((96, 96, 3), np.uint8)
    assert not np.array_equal(one[0].image, one[1].image)
    assert not np.array_equal(one[0].image, SyntheticScenes(pool, 96, seed=5)[0].image)


def test_small_scenes_are_enlarged_with_their_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """A black row over white, drawn at a half to a quarter of the size, is where its line says."""

    class White(BackgroundPool):
        def sample(self, _rng: np.random.Generator, size: int) -> Image:
            return np.full((size, size, 3), 255, np.float32)

    def black_row(image: Image, _rng: np.random.Generator) -> list[NDArray[np.float64]]:
        size = len(image)
        image[size // 3] = 0
        return [np.array([[0, size // 3 + 0.5], [size, size // 3 + 0.5]])]

    monkeypatch.setattr(dataset, "SMALL_SHARE", 1.0)
    monkeypatch.setattr(drawing, "add_bends", lambda *_: None)
    monkeypatch.setattr(drawing, "add_clutter", lambda *_: None)
    monkeypatch.setattr(drawing, "add_cables", black_row)
    monkeypatch.setattr(drawing, "augment_further", lambda image, lines, _rng: (image, lines))
    widths = set()
    for i in range(12):
        sample = SyntheticScenes(White([]), 96)[i]
        for line in sample.lines:
            darkness = 255.0 - sample.image[:, 48, 0]
            np.testing.assert_allclose((darkness * (np.arange(96) + 0.5)).sum() / darkness.sum(), line[0, 1])
            widths.add(round(darkness.sum() / 255))
            assert line[1, 0] == 96
    assert widths == {2, 3, 4}


def test_about_a_fifth_of_the_scenes_have_no_cable() -> None:
    scenes = SyntheticScenes(BackgroundPool([]), 32)
    empty = np.mean([not scenes[i].lines for i in range(120)])
    assert empty == pytest.approx(0.2, abs=0.1)
