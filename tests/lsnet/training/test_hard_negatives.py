"""Hard negatives: every false alarm lies in a square, and nothing else is cut out."""

from __future__ import annotations

from typing import TYPE_CHECKING, cast

import cv2
import numpy as np
import pytest

from lsnet import Detections, Detector, Lines, Segments
from lsnet.errors import LSNetError
from lsnet.files import write_png
from lsnet.training import hard_negatives as mining

if TYPE_CHECKING:
    from pathlib import Path

NO_LINES = Lines((), np.zeros(0, np.float32), (1, 1))


class FixedDetector:
    """A detector that reports the given segments for every image."""

    def __init__(self, rows: list[list[float]], scale: float = 1.0) -> None:
        self.rows, self.scale = np.array(rows, np.float32).reshape(-1, 5), scale

    def levels_of(self, _image: np.ndarray) -> tuple[float, ...]:
        return (self.scale,)

    def detect(self, images: list[np.ndarray]) -> list[Detections]:
        size = images[0].shape[:2]
        result = Segments(self.rows[:, :4], self.rows[:, 4], (size[0], size[1]))
        return [Detections(result, NO_LINES, np.full(len(result), -1, np.int32))]


def position_photo(height: int, width: int) -> np.ndarray:
    """Each pixel holds its own x and y, halved."""
    y, x = np.mgrid[:height, :width] // 8
    return np.stack([x, y, np.zeros_like(x)], axis=2).astype(np.uint8)


def squares(rows: list[list[float]], photo: np.ndarray, scale: float = 1.0) -> list[np.ndarray]:
    return mining.hard_squares(photo, cast("Detector", FixedDetector(rows, scale)))


def test_segment_of_the_highest_score_is_in_the_middle_of_the_first_square() -> None:
    photo = position_photo(1200, 1600)
    found = squares([[100, 100, 120, 100, 0.4], [790, 600, 810, 600, 0.9], [700, 500, 720, 500, 0.8]], photo)
    assert [square.shape for square in found] == [(512, 512, 3)] * 2
    np.testing.assert_array_equal(found[0], photo[344:856, 544:1056])
    np.testing.assert_array_equal(found[1], photo[:512, :512])


def test_no_segments_give_no_squares() -> None:
    assert squares([], position_photo(600, 600)) == []


def test_squares_match_the_network_input_within_the_photograph() -> None:
    assert squares([[5, 5, 9, 9, 1]], position_photo(1200, 1600), scale=0.5)[0].shape == (1024, 1024, 3)
    assert squares([[5, 5, 9, 9, 1]], position_photo(96, 128), scale=3)[0].shape == (96, 96, 3)


def test_squares_are_written_under_the_name_of_their_photograph(tmp_path: Path) -> None:
    photos, output = tmp_path / "photos", tmp_path / "hard"
    photos.mkdir()
    for name in "ab":
        cv2.imwrite(str(photos / f"{name}.png"), position_photo(600, 700)[..., ::-1])
    detector = cast("Detector", FixedDetector([[40, 40, 60, 40, 0.5]]))
    assert list(mining.mine(detector, [f"{photos}:1"], output)) == [1]
    assert list(mining.named_photos([str(photos)])) == ["photos_a", "photos_b"]
    (file,) = output.iterdir()
    assert file.name == "photos_a_000.png"
    np.testing.assert_array_equal(cv2.imread(str(file))[..., ::-1], position_photo(600, 700)[:512, :512])


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LSNetError, match="cannot be created as a folder"):
        list(mining.mine(cast("Detector", FixedDetector([])), [], tmp_path / "file"))


def test_squares_of_the_same_name_are_one_line(tmp_path: Path) -> None:
    for folder, name in (("a/photos", "1.png"), ("b/photos", "1.jpg")):
        (tmp_path / folder).mkdir(parents=True)
        cv2.imwrite(str(tmp_path / folder / name), position_photo(40, 40))
    with pytest.raises(LSNetError, match=r"1\.png and .*1\.jpg would have squares of the same names"):
        list(
            mining.mine(
                cast("Detector", FixedDetector([])),
                [f"{tmp_path}/{k}/photos" for k in "ab"],
                tmp_path / "hard",
            )
        )


def test_a_square_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LSNetError, match=r"a\.png: cannot be written; name another folder"):
        write_png(tmp_path / "none/a.png", position_photo(4, 4))
