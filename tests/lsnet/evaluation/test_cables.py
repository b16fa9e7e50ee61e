"""Scores on known cables, by hand."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field

import numpy as np
import pytest

from lsnet.evaluation.cables import CableReport, cable_coverage, evaluate_cables
from lsnet.segments import Detections, Lines, Segments
from lsnet.synth.drawing import Sample

SIZE = 128


@dataclass
class Scenes:
    """An image with a level cable at row 40 and one at row 90, and an empty one."""

    size: int = SIZE

    def __getitem__(self, index: int) -> Sample:
        lines = [np.array([[-20.0, y], [150.0, y]]) for y in (40.5, 90.5)] if index == 0 else []
        return Sample(np.full((SIZE, SIZE, 3), index, np.uint8), lines)


@dataclass
class Says:
    """Answers with these polylines and scores, by the number of the image."""

    said: dict[int, list[tuple[list[list[float]], float]]] = field(default_factory=dict)

    def detect(self, images: list[np.ndarray]) -> list[Detections]:
        found = []
        for image in images:
            rows = self.said.get(int(image[0, 0, 0]), [])
            points = tuple(np.array(p, np.float32) for p, _ in rows)
            lines = Lines(points, np.array([s for _, s in rows], np.float32), (SIZE, SIZE))
            found.append(Detections(Segments.empty((SIZE, SIZE)), lines))
        return found


def report(*said: tuple[list[list[float]], float], on_empty: tuple = ()) -> CableReport:
    finder = Says({0: list(said), 1: list(on_empty)})
    return evaluate_cables(finder, Scenes(), 2, min_score=0.5, use="lines")


WHOLE = [[[0, y], [128, y]] for y in (40.5, 90.5)]


def test_all_found() -> None:
    result = report((WHOLE[0], 0.9), (WHOLE[1], 0.6))
    assert (result.images, result.cables) == (2, 2)
    assert (result.sap5, result.sap15, result.covered_share, result.missed_share) == (1, 1, 1, 0)
    assert (result.gaps_per_cable, result.false_px) == (0, 0)
    assert (result.recalled_images, result.false_images) == (1, 0)
    assert "2 cables" in str(result)
    json.dumps(asdict(result))


def test_nothing_found() -> None:
    result = report()
    assert (result.sap10, result.covered_share, result.missed_share, result.recalled_images) == (0, 0, 1, 0)


def test_lines_below_the_threshold_count_for_structural_ap_only() -> None:
    result = report((WHOLE[0], 0.9), (WHOLE[1], 0.4))
    assert result.sap5 == 1
    assert (result.covered_share, result.missed_share) == (0.5, 0.5)


def test_gaps_and_shares() -> None:
    broken = [([[0, 40.5], [50, 40.5]], 0.9), ([[70, 40.5], [128, 40.5]], 0.9)]
    result = report(*broken, (WHOLE[1], 0.9))
    assert result.gaps_per_cable == 0.5
    # 20 px are not drawn, of which the tolerance of 3 px and the pixel itself cover some on either side.
    assert result.covered_share == pytest.approx(1 - 13 / 256, abs=0.01)
    assert result.missed_share == 0


def test_false_lines_count_on_images_with_and_without_cables() -> None:
    beside = [[10, 10.5], [59, 10.5]]
    result = report((WHOLE[0], 0.9), (WHOLE[1], 0.9), (beside, 0.8), on_empty=((beside, 0.7),))
    assert result.false_px == 50
    assert result.false_images == 1


@pytest.mark.parametrize(("row", "covered"), [(40, 100), (43, 100), (45, 0)])
def test_the_tolerance_is_three_pixels(row: int, covered: int) -> None:
    said = np.zeros((SIZE, SIZE), bool)
    said[row] = True
    cable = np.stack([np.arange(100) + 0.5, np.full(100, 40.5)], 1)
    (found,) = cable_coverage(said, [cable])
    assert (found.length_px, found.covered_px, found.gaps) == (100, covered, 0)


def test_segments_can_be_scored_instead_of_lines() -> None:
    class SaysSegments(Says):
        def detect(self, images: list[np.ndarray]) -> list[Detections]:
            halves = [[0, 40.5, 64, 40.5], [64, 40.5, 128, 40.5], [0, 90.5, 128, 90.5]]
            segments = Segments(np.array(halves, np.float32), np.full(3, 0.9, np.float32), (SIZE, SIZE))
            return [Detections(segments, Lines.empty((SIZE, SIZE))) for _ in images]

    result = evaluate_cables(SaysSegments(), Scenes(), 2, min_score=0.5, use="segments")
    assert (result.covered_share, result.gaps_per_cable, result.false_images) == (1, 0, 1)
    assert result.sap15 == 0  # of lines, of which there are none
