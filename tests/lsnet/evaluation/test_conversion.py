"""Published folders of images and masks become evaluation sets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.errors import LSNetError
from lsnet.evaluation.conversion import convert_set, read_mask
from lsnet.evaluation.datasets import images_of, load_truth

if TYPE_CHECKING:
    from pathlib import Path


def write(path: Path, value: int, line: int | None = None) -> None:
    """An image of one grey, or a mask with one bright row."""
    path.parent.mkdir(parents=True, exist_ok=True)
    pixels = np.full((40, 50), value, np.uint8)
    if line is not None:
        pixels[line] = 255 - value
    assert cv2.imwrite(str(path), pixels)


@pytest.mark.parametrize(
    ("image", "mask", "name"),
    [
        ("VL/1.bmp", "VL_gt/1.bmp", "VL_1"),
        ("IR/images/a.jpg", "IR/GroundTruth/a.png", "IR_a"),
        ("x.png", "x_gt.bmp", "x"),
        ("set/x.png", "set/mask_x.png", "set_x"),
        ("images/B.tif", "masks/b_GT.png", "B"),
    ],
)
def test_masks_are_found_by_their_names(tmp_path: Path, image: str, mask: str, name: str) -> None:
    write(tmp_path / "in" / image, 90)
    write(tmp_path / "in" / mask, 0, line=7)
    write(tmp_path / "in/alone.png", 90)
    assert convert_set(tmp_path / "in", tmp_path / "out") == (1, 1)
    kind, (file,) = images_of(tmp_path / "out")
    assert (kind, file.stem) == ("masks", name)
    assert np.unique(load_truth(kind, file, (40, 50)).mask.nonzero()[0]).tolist() == [7]


def test_dark_lines_on_bright_masks_are_inverted(tmp_path: Path) -> None:
    for value in (0, 255):
        write(tmp_path / "m.png", value, line=3)
        assert np.unique(read_mask(tmp_path / "m.png").nonzero()[0]).tolist() == [3]


def test_unusable_sets_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(LSNetError, match="none: not a folder"):
        convert_set(tmp_path / "none", tmp_path / "out")
    write(tmp_path / "in/a.png", 90)
    with pytest.raises(LSNetError, match="no image with a mask; give a folder"):
        convert_set(tmp_path / "in", tmp_path / "out")
    (tmp_path / "in/gt").mkdir()
    cv2.imwrite(str(tmp_path / "in/gt/a.png"), np.zeros((3, 3), np.uint8))
    with pytest.raises(LSNetError, match=r"gt/a\.png: not the size of"):
        convert_set(tmp_path / "in", tmp_path / "out")
