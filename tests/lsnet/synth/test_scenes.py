"""Drawn training images: each technique alone, cables along their centrelines."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.errors import LSNetError
from lsnet.synth import augment, dataset, scene
from lsnet.synth.augment import PHOTOMETRIC, elastic
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool, cut_out, plain, vegetation
from lsnet.synth.cables import Arc, Finish, draw_cable
from lsnet.synth.clutter import borders, clutter, structures
from lsnet.synth.dataset import SyntheticScenes
from lsnet.synth.scene import add_cables

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Image = NDArray[np.float32]

FLAT = Finish((0.0, 0.0, 0.0), ambient=1.0, diffuse=0.0, specular=0.0, light=0.0, strand_px=0.0)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def photo(size: int = 64) -> Image:
    """A smooth coloured picture, 40 to 200."""
    coarse = rng(5).uniform(40, 200, (5, 5, 3)).astype(np.float32)
    return np.clip(cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC), 40, 200)


# Augmentation


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


# Cables


def slanted(degrees: float, sag_px: float = 0.0) -> Arc:
    along = np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))]) * 150
    start, end = np.array([64.3, 63.8]) - along, np.array([64.3, 63.8]) + along
    return Arc((start[0], start[1]), (end[0], end[1]), sag_px)


@pytest.mark.parametrize("sag_px", [0.0, 12.0, -30.0])
@pytest.mark.parametrize("degrees", [0, 17, 45, 90, 120])
@pytest.mark.parametrize("width_px", [1.0, 4.0, 11.0])
def test_a_cable_is_drawn_along_its_centreline(width_px: float, degrees: float, sag_px: float) -> None:
    """The centroid of what is dark, across the cable, is on the line through its points."""
    image = np.full((128, 128, 3), 200, np.float32)
    arc = slanted(degrees, sag_px)
    draw_cable(image, arc, (width_px, width_px), FLAT)
    darkness, widths = 200 - image[..., 0], []
    points = arc.points(601)
    middles, directions = (points[1:] + points[:-1]) / 2, np.diff(points, axis=0)
    inside = np.all((middles > 20) & (middles < 108), axis=1)
    assert inside.any()
    for middle, direction in zip(middles[inside][::6], directions[inside][::6], strict=True):
        normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction)
        t = np.linspace(-12, 12, 241)
        across = middle + t[:, None] * normal - 0.5  # OpenCV counts from pixel centres
        sampled = cv2.remap(
            darkness, across[:, :1].astype(np.float32), across[:, 1:].astype(np.float32), cv2.INTER_LINEAR
        )[:, 0]
        assert (sampled * t).sum() / sampled.sum() == pytest.approx(0, abs=0.25)
        widths.append(sampled.sum() * 0.1 / 200)
    assert np.mean(widths) == pytest.approx(width_px, rel=0.1)


@pytest.mark.parametrize("width_px", [0.2, 0.5, 0.9])
def test_cables_under_a_pixel_fade(width_px: float) -> None:
    image = np.full((64, 64, 3), 200, np.float32)
    draw_cable(image, Arc((-5, 32.5), (70, 32.5), 0.0), (width_px, width_px), FLAT)
    darkness = 200 - image[..., 0]
    np.testing.assert_allclose(darkness.sum(axis=0) / 200, width_px, rtol=0.02)
    np.testing.assert_allclose(darkness.max(axis=0) / 200, width_px, rtol=0.02)


def test_a_cable_narrows_towards_its_end_and_stops_there() -> None:
    image = np.full((64, 200, 3), 200, np.float32)
    draw_cable(image, Arc((20, 32), (180, 32), 0.0), (12, 4), FLAT)
    width = (200 - image[..., 0]).sum(axis=0) / 200
    np.testing.assert_allclose(
        width[[40, 100, 160]], [12 - 8 * (x - 19.5) / 160 for x in (40, 100, 160)], atol=0.2
    )
    assert not width[:18].any()
    assert not width[182:].any()


def test_leaves_hide_a_cable() -> None:
    image, visible = np.full((32, 64, 3), 200, np.float32), np.ones((32, 64), np.float32)
    visible[:, 20:40] = 0
    draw_cable(image, Arc((-5, 16), (70, 16), 0.0), (4, 4), FLAT, visible)
    assert (image[:, 20:40] == 200).all()
    assert (image[15, :20] == 0).all()


def test_light_falls_on_one_side_and_strands_repeat_along_the_cable() -> None:
    image = np.full((32, 200, 3), 100, np.float32)
    lit = Finish((150.0, 150.0, 150.0), 0.4, 0.6, 0.0, light=0.9, strand_px=12.0)
    draw_cable(image, Arc((-5, 16), (205, 16), 0.0), (12, 12), lit)
    # The light is to the right of the direction of travel, which is down for a cable drawn rightwards.
    assert image[20, :, 0].mean() > image[12, :, 0].mean() + 30
    spectrum = np.abs(np.fft.rfft(image[16, 4:196, 0] - image[16, 4:196, 0].mean()))
    assert spectrum.argmax() == 192 / 12


def test_arcs_sag_to_the_right_of_their_direction() -> None:
    points = Arc((0, 0), (100, 0), 10.0).points(5)
    np.testing.assert_allclose(points, [[0, 0], [25, 7.5], [50, 10], [75, 7.5], [100, 0]])


def test_cable_outside_the_image_changes_nothing() -> None:
    image = np.full((32, 32, 3), 200, np.float32)
    draw_cable(image, Arc((-50, -90), (80, -90), 0.0), (8, 8), FLAT)
    assert (image == 200).all()


def test_every_drawn_cable_is_returned_and_nothing_else() -> None:
    """Each changed pixel is near a returned centreline; most pixels of centrelines have changed."""
    for seed in range(6):
        image = np.full((128, 128, 3), 120, np.float32)
        centrelines = add_cables(image, rng(seed))
        changed = np.abs(image - 120).max(axis=2) > 4
        drawn = np.zeros((128, 128), np.uint8)
        for line in centrelines:
            cv2.polylines(drawn, [np.round((line - 0.5) * 16).astype(np.int32)], False, 1, 1, cv2.LINE_8, 4)
        distance = cv2.distanceTransform(1 - drawn, cv2.DIST_L2, 5)
        assert changed.any() == drawn.any()
        if not drawn.any():
            continue
        assert distance[changed].max(initial=0) < 9.5
        assert changed[drawn > 0].mean() > 0.5


# Backgrounds and whole scenes


def write_photos(folder: Path, count: int = 4) -> Path:
    """Photographs 0.png, 1.png, ... each all of one grey, 40 times its number."""
    folder.mkdir(parents=True, exist_ok=True)
    for i in range(count):
        cv2.imwrite(str(folder / f"{i}.png"), np.full((100, 140, 3), 40 * i, np.uint8))
    (folder / "notes.txt").write_text("no image")
    return folder


def test_background_folders_as_written_on_the_command_line(tmp_path: Path) -> None:
    write_photos(tmp_path / "a")
    cases = [(f"{tmp_path}/a", 4), (f"{tmp_path}/a:2", 2), (f"{tmp_path}/a:99", 4)]
    for text, count in cases:
        files = BackgroundFolder.parse(text).files()
        assert [f.name for f in files] == [f"{i}.png" for i in range(count)]
    write_photos(tmp_path / "odd:name")
    assert len(BackgroundFolder.parse(f"{tmp_path}/odd:name").files()) == 4
    assert str(BackgroundFolder.parse("x/a:2")) == "a, first 2"
    assert BackgroundFolder.parse("a:²").path.name == "a:²"


def test_background_folders_that_cannot_be_used_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad/a.jpg").write_text("no image")
    with pytest.raises(LSNetError, match="not a folder"):
        BackgroundFolder.parse(f"{tmp_path}/none:3").files()
    with pytest.raises(LSNetError, match="no images in this folder"):
        BackgroundFolder.parse(str(tmp_path / "empty")).files()
    with pytest.raises(LSNetError, match=r"a\.jpg: cannot be read as an image"):
        BackgroundPool([BackgroundFolder.parse(str(tmp_path / "bad"))])


def test_only_the_first_photographs_are_used(tmp_path: Path) -> None:
    pool = BackgroundPool([BackgroundFolder.parse(f"{write_photos(tmp_path)}:1")])
    samples = [pool.sample(rng(seed), 128) for seed in range(30)]
    assert all((s.shape, s.dtype) == ((128, 128, 3), np.float32) for s in samples)
    # Photograph 0 is black but for grain; the others would be bright. Some grounds are drawn.
    black = [abs(s.mean()) < 1 for s in samples]
    assert 15 < sum(black) < 30


def test_crops_contain_pixels_of_the_photograph() -> None:
    image = np.zeros((300, 400, 3), np.uint8)
    image[..., 1] = 77
    for seed in range(5):
        cut = cut_out(image, rng(seed), 96)
        assert cut.shape == (96, 96, 3)
        assert np.median(cut[..., 1]) == pytest.approx(77, abs=1)


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (2, 2)])
def test_photographs_of_a_few_pixels_are_used_too(size: tuple[int, int]) -> None:
    for seed in range(5):
        assert cut_out(np.zeros((*size, 3), np.uint8), rng(seed), 32).shape == (32, 32, 3)


def test_plain_grounds_are_of_any_brightness() -> None:
    means = [plain(rng(seed), 48).mean() for seed in range(30)]
    assert min(means) < 70
    assert max(means) > 180


def test_vegetation_has_more_contrast_within_a_few_pixels_than_plain_ground() -> None:
    def contrast(image: Image) -> float:
        calm = cv2.GaussianBlur(image.mean(axis=2), (0, 0), 1.5)  # grain averages out
        return float(np.abs(calm - cv2.GaussianBlur(calm, (0, 0), 6)).mean())

    leaves, plains = ([contrast(make(rng(seed), 96)) for seed in range(20)] for make in (vegetation, plain))
    assert np.median(leaves) > 2 * np.median(plains)


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


@pytest.mark.parametrize("paint", clutter.KINDS, ids=lambda f: f.__name__)
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
    monkeypatch.setattr(dataset, "add_clutter", lambda *_: None)
    monkeypatch.setattr(dataset, "add_cables", black_row)
    monkeypatch.setattr(dataset, "augment_further", lambda image, lines, _rng: (image, lines))
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
