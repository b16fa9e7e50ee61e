"""Whether a lower precision finds the same: F of lines for each runtime on evaluation sets, and its cost.

    python benchmarks/bench_precision.py FOLDER... [--runtimes openvino-bf16 openvino-int8]

A folder is a set as `lsnet-pipe model eval` takes it, a folder of `images` with `labels` of labelme
(linestrips `wire`, polygons `ignore`), or one of images without wires, also in folders of its own. F is at
the lowest score to report, within 1 px of cables with contours and 3 px of others. The other runtimes are
held against the first: the exit code is 1 if one has an F, or a share of images without wires that have no
line, that is lower by more than 0.005. `out of reach` counts the lines that would be reported too if every
proposal were looked at (`lsnet.lines.score.MAX_LEARNED`). The last line is one JSON object.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple
from unittest.mock import patch

import cv2
import numpy as np
from bench_speed import print_machine
from scipy.spatial import cKDTree

from lsnet import Detector
from lsnet.evaluation.datasets import images_of, load_truth
from lsnet.evaluation.metrics import pixel_counts
from lsnet.evaluation.rasterize import confidence_map
from lsnet.evaluation.speed import least_cpu_ms
from lsnet.geometry import angle_between
from lsnet.images import IMAGE_SUFFIXES, load_rgb

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lsnet.arrays import Floats, ImageArray, RealArray
    from lsnet.segments import Lines

LARGEST_LOSS = 0.005  # of F
TOLERANCE_PX = {"contours": 1.0, "masks": 3.0, "labels": 3.0}
MAX_ANGLE_DEG = 15.0  # between a reported and a labelled wire
LEAST_SCORE = 0.01  # of an image without wires: any line counts


class Result(NamedTuple):
    """Of a set: F, or the share of images without wires that have no line; lines, and those out of reach."""

    measure: str
    value: float
    n_lines: int
    n_out_of_reach: int


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--runtimes", nargs="+", default=["openvino-bf16", "openvino-int8"])
    parser.add_argument("--weights", default="fast")
    arguments = parser.parse_args()
    detectors = {name: Detector.load(arguments.weights, runtime=name) for name in arguments.runtimes}
    first, *others = arguments.runtimes
    print_machine(str(detectors[first].describe()))
    costs = {name: least_cpu_ms(detector._backend) for name, detector in detectors.items()}
    print(
        "CPU ms of the network at 512 x 512: " + ", ".join(f"{name} {ms:.2f}" for name, ms in costs.items())
    )
    print(
        f"{'set':24} {'measure':>10}"
        + "".join(f" {name:>16}" for name in detectors)
        + "  lines, out of reach"
    )
    figures: dict[str, dict[str, float]] = {}
    failed = []
    for folder in arguments.folders:
        results = {name: evaluate(detector, folder) for name, detector in detectors.items()}
        figures[folder.name] = {name: round(result.value, 4) for name, result in results.items()}
        reached = ", ".join(f"{each.n_lines} {each.n_out_of_reach}" for each in results.values())
        values = "".join(f" {each.value:16.4f}" for each in results.values())
        print(f"{folder.name:24} {results[first].measure:>10}{values}  {reached}", flush=True)
        failed += [
            f"{folder.name}: {name} loses {results[first].value - results[name].value:.4f}"
            for name in others
            if results[first].value - results[name].value > LARGEST_LOSS
        ]
    costs = {name: round(ms, 3) for name, ms in costs.items()}
    print(json.dumps({"benchmark": "precision", "cpu_ms_512": costs, "sets": figures, "failed": failed}))
    return 1 if failed else 0


def evaluate(detector: Detector, folder: Path) -> Result:
    """Detect in the images of a set, and compare with its truth."""
    has_labels = (folder / "labels").is_dir()
    where = folder / "images" if has_labels else folder
    nested = sorted(file for file in where.rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES)
    kind, files = ("plain", nested) if where.is_dir() and not any_flat(where) else images_of(where)
    counts, n_lines, n_out_of_reach = [], 0, 0
    for path in files:
        image = load_rgb(path)
        lines, n_more = found_in(detector, image)
        n_lines, n_out_of_reach = n_lines + len(lines), n_out_of_reach + n_more
        if has_labels:
            counts.append(against_labels(lines, folder / "labels" / f"{path.stem}.json"))
        elif kind == "plain":
            counts.append(np.array([len(lines) == 0, 1, len(lines) == 0, 1]))
        else:
            truth = load_truth(kind, path, lines.image_size)
            at = np.array([LEAST_SCORE])
            counts.append(pixel_counts(confidence_map(lines.pieces()), truth, TOLERANCE_PX[kind], at)[0])
    right, reported, found, true = np.sum(counts, axis=0).tolist()
    precision, recall = right / max(reported, 1), found / max(true, 1)
    f1 = 2 * precision * recall / max(precision + recall, 1e-9)
    measure = "no line" if kind == "plain" and not has_labels else "F"
    return Result(measure, f1, n_lines, n_out_of_reach)


def any_flat(folder: Path) -> bool:
    """Whether the folder itself is a set."""
    return (folder / "masks").is_dir() or any(f.suffix.lower() in IMAGE_SUFFIXES for f in folder.iterdir())


def found_in(detector: Detector, image: ImageArray) -> tuple[Lines, int]:
    """Return the lines in an image, and how many more there are if every proposal is looked at."""
    lines = detector.detect([image])[0].lines
    with patch("lsnet.lines.score.MAX_LEARNED", np.inf):
        return lines, len(detector.detect([image])[0].lines) - len(lines)


def against_labels(lines: Lines, path: Path) -> Floats:
    """(4,) reported places on a labelled wire, of how many; labelled places that are reported, of how many.

    Places are a pixel apart; those in an area to ignore do not count, and reports of one place count once.
    """
    shapes = json.loads(path.read_text())["shapes"]
    ignored = np.zeros(lines.image_size, np.uint8)
    for shape in shapes:
        if shape["label"] == "ignore":
            cv2.fillPoly(ignored, [np.array(shape["points"]).astype(np.int32)], 1)
    wires = [np.array(shape["points"]) for shape in shapes if shape["label"] == "wire"]
    true, reported = (_places(polylines, ignored) for polylines in (wires, lines.points))
    cells = np.floor(np.column_stack((reported[:, :2], reported[:, 2] / np.pi * 6)))
    reported = reported[np.unique(cells, axis=0, return_index=True)[1]]
    return np.array(
        [_are_near(reported, true).sum(), len(reported), _are_near(true, reported).sum(), len(true)], float
    )


def _places(polylines: Sequence[RealArray], ignored: ImageArray) -> Floats:
    """(N, 3) x, y and direction of places on polylines, about a pixel apart."""
    parts = [np.zeros((0, 3))]
    for polyline in polylines:
        for start, step in zip(polyline[:-1], np.diff(polyline, axis=0), strict=True):
            count = max(1, round(float(np.hypot(*step))))
            at = start + (np.arange(count)[:, None] + 0.5) / count * step
            parts.append(np.column_stack((at, np.full(count, np.arctan2(step[1], step[0]) % np.pi))))
    places = np.concatenate(parts)
    height, width = ignored.shape
    x, y = (np.clip(places[:, k].astype(int), 0, side - 1) for k, side in ((0, width), (1, height)))
    return places[ignored[y, x] == 0]


def _are_near(places: Floats, others: Floats) -> RealArray:
    """(N,) whether a place has one of the others nearby, of similar direction."""
    if not len(places) or not len(others):
        return np.zeros(len(places), bool)
    near = cKDTree(others[:, :2]).query_ball_point(places[:, :2], TOLERANCE_PX["labels"])
    limit = np.radians(MAX_ANGLE_DEG)
    return np.array(
        [
            bool((angle_between(others[each, 2], direction) < limit).any())
            for each, direction in zip(near, places[:, 2], strict=True)
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
