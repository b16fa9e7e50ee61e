"""Detection in single photographs, outside any recording."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from inspect_pipeline.errors import OutputError
from inspect_pipeline.images.decode import Picture, decode_file
from inspect_pipeline.images.draw import draw_heat, draw_lines, draw_scores, track_colours, write_picture
from inspect_pipeline.messages.image import ImageError
from lsnet import LSNetError
from lsnet.evaluation.rasterize import confidence_map
from lsnet.images import load_rgb

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from inspect_pipeline.arrays import ImageArray
    from lsnet import Detections, Detector


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """An image file and its detections; image is uint8 (height, width, 3) RGB.

    doubt: what is probably wrong with the image.
    """

    path: Path
    image: ImageArray
    detections: Detections
    doubt: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the fields of `detect --json`; coordinates are rounded to a hundredth of a pixel."""
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
    """Yield the photographs with their detections, `batch_size` of them in memory at a time.

    `on_error` is called with a line about each file that cannot be read, which is skipped.
    """
    for first in range(0, len(paths), batch_size):
        read: list[tuple[Path, Picture]] = []
        for path in paths[first : first + batch_size]:
            try:
                read.append((path, _read(path)))
            except ImageError as error:
                on_error(f"{path}: {error}; give a JPEG, PNG or similar")
            except OSError as error:
                on_error(f"{path}: cannot be read ({error.strerror}); check the file")
            except LSNetError as error:
                on_error(str(error))
        found_in = detector.detect([picture.image for _, picture in read])
        for (path, picture), found in zip(read, found_in, strict=True):
            yield Photograph(path, picture.image, found, picture.doubt)


def _read(path: Path) -> Picture:
    """Read an image as `process` does; radiance maps, which no recording has, by lsnet."""
    return Picture(load_rgb(path)) if path.suffix.lower() == ".hdr" else decode_file(path)


def check_outputs(paths: Sequence[Path], draw: Path | None, confidence: Path | None) -> None:
    """Raise OutputError when two pictures of one call would have the same name."""
    folder = draw or confidence
    if folder is None:
        return
    if draw and confidence and draw.resolve() == confidence.resolve():
        raise OutputError(folder, "overlays and maps have the same names", "name two folders")
    named: dict[Path, Path] = {}
    for path in paths:
        other = named.setdefault(_picture_name(path, paths), path)
        if other.resolve() != path.resolve():
            raise OutputError(folder, f"{other} and {path} would have one picture", "run them apart")


def write_overlay(
    photograph: Photograph, paths: Sequence[Path], folder: Path, *, segments: bool = False
) -> None:
    """Write the lines, or the raw segments, over the photograph as PNG into `folder`.

    `paths` are all photographs of the call: where they come from several folders, these are kept. Raises
    OutputError.
    """
    found = photograph.detections
    if segments:
        polylines, scores = list(found.segments.endpoints.reshape(-1, 2, 2)), found.segments.scores
    else:
        polylines, scores = list(found.lines.points), found.lines.scores
    picture = draw_lines(photograph.image, polylines, track_colours(range(len(polylines))))
    if not segments:
        picture = draw_scores(picture, polylines, scores)
    write_picture(_picture_path(folder, photograph, paths), picture)


def write_map(photograph: Photograph, paths: Sequence[Path], folder: Path) -> None:
    """Write the paper's confidence map (Section IV-A) as a heat map over the photograph; else as above."""
    picture = draw_heat(photograph.image, confidence_map(photograph.detections.segments))
    write_picture(_picture_path(folder, photograph, paths), picture)


def _picture_name(path: Path, paths: Sequence[Path]) -> Path:
    """Return the name of a photograph's picture, with its folder below the one that all `paths` share."""
    common = Path(os.path.commonpath([each.absolute().parent for each in paths]))
    return path.absolute().relative_to(common).with_suffix(".png")


def _picture_path(folder: Path, photograph: Photograph, paths: Sequence[Path]) -> Path:
    path = folder / _picture_name(photograph.path, paths)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(path.parent, f"cannot be created ({error.strerror})", "name another") from error
    if path.exists() and path.samefile(photograph.path):
        raise OutputError(path, "would replace the photograph", "name another folder")
    return path
