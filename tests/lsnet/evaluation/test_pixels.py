"""Evaluation of a folder, by hand and against the published scorer."""

from __future__ import annotations

import importlib.util
import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from lsnet.errors import LSNetError
from lsnet.evaluation.pixels import PixelReport, ShareReport, evaluate
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray


class Says:
    """A detector that answers by the number in the image's first pixel."""

    def __init__(self, answer: Callable[[NDArray[np.uint8]], NDArray[np.floating]]) -> None:
        self._answer = answer

    def detect(self, images: Sequence[NDArray[np.uint8]]) -> list[Detections]:
        found = []
        for image in images:
            size, rows = image.shape[:2], np.asarray(self._answer(image), np.float32).reshape(-1, 5)
            found.append(Detections(Segments(rows[:, :4], rows[:, 4], size), Lines.empty(size)))
        return found


def write_set(folder: Path) -> Path:
    """Two images of 60 x 80 with a cable along rows 28 to 32, and its mask."""
    for name, value in (("a", 0), ("b", 100)):
        for kind in ("images", "masks"):
            (folder / kind).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / f"images/{name}.png"), np.full((60, 80, 3), value, np.uint8))
        mask = np.zeros((60, 80), np.uint8)
        mask[28:33] = 255
        cv2.imwrite(str(folder / f"masks/{name}.png"), mask)
    return folder


ON_CABLE, BESIDE = [0, 30.5, 80, 30.5], [0, 5.5, 80, 5.5]


def pixel_reports(folder: Path, answer: Any, min_score: float = 0.5) -> list[PixelReport]:
    reports = evaluate(Says(answer), folder, min_score=min_score, tolerances_px=(1.0, 3.0))
    assert all(isinstance(r, PixelReport) for r in reports)
    return reports


def test_a_perfect_detector(tmp_path: Path) -> None:
    reports = pixel_reports(write_set(tmp_path), lambda _image: [[*ON_CABLE, 0.97]])
    assert [(r.images, r.tolerance_px) for r in reports] == [(2, 1.0), (2, 3.0)]
    for report in reports:
        assert (report.ods.precision, report.ods.recall) == (1, 1)
        assert report.ods.f1 == pytest.approx(1)
        assert report.at_min_score.f1 == pytest.approx(1)
    assert "ODS F1 1.0000" in str(reports[0])
    assert json.loads(json.dumps(asdict(reports[0])))["ods"]["precision"] == 1


def test_ods_is_the_best_threshold_beside_the_requested_one(tmp_path: Path) -> None:
    report, _ = pixel_reports(
        write_set(tmp_path), lambda _image: [[*ON_CABLE, 0.8], [*BESIDE, 0.4]], min_score=0.2
    )
    assert report.ods.f1 == pytest.approx(1)
    assert 0.4 < report.ods.threshold <= 0.8
    assert (report.at_min_score.threshold, report.at_min_score.precision) == (0.2, 0.5)


def test_detector_that_finds_one_of_two_cables(tmp_path: Path) -> None:
    calls: list[int] = []
    reports = evaluate(
        Says(lambda image: [[*ON_CABLE, 0.9]] if image[0, 0, 0] else []),
        write_set(tmp_path),
        min_score=0.5,
        on_image=lambda: calls.append(1),
    )
    assert len(calls) == 2
    assert (reports[0].ods.precision, reports[0].ods.recall) == (1, 0.5)
    assert reports[0].ods.mean_f1 == pytest.approx(0.5)


def test_images_without_truth_give_the_share_with_a_report(tmp_path: Path) -> None:
    for i in range(4):
        cv2.imwrite(str(tmp_path / f"{i}.png"), np.full((40, 40, 3), i * 60, np.uint8))
    scores = {0: [], 60: [[*BESIDE, 0.35]], 120: [[*BESIDE, 0.2], [*BESIDE, 0.75]], 180: []}
    (report,) = evaluate(Says(lambda image: scores[int(image[0, 0, 0])]), tmp_path, min_score=0.2)
    assert isinstance(report, ShareReport)
    assert report.reported == {0.2: 0.5, 0.3: 0.5, 0.5: 0.25, 0.7: 0.25, 0.9: 0.0}
    assert "50.0% at score 0.2" in str(report)
    json.dumps(asdict(report))
    (nothing,) = evaluate(Says(lambda _image: []), tmp_path, min_score=0.0)
    assert nothing.reported[0.0] == 0


def test_a_truth_of_another_size_is_one_line(tmp_path: Path) -> None:
    cv2.imwrite(str(write_set(tmp_path) / "masks/a.png"), np.zeros((30, 40), np.uint8))
    with pytest.raises(LSNetError, match=r"a\.png: not the size of its image"):
        pixel_reports(tmp_path, lambda _image: [])


@pytest.mark.parametrize("name", ["PLDU", "PLDM"])
def test_scores_agree_with_the_published_scorer(data_dir: Path, tmp_path: Path, name: str) -> None:
    """Real contours, made-up segments: parts of the contours, shifted, and lines anywhere."""
    spec = importlib.util.spec_from_file_location("pld_eval", data_dir.parent / "tools/pld_eval.py")
    pytest.importorskip("scipy")
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    ids = sorted(int(f.stem) for f in (data_dir / "pld_dev" / name).glob("*.jpg"))[:4]
    for i in ids:
        for suffix in (".jpg", ".boundary.png"):
            (tmp_path / f"{i}{suffix}").symlink_to(data_dir / "pld_dev" / name / f"{i}{suffix}")
    said = {}
    for i in ids:
        image = cv2.imread(str(tmp_path / f"{i}.jpg"))
        said[i] = made_up(cv2.imread(str(tmp_path / f"{i}.boundary.png"), 0) > 0, i)
        said[image.shape, int(image[..., ::-1].astype(int).sum())] = said[i]
    items = scorer.load(str(data_dir / "pld_dev"), name, ids=lambda i: i in ids)
    confidence = {i: scorer.draw(said[i][:, :4], said[i][:, 4], m.shape) for i, _, m, _, _ in items}
    expected = scorer.report(items, confidence)
    answers = Says(lambda image: said[image.shape, int(image.astype(int).sum())])
    reports = evaluate(answers, tmp_path, min_score=0.5, tolerances_px=scorer.TOLS)
    for report in reports:
        theirs = expected[report.tolerance_px]
        assert 0.2 < report.ods.f1 < 1  # neither trivial nor empty
        assert report.ods.f1 == pytest.approx(theirs["ODS"], abs=0.002)
        assert report.ods.precision == pytest.approx(theirs["P"], abs=0.002)
        assert report.ods.recall == pytest.approx(theirs["R"], abs=0.002)
        assert report.ods.mean_f1 == pytest.approx(theirs["meanF"], abs=0.002)


def made_up(contours: NDArray[np.bool_], seed: int) -> NDArray[np.float32]:
    """(N, 5) segments x1 y1 x2 y2 score: near the contours with high scores, anywhere with lower ones."""
    rng = np.random.default_rng(seed)
    height, width = contours.shape
    found = cv2.HoughLinesP(contours.astype(np.uint8), 1, np.pi / 180, 20, minLineLength=20, maxLineGap=5)
    near = np.zeros((0, 4)) if found is None else found.reshape(-1, 4) + rng.normal(0, 1, (len(found), 4))
    anywhere = rng.uniform(0, [width, height] * 2, (6, 4))
    scores = np.concatenate([rng.uniform(0.3, 1, len(near)), rng.uniform(0.05, 0.6, 6)])
    endpoints = np.clip(np.vstack([near, anywhere]), 0, [width - 0.01, height - 0.01] * 2)
    return np.column_stack([endpoints, scores]).astype(np.float32)


def test_lines_are_scored_by_their_pieces(tmp_path: Path) -> None:
    class SaysLines:
        def detect(self, images: Sequence[NDArray[np.uint8]]) -> list[Detections]:
            size = images[0].shape[:2]
            bent = np.array([[0, 30.5], [40, 31.5], [80, 30.5]], np.float32)
            lines = Lines((bent,), np.array([0.7], np.float32), size)
            return [Detections(Segments.empty(size), lines) for _ in images]

    report = evaluate(SaysLines(), write_set(tmp_path), min_score=0.5, use="lines")[0]
    assert isinstance(report, PixelReport)
    assert report.at_min_score.f1 == pytest.approx(1)
    raw = evaluate(SaysLines(), tmp_path, min_score=0.5)[0]
    assert raw.at_min_score.f1 == 0
