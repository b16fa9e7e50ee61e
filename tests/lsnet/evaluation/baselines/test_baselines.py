"""Other detectors behind the interface of `Detector`."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from nets import openvino_or_skip

from lsnet import LSNetError
from lsnet.evaluation.baselines.hough import Hough, parallel
from lsnet.evaluation.baselines.lengths import SCORE_LENGTH_PX
from lsnet.evaluation.baselines.lsd import LSD
from lsnet.evaluation.baselines.mlsd import MLSD, decode
from lsnet.evaluation.report import open_line_detector


def test_lsd_finds_the_edges_of_a_band() -> None:
    image = np.full((120, 160, 3), 60, np.uint8)
    cv2.rectangle(image, (20, 50), (139, 69), (200, 200, 200), -1)
    (found,) = LSD().detect([image])
    long = found.segments.above(1 - np.exp(-100 / SCORE_LENGTH_PX))
    assert sorted(np.round(long.endpoints[:, [1, 3]].mean(1)).tolist()) == [50.0, 70.0]
    lengths = np.hypot(*(long.endpoints[:, 2:] - long.endpoints[:, :2]).T)
    np.testing.assert_allclose(long.scores, 1 - np.exp(-lengths / 100), atol=1e-5)
    np.testing.assert_array_equal(found.lines.pieces().endpoints, found.segments.endpoints)


def test_lsd_of_a_plain_image_finds_nothing() -> None:
    (found,) = LSD().detect([np.full((40, 40, 3), 90, np.uint8)])
    assert (len(found.segments), len(found.lines)) == (0, 0)


def test_mlsd_decodes_centres_and_displacements() -> None:
    steps = np.zeros((64, 128, 4), np.float32)
    steps[30, 50] = (-20.5, -10, 19.5, 20)  # x y of the one end, x y of the other
    steps[10, 10] = (-4, 0, 4, 0)  # too short
    steps[40, 90] = (-30, 0, 30, 0)  # not sure enough
    centres = np.array([[30, 50], [10, 10], [40, 90]], np.int32)
    found = decode(centres, np.array([0.5, 0.9, 0.05], np.float32), steps, (128, 384))
    # An image of 384 x 128 has 3 px a place across and 2 px down; a place is meant at its middle.
    np.testing.assert_allclose(found.segments.endpoints, [[90, 41, 210, 101]])
    lengths = np.hypot(120, 60)
    np.testing.assert_allclose(found.segments.scores, 1 - np.exp(-lengths / SCORE_LENGTH_PX), rtol=1e-5)


def test_files_that_are_not_a_network_are_one_line(tmp_path: Path) -> None:
    openvino_or_skip()
    (tmp_path / "a.tflite").write_bytes(b"no network")
    for name in ("a.tflite", "missing.tflite"):
        with pytest.raises(LSNetError, match=r"not a network OpenVINO can read; give M-LSD's") as error:
            MLSD(tmp_path / name)
        assert "\n" not in str(error.value)
    with pytest.raises(LSNetError, match="no rival 'elsed'; give lsd"):
        open_line_detector("fast", "torch", "elsed")


def test_mlsd_finds_the_edges_of_a_band(data_dir: Path) -> None:
    openvino_or_skip()
    weights = data_dir.parent / "models/M-LSD_512_tiny_fp32.tflite"
    image = np.full((256, 300, 3), 60, np.uint8)
    cv2.rectangle(image, (20, 80), (279, 169), (200, 200, 200), -1)
    long = MLSD(weights).detect([image])[0].segments.above(1 - np.exp(-200 / SCORE_LENGTH_PX))
    rows = long.endpoints[:, [1, 3]].mean(1)
    for edge in (80, 170):
        assert np.abs(rows - edge).min() < 3


def test_the_classical_approach_keeps_parallel_lines() -> None:
    """Three parallel cables and a stroke across: the stroke is left out."""
    image = np.full((200, 300, 3), 60, np.uint8)
    for row in (50, 90, 130):
        cv2.line(image, (10, row), (290, row + 20), (230, 230, 230), 3)
    cv2.line(image, (150, 10), (160, 190), (230, 230, 230), 3)
    found = Hough().detect([image])[0].segments
    steps = found.endpoints[:, 2:] - found.endpoints[:, :2]
    angles = np.degrees(np.arctan2(steps[:, 1], steps[:, 0])) % 180
    assert len(found) >= 3
    assert np.abs(angles - np.degrees(np.arctan2(20, 280))).max() < 6
    assert len(Hough().detect([np.zeros((64, 64, 3), np.uint8)])[0].segments) == 0


def test_directions_near_zero_and_180_degrees_are_parallel() -> None:
    ends = np.array([[0, 10, 100, 11], [0, 30, 100, 29], [50, 0, 50, 90]], np.float32)
    np.testing.assert_array_equal(parallel(ends), ends[:2])
