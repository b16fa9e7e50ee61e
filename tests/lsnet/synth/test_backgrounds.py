"""Backgrounds: folders of photographs, crops, drawn grounds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from photos import write_photos

from lsnet.errors import LSNetError
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool, cut_out, plain, vegetation

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Image = NDArray[np.float32]


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


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
