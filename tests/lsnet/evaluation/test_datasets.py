"""Evaluation sets made by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.errors import LSNetError
from lsnet.evaluation.datasets import cable_mask, images_of, load_truth

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def write(path: Path, image: NDArray[np.generic]) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image.astype(np.uint8))
    return path


def contours(*columns: int) -> NDArray[np.bool_]:
    """Vertical contours, one pixel wide, at the columns of an image of 100 x 120."""
    drawn = np.zeros((100, 120), bool)
    drawn[:, list(columns)] = True
    return drawn


def columns_of(mask: NDArray[np.bool_]) -> list[int]:
    assert (mask == mask[:1]).all()
    return np.flatnonzero(mask[0]).tolist()


def test_a_cable_lies_between_its_contours() -> None:
    assert columns_of(cable_mask(contours(40, 47))) == list(range(40, 48))


def test_ground_between_two_cables_is_ground() -> None:
    mask = cable_mask(contours(30, 36, 60, 68))
    assert columns_of(mask) == [*range(30, 37), *range(60, 69)]


def test_twin_cables_keep_a_gap() -> None:
    mask = cable_mask(contours(40, 46, 52, 58))
    assert columns_of(mask) == [*range(40, 47), *range(52, 59)]


def test_regions_wider_than_a_cable_are_ground() -> None:
    """Each contour stays as a cable of its own."""
    assert not cable_mask(contours(30, 80))[:, 35:75].any()


def test_touching_contours_are_closed_to_a_cable() -> None:
    assert columns_of(cable_mask(contours(50, 51))) == [50, 51]


def test_no_contours_no_cables() -> None:
    assert not cable_mask(np.zeros((50, 60), bool)).any()


def test_the_centreline_of_a_pair_of_contours(tmp_path: Path) -> None:
    image = write(tmp_path / "7.jpg", np.zeros((100, 120, 3)))
    write(tmp_path / "7.boundary.png", contours(40, 48) * 255)
    kind, files = images_of(tmp_path)
    assert (kind, files) == ("contours", [image])
    truth = load_truth(kind, image, (100, 120))
    assert columns_of(truth.mask) == list(range(40, 49))
    assert np.flatnonzero(truth.centreline[50]).tolist() == [44]
    assert truth.centreline.sum() == pytest.approx(100, abs=10)
    assert truth.half_width_px[50, 44] == pytest.approx(5, abs=0.5)


def test_masks_lie_beside_the_images(tmp_path: Path) -> None:
    image, mask = write(tmp_path / "images/a.jpg", np.zeros((60, 80, 3))), np.zeros((60, 80), bool)
    mask[30:35] = True
    write(tmp_path / "masks/a.png", mask)  # ones, not 255
    kind, files = images_of(tmp_path)
    assert (kind, files) == ("masks", [image])
    truth = load_truth(kind, image, (60, 80))
    np.testing.assert_array_equal(truth.mask, mask)
    assert np.flatnonzero(truth.centreline[:, 40]).tolist() == [32]
    assert truth.half_width_px[32, 40] == pytest.approx(3, abs=0.1)


def test_other_folders_are_plain_sets_sorted_by_name(tmp_path: Path) -> None:
    for name in ("b.png", "a.JPG", "c.txt"):
        (tmp_path / name).touch()
    kind, files = images_of(tmp_path)
    assert (kind, [f.name for f in files]) == ("plain", ["a.JPG", "b.png"])


def test_no_images_is_one_line(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(LSNetError, match="no images to evaluate"):
            images_of(folder)


def test_a_missing_or_damaged_truth_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    image = write(tmp_path / "7.jpg", np.zeros((10, 10, 3)))
    with pytest.raises(LSNetError, match=r"7\.boundary\.png: missing or not an image"):
        load_truth("contours", image, (10, 10))
    (tmp_path / "7.boundary.png").write_bytes(b"no image")
    with pytest.raises(LSNetError, match=r"7\.boundary\.png: missing or not an image"):
        load_truth("contours", image, (10, 10))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["a.bmp", "a.png", "a_mask.png", "a_gt.tif", "a_GT.bmp", "a_label.png"])
def test_masks_of_other_names_and_formats_are_read(tmp_path: Path, name: str) -> None:
    image = write(tmp_path / "images/a.jpg", np.zeros((30, 40, 3)))
    mask = np.zeros((30, 40))
    mask[5:8] = 255
    write(tmp_path / "masks" / name, mask)
    assert load_truth("masks", image, (30, 40)).mask.sum() == 3 * 40
