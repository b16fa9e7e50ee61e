"""The figures of the paper, of our networks and images: detections, grids, augmentations, losses."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.evaluation.datasets import images_of, load_truth
from lsnet.evaluation.paper import Way, segmentation
from lsnet.evaluation.rasterize import confidence_map, otsu_mask
from lsnet.images import load_rgb
from lsnet.synth import augment
from lsnet.synth.backgrounds import BackgroundFolder, BackgroundPool
from lsnet.synth.drawing import to_uint8
from lsnet.synth.geometric import crop, flip
from lsnet.synth.scene import add_cables

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from lsnet.arrays import FloatImage, Floats, ImageArray, Mask, Rng
    from lsnet.evaluation.paper import PixelClassifier
    from lsnet.evaluation.pixels import LineDetector

    Panel = tuple[str, ImageArray]

CAPTION_PX, GAP_PX = 20, 4
FOUND = np.array([255, 40, 200], np.uint8)  # RGB of what is found or true
GRIDS_SHOWN = ("M", "MH", "MVH", "MHVC")
SHOWN_WIDTH_PX = 5  # of segments in the figure of the grids, as in the paper
TRIALS = 30
PHOTOS = 128  # at most, of the folders of backgrounds


def detection_panels(
    folder: Path,
    detectors: Mapping[str, Callable[[ImageArray], Mask]],
    count: int,
) -> list[list[Panel]]:
    """Return a row of panels for each of some images of a set: image, truth if there is one, detections.

    Args:
        folder: The set; its images are taken at equal distances.
        detectors: Functions to the pixels found, by name.
        count: Number of images.

    Raises:
        LSNetError: The folder has no images, or a truth is missing or has another size.
    """
    kind, files = images_of(folder)
    rows = []
    for path in (files[i * len(files) // count] for i in range(min(count, len(files)))):
        image = load_rgb(path)
        row = [(path.stem, image)]
        if kind != "plain":
            row.append(("truth", marked(image, load_truth(kind, path, image.shape[:2]).mask)))
        row += [(name, marked(image, find(image))) for name, find in detectors.items()]
        rows.append(row)
    return rows


def pixels_of_segments(
    detector: LineDetector, min_score: float, width_px: int = 2
) -> Callable[[ImageArray], Mask]:
    """Return a function to the pixels of a line detector as the paper compares them: Gaussian, Otsu."""

    def find(image: ImageArray) -> Mask:
        segments = detector.detect([image])[0].segments.above(min_score)
        return segmentation(segments, Way(width_px, "otsu"))

    return find


def pixels_of_map(classifier: PixelClassifier) -> Callable[[ImageArray], Mask]:
    """Return a function to the pixels of a classifier of pixels: Otsu."""
    return lambda image: otsu_mask(classifier.confidence(image))


def grid_panels(
    open_grids: Callable[[str], LineDetector], image: ImageArray, min_score: float
) -> list[list[Panel]]:
    """Return one row: the segments of one, two, three and four grids, drawn 5 px wide."""
    row = []
    for grids in GRIDS_SHOWN:
        segments = open_grids(grids).detect([image])[0].segments.above(min_score)
        row.append((grids, marked(image, confidence_map(segments, SHOWN_WIDTH_PX) > 0)))
    return [row]


def augmentation_panels(backgrounds: Sequence[str], size: int, seed: int) -> list[list[Panel]]:
    """Return a drawn image, its annotation, and the image after each augmentation of the paper.

    Raises:
        LSNetError: A folder of backgrounds (DIR or DIR:FIRST) has no images.
    """
    folders = [BackgroundFolder.parse(text) for text in backgrounds]
    pool = BackgroundPool([BackgroundFolder(f.path, f.first or PHOTOS) for f in folders], drawn=False)
    rng = np.random.default_rng(seed)

    def drawn(ground: FloatImage) -> tuple[FloatImage, list[Floats]]:
        image = ground.copy()
        return image, add_cables(image, np.random.default_rng(seed))

    image, lines = drawn(pool.sample(rng, size))
    annotation = np.zeros((size, size, 3), np.uint8)
    for line in lines:
        points = np.round(line).astype(np.int32)[:, None]
        cv2.polylines(annotation, [points], isClosed=False, color=(255, 255, 255), thickness=2)
    replaced, _ = drawn(pool.sample(rng, size))
    cropped = _crop_with_line(*drawn(pool.sample(rng, size)), rng)
    shown = {name: getattr(augment, name)(image, rng) for name in ("gaussian_noise", "gaussian_blur", "hue")}
    panels = [
        ("original", image),
        ("annotation", annotation),
        ("Gaussian noise", shown["gaussian_noise"]),
        ("Gaussian blur", shown["gaussian_blur"]),
        ("colour", shown["hue"]),
        ("elastic", augment.elastic(image, lines, rng)[0]),
        ("new background", replaced),
        ("crop, flip, background", cv2.resize(cropped, (size, size))),
    ]
    images = [(name, to_uint8(np.asarray(panel, np.float32))) for name, panel in panels]
    return [images[:4], images[4:]]


def _crop_with_line(image: FloatImage, lines: list[Floats], rng: Rng) -> FloatImage:
    """Return a random crop, flipped: of some the first in which a line runs, else the last."""
    for _ in range(TRIALS):
        part, moved = flip(*crop(image, lines, rng), rng)
        points = np.concatenate(moved)
        if ((points > 0) & (points < np.array(part.shape[1::-1]))).all(axis=1).any():
            break
    return part


def marked(image: ImageArray, mask: Mask) -> ImageArray:
    """Return an image (H, W, 3) in grey, with the pixels of a mask (H, W) coloured."""
    grey = cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB)
    dark: ImageArray = (grey // 2 + 20).astype(np.uint8)
    dark[mask] = FOUND
    return dark


def montage(rows: Sequence[Sequence[Panel]], width: int) -> ImageArray:
    """Return panels side by side, each `width` px wide, with its caption above."""
    drawn = [[_captioned(name, image, width) for name, image in row] for row in rows]
    strips = [_joined(row, axis=1) for row in drawn]
    return _joined(strips, axis=0)


def _captioned(name: str, image: ImageArray, width: int) -> ImageArray:
    height = round(image.shape[0] * width / image.shape[1])
    how = cv2.INTER_AREA if width < image.shape[1] else cv2.INTER_LINEAR
    panel = np.full((height + CAPTION_PX, width, 3), 255, np.uint8)
    panel[CAPTION_PX:] = cv2.resize(image, (width, height), interpolation=how)
    cv2.putText(panel, name, (3, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA)
    return panel


def _joined(panels: Sequence[ImageArray], axis: int) -> ImageArray:
    """Join along an axis with gaps; shorter panels are filled up with white."""
    other = 1 - axis
    longest = max(panel.shape[other] for panel in panels)
    filled = []
    for panel in panels:
        padding = [(0, 0)] * 3
        padding[axis], padding[other] = (0, GAP_PX), (0, longest - panel.shape[other])
        filled.append(np.pad(panel, padding, constant_values=255))
    return np.concatenate(filled, axis=axis)


def draw_losses(runs: Mapping[str, Path], path: Path) -> None:
    """Draw the focal and the Wing loss of the validations of runs, by name (extra `plot`).

    Raises:
        LSNetError: A folder has no log, or matplotlib is not installed or cannot write the file.
    """
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    except ImportError as err:
        raise LSNetError("matplotlib is not installed; pip install 'lsnet-pipe[plot]'") from err
    figure = Figure(figsize=(9, 4), layout="constrained")
    parts = {"validation_classification": "cells", "validation_regression": "endpoints"}
    for axes, (key, title) in zip(figure.subplots(1, 2), parts.items(), strict=True):
        axes.set(xlabel="step", ylabel=f"validation loss of the {title}")
        for name, run in runs.items():
            entries = _read_log(run)
            axes.plot([e["step"] for e in entries], [e[key] for e in entries], ".-", label=name)
        axes.legend()
    try:
        figure.savefig(path)
    except (OSError, ValueError) as err:
        raise LSNetError(f"{path}: cannot be written ({err}); name another file, .svg or .png") from err


def _read_log(run: Path) -> list[dict[str, float]]:
    path = run / "log.jsonl"
    try:
        entries = [json.loads(line) for line in path.read_text().splitlines()]
        return [e for e in entries if e["validation_classification"] is not None]
    except (OSError, ValueError, LookupError, TypeError) as err:
        raise LSNetError(f"{path}: no log of losses by part; give the folder of a run") from err
