"""Single photographs through the detector, outside any recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from inspect_pipeline.errors import OutputError
from inspect_pipeline.overlay import draw_segments, write_picture
from lsnet import LSNetError
from lsnet.evaluation.rasterize import confidence_map
from lsnet.synth.backgrounds import load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray
    from lsnet import Detections, Detector


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """An image file with what was found in it; image is uint8 (height, width, 3) RGB."""

    path: Path
    image: ImageArray
    detections: Detections

    def to_dict(self) -> dict[str, Any]:
        """The fields of `detect --json`; coordinates to a hundredth of a pixel."""
        segments, lines = self.detections.segments, self.detections.lines
        height, width = segments.image_size
        rows = np.column_stack([segments.endpoints.round(2), segments.scores.round(4)]).astype(float)
        return {
            "path": str(self.path),
            "width": width,
            "height": height,
            "segments": [[round(value, 4) for value in row] for row in rows.tolist()],
            "lines": [
                {"points": np.round(points.astype(float), 2).tolist(), "score": round(float(score), 4)}
                for points, score in zip(lines.points, lines.scores, strict=True)
            ],
        }


def detect_in(
    paths: Sequence[Path], detector: Detector, batch_size: int, on_error: Callable[[str], None]
) -> Iterator[Photograph]:
    """Each photograph in turn, `batch_size` of them read at a time; `on_error` hears of unreadable ones."""
    for first in range(0, len(paths), batch_size):
        read: list[tuple[Path, ImageArray]] = []
        for path in paths[first : first + batch_size]:
            try:
                read.append((path, load_rgb(path)))
            except LSNetError as error:
                on_error(str(error))
        found_in = detector.detect([image for _, image in read])
        for (path, image), found in zip(read, found_in, strict=True):
            yield Photograph(path, image, found)


def check_outputs(paths: Sequence[Path], draw: Path | None, confidence: Path | None) -> None:
    """Raises OutputError when pictures of one run would replace each other."""
    folder = draw or confidence
    if folder is None:
        return
    if draw and confidence and draw.resolve() == confidence.resolve():
        raise OutputError(folder, "overlays and maps have the same names", "name two folders")
    named: dict[str, Path] = {}
    for path in paths:
        other = named.setdefault(path.stem, path)
        if other.resolve() != path.resolve():
            raise OutputError(folder, f"{other} and {path} would have one picture", "run them apart")


def write_overlay(photograph: Photograph, folder: Path) -> None:
    """Write FOLDER/NAME.png with the segments drawn. Raises OutputError."""
    picture = draw_segments(photograph.image, photograph.detections.segments.endpoints)
    write_picture(_in_folder(folder, photograph), picture)


def write_map(photograph: Photograph, folder: Path) -> None:
    """Write FOLDER/NAME.png, the paper's confidence map, 255 for a score of 1. Raises OutputError."""
    confidence = confidence_map(photograph.detections.segments)
    grey = np.round(confidence * 255).astype(np.uint8)
    write_picture(
        _in_folder(folder, photograph), np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)
    )


def _in_folder(folder: Path, photograph: Photograph) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(folder, f"cannot be made a folder ({error.strerror})", "name another") from error
    path = folder / f"{photograph.path.stem}.png"
    if path.exists() and path.samefile(photograph.path):
        raise OutputError(path, "would replace the photograph", "name another folder")
    return path
