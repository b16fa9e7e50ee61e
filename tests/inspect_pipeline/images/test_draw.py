"""Pictures: where strokes lie, what stays visible, which files are written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from inspect_pipeline.errors import OutputError
from inspect_pipeline.images.draw import (
    add_strip,
    draw_heat,
    draw_lines,
    draw_place,
    draw_scores,
    score_colours,
    track_colours,
    write_picture,
)

if TYPE_CHECKING:
    from pathlib import Path

GREY = np.full((60, 100, 3), 120, np.uint8)


def test_the_wire_stays_visible_between_two_rails() -> None:
    drawn = draw_lines(
        GREY, [np.array([[0, 30.5], [100, 30.5]], np.float32)], np.array([[255, 0, 140]], np.uint8)
    )
    column = drawn[:, 50].astype(int)
    changed = np.flatnonzero((column != 120).any(axis=1))
    assert (column[30] == 120).all()
    assert changed.min() < 30 < changed.max()
    assert 30 - changed.min() == changed.max() - 30
    assert np.abs(column[changed.min() + 1] - [255, 0, 140]).max() < 40
    assert (GREY == 120).all()


def test_no_lines_leave_the_picture_as_it_is() -> None:
    assert (draw_lines(GREY, [], np.zeros((0, 3), np.uint8)) == GREY).all()


def test_colours_spread_from_the_least_score_to_one() -> None:
    low, middle, high, beyond = score_colours(np.array([0.4, 0.7, 1.0, 0.1], np.float32), 0.4).astype(int)
    assert (low == beyond).all()
    assert low[0] < middle[0] < high[0]
    assert (high == [255, 0, 140]).all()


def test_a_track_keeps_its_colour_and_differs_from_the_next() -> None:
    colours = track_colours([4, None, 4, 5]).tolist()
    assert colours[0] == colours[2] != colours[3]
    assert colours[1] not in (colours[0], colours[3])
    assert track_colours([]).shape == (0, 3)


def test_scores_and_places_are_drawn_where_they_belong() -> None:
    line = np.array([[10, 50], [90, 50]], np.float32)
    scored = np.argwhere((draw_scores(GREY, [line], np.array([0.5], np.float32)) != 120).any(axis=2))
    assert scored[:, 1].min() >= 10
    ring = np.argwhere((draw_place(GREY, np.array([50.0, 30.0]), 12.0) != 120).any(axis=2))
    distances = np.hypot(*(ring - (30, 50)).T)
    assert 8 < distances.min() < distances.max() < 16


def test_the_strip_is_below_the_picture() -> None:
    drawn = add_strip(GREY, "2026-05-04 and much more text than there is room for" * 3, "frame 7")
    assert drawn.shape[1] == 100
    assert (drawn[:60] == 120).all()
    assert drawn[60:].max() > 200  # its text


def test_heat_grows_with_confidence() -> None:
    confidence = np.tile(np.linspace(0, 1, 100, dtype=np.float32), (60, 1))
    brightness = draw_heat(GREY, confidence).sum(axis=2)[0]
    assert brightness[0] < brightness[50] < brightness[99]


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_pictures_are_rgb(tmp_path: Path, name: str) -> None:
    write_picture(tmp_path / name, np.full((8, 8, 3), (200, 30, 10), np.uint8))
    assert np.abs(cv2.imread(str(tmp_path / name)).astype(int) - (10, 30, 200)).max() < 5


@pytest.mark.parametrize("name", ["a.txt", "a", "none/a.png"])
def test_pictures_that_cannot_be_written(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=name):
        write_picture(tmp_path / name, GREY)
    assert not list(tmp_path.iterdir())
