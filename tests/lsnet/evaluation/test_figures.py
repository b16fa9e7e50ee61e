"""Figures: which pixels are shown where."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evaluation_sets import write_masks

from lsnet.errors import LSNetError
from lsnet.evaluation.figures import (
    CAPTION_PX,
    FOUND,
    GAP_PX,
    augmentation_panels,
    detection_panels,
    draw_losses,
    grid_panels,
    montage,
    pixels_of_segments,
)
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from pathlib import Path


class Rows:
    """Finds one row for each grid, 10 px apart."""

    def __init__(self, grids: str = "M") -> None:
        self._count = len(grids)

    def detect(self, images: list[np.ndarray]) -> list[Detections]:
        ends = np.array([[0, 10.5 * i, 70, 10.5 * i] for i in range(1, self._count + 1)], np.float32)
        size = images[0].shape[:2]
        return [Detections(Segments(ends, np.full(len(ends), 0.9, np.float32), size), Lines.empty(size))]


def is_marked(panel: np.ndarray) -> np.ndarray:
    return (panel == FOUND).all(axis=2)


def test_a_row_has_image_truth_and_detections(tmp_path: Path) -> None:
    rows = detection_panels(write_masks(tmp_path / "m"), {"rows": pixels_of_segments(Rows(), 0.5)}, count=3)
    ((first, truth, found),) = rows  # one image is all there is
    assert (first[0], truth[0], found[0]) == ("a", "truth", "rows")
    assert np.unique(is_marked(truth[1]).nonzero()[0]).tolist() == [30, 31, 32, 33]
    assert set(is_marked(found[1]).nonzero()[0]) >= {10, 11}
    picture = montage(rows, width=40)
    assert picture.shape == (32 + CAPTION_PX + GAP_PX, 3 * (40 + GAP_PX), 3)


def test_more_grids_show_more_segments() -> None:
    ((one, two, three, four),) = grid_panels(Rows, np.zeros((64, 80, 3), np.uint8), 0.5)
    assert [name for name, _ in (one, two, three, four)] == ["M", "MH", "MVH", "MHVC"]
    counts = [int(is_marked(panel).sum()) for _, panel in (one, two, three, four)]
    assert counts == [k * 71 * 5 for k in (1, 2, 3, 4)]


def test_each_augmentation_of_the_paper_changes_the_image() -> None:
    panels = [panel for row in augmentation_panels((), size=96, seed=1) for panel in row]
    assert len(panels) == 8
    original = panels[0][1]
    for name, panel in panels[1:]:
        assert panel.shape == original.shape, name
        assert not np.array_equal(panel, original), name
    again = [panel for row in augmentation_panels((), size=96, seed=1) for panel in row]
    assert all(np.array_equal(a[1], b[1]) for a, b in zip(panels, again, strict=True))


def test_losses_of_runs_are_drawn_by_part(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for name in ("stride", "pool"):
        (tmp_path / name).mkdir()
        entry = {"step": 5, "validation_classification": 0.4, "validation_regression": 1.2}
        (tmp_path / name / "log.jsonl").write_text(json.dumps(entry) + "\n")
    draw_losses({name: tmp_path / name for name in ("stride", "pool")}, tmp_path / "losses.png")
    assert (tmp_path / "losses.png").read_bytes().startswith(b"\x89PNG")
    (tmp_path / "pool/log.jsonl").write_text('{"step": 5, "validation_loss": 1}\n')
    with pytest.raises(LSNetError, match=r"pool/log\.jsonl: no log of losses by part"):
        draw_losses({"pool": tmp_path / "pool"}, tmp_path / "losses.png")
