"""Where training and validation images come from."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from lsnet.errors import LSNetError
from lsnet.training.sources import TrainingData, open_sources

if TYPE_CHECKING:
    from pathlib import Path


def test_training_and_validation_never_share_a_drawn_image() -> None:
    ours, theirs = open_sources(TrainingData((), None, None, (), size=64, seed=3))
    assert not any(np.array_equal(ours[i].image, theirs[j].image) for i in range(3) for j in range(3))


@pytest.mark.parametrize("seed", [-1, 1_000_000, 2_000_000])
def test_seeds_of_validation_images_are_refused(seed: int) -> None:
    with pytest.raises(LSNetError, match="is that of validation images; give one from 0 to 999999"):
        open_sources(TrainingData((), None, None, (), size=64, seed=seed))


def write_renders(folder: Path, count: int) -> Path:
    """Pictures of one cable each, in rows that differ, as `model synth` would write them."""
    folder.mkdir()
    for i in range(count):
        pixels = np.zeros((64, 64, 4), np.uint8)
        pixels[3 * i + 10 : 3 * i + 12] = (0, 0, 255, 255)
        cv2.imwrite(str(folder / f"{i:06d}.png"), pixels)
        truth = {"size": [64, 64], "seed": 0, "lines": [[[-9, 3 * i + 11], [70, 3 * i + 11]]]}
        (folder / f"{i:06d}.json").write_text(json.dumps(truth))
    return folder


@pytest.mark.parametrize("augmentation", ["all", "paper"])
def test_training_on_renders_validates_on_others_over_other_photographs(
    tmp_path: Path, augmentation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last of ten pictures and of ten photographs are for validation, and for nothing else."""
    (tmp_path / "photos").mkdir()
    for i in range(10):
        cv2.imwrite(str(tmp_path / f"photos/{i}.png"), np.full((70, 70, 3), 20 * i, np.uint8))
    renders = write_renders(tmp_path / "renders", 10)
    data = TrainingData((str(tmp_path / "photos"),), None, None, (), 64, 3, renders, augmentation)
    assert "last tenth held out" in data.describe()
    seen = []
    for source in open_sources(data):
        pool = source.pool if augmentation == "paper" else source._pool
        pictures = source.pictures if augmentation == "paper" else source._pictures
        seen.append(([int(p.stem) for p in pictures], [int(x[0, 0, 0]) // 20 for x in pool._folders[0]]))
        assert source[0].lines
    assert seen == [(list(range(9)), list(range(9))), ([9], [9])]


def test_scenes_of_the_paper_lie_over_photographs_only(tmp_path: Path) -> None:
    """Without clutter: what differs from the photograph's one colour is cable or augmentation of all."""
    (tmp_path / "photos").mkdir()
    cv2.imwrite(str(tmp_path / "photos/a.png"), np.full((80, 80, 3), 90, np.uint8))
    data = TrainingData((str(tmp_path / "photos"),), None, None, (), 64, 0, None, "paper")
    train_on, validate_on = open_sources(data)
    plain = 0
    for i in range(12):
        sample = train_on[i]
        np.testing.assert_array_equal(sample.image, train_on[i].image)
        _, counts = np.unique(sample.image.reshape(-1, 3), axis=0, return_counts=True)
        plain += counts.max() > 0.6 * 64 * 64
        assert len(sample.lines) > 0
    assert plain >= 3  # noise is added to a quarter only
    assert not np.array_equal(train_on[0].image, validate_on[0].image)


def test_data_that_cannot_be_trained_on_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LSNetError, match="multiple of 16"):
        open_sources(TrainingData((), None, None, (), size=100, seed=0))
    with pytest.raises(LSNetError, match="other ones for validation"):
        open_sources(TrainingData((), tmp_path, None, (), size=64, seed=0))
    with pytest.raises(LSNetError, match="give some as data"):
        open_sources(TrainingData((), None, tmp_path, (), size=64, seed=0))
    with pytest.raises(LSNetError, match="leave out backgrounds and rendered"):
        open_sources(TrainingData(("photos",), tmp_path, tmp_path, (), size=64, seed=0))
    with pytest.raises(LSNetError, match="not a folder"):
        open_sources(TrainingData((f"{tmp_path}/none:5",), None, None, (), size=64, seed=0))


def test_the_recipe_names_its_data(tmp_path: Path) -> None:
    drawn = TrainingData((f"{tmp_path}/a:5", f"{tmp_path}/b"), None, None, (), size=64, seed=3)
    assert drawn.describe() == "drawn on a, first 5, b, 64 px, seed 3"
    labelled = TrainingData((), tmp_path / "rails", tmp_path, (), size=64, seed=0)
    assert labelled.describe() == "labelled rails, 64 px, seed 0"
