"""Labelled images of the user as training data: labelme files beside the images, or one COCO file.

    labelme   NAME.json beside each image, with shapes of type line or linestrip
    COCO      annotations.json: "images" with file_name, "annotations" with "line" or "segmentation" as
              flat lists x1, y1, x2, y2, ... of each polyline

All labels count as lines unless `labels` names the ones that do.
"""

from __future__ import annotations

import json
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from lsnet.errors import LSNetError
from lsnet.images import IMAGE_SUFFIXES, load_rgb
from lsnet.synth.conditions import augment_further
from lsnet.synth.drawing import Sample, to_uint8
from lsnet.synth.geometric import affine

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lsnet.arrays import Floats32, ImageArray, Points, Rng


COCO_FILE = "annotations.json"
LINE_SHAPES = {"line", "linestrip"}


@dataclass(frozen=True, slots=True, eq=False)
class LabelledImage:
    """An image file and its polylines.

    Attributes:
        path: The file.
        lines: (K, 2) x, y in pixels of the image as stored.
        size: (height, width) according to the labels, None if they do not state it.
    """

    path: Path
    lines: list[Points]
    size: tuple[int, int] | None = None

    def load(self) -> ImageArray:
        """Load the pixels. Raises LSNetError when they are no image, or of another size, as if rotated."""
        pixels = load_rgb(self.path)
        if self.size not in (None, pixels.shape[:2]):
            raise LSNetError(
                f"{self.path}: stored as {pixels.shape[1]} x {pixels.shape[0]}, labelled as {self.size[1]} x "
                f"{self.size[0]}; store it upright, without an EXIF orientation"
            )
        return pixels


def load_labels(folder: Path, labels: tuple[str, ...] = ()) -> list[LabelledImage]:
    """Read the labels of a folder, in order of the file names of the images.

    Raises:
        LSNetError: The folder has no labels, or a label file is malformed.
    """
    if not folder.is_dir():
        raise LSNetError(f"{folder}: not a folder; give a folder of labelled images")
    coco = folder / COCO_FILE
    found = _from_coco(coco, labels) if coco.is_file() else _from_labelme(folder, labels)
    if not found:
        raise LSNetError(f"{folder}: no labelled images; put labelme files beside the images, or {COCO_FILE}")
    if not any(image.lines for image in found):
        wanted = f" labelled {', '.join(labels)}" if labels else ""
        raise LSNetError(f"{folder}: no lines{wanted} in its labels; label lines as line or linestrip")
    return found


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Turn the errors that a malformed label file causes into one line that names it."""
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as err:
        raise LSNetError(
            f"{path}: labels cannot be read ({type(err).__name__}: {err}); write them again"
        ) from err


def _from_labelme(folder: Path, labels: tuple[str, ...]) -> list[LabelledImage]:
    found = []
    for path in sorted(f for f in folder.iterdir() if f.suffix.lower() in IMAGE_SUFFIXES):
        label_file = path.with_suffix(".json")
        if not label_file.is_file():
            continue
        with _naming(label_file):
            content = json.loads(label_file.read_text(encoding="utf-8"))
            lines = [
                _polyline(shape["points"])
                for shape in content["shapes"]
                if shape["shape_type"] in LINE_SHAPES and (not labels or shape["label"] in labels)
            ]
            size = _size(content.get("imageHeight"), content.get("imageWidth"))
        found.append(LabelledImage(path, lines, size))
    return found


def _from_coco(path: Path, labels: tuple[str, ...]) -> list[LabelledImage]:
    with _naming(path):
        content = json.loads(path.read_text(encoding="utf-8"))
        names = {c["id"]: c["name"] for c in content.get("categories", [])}
        images = {
            image["id"]: LabelledImage(
                path.parent / image["file_name"], [], _size(image.get("height"), image.get("width"))
            )
            for image in sorted(content["images"], key=lambda image: str(image["file_name"]))
        }
        for annotation in content["annotations"]:
            if labels and names.get(annotation.get("category_id")) not in labels:
                continue
            images[annotation["image_id"]].lines.extend(_polyline(flat) for flat in _flat_lists(annotation))
    return list(images.values())


def _size(height: int | None, width: int | None) -> tuple[int, int] | None:
    return (height, width) if height and width else None


def _flat_lists(annotation: dict[str, Any]) -> list[list[float]]:
    lists = annotation["line"] if "line" in annotation else annotation["segmentation"]
    return [lists] if lists and not isinstance(lists[0], list) else lists


def _polyline(points: list[Any]) -> Points:
    polyline = np.asarray(points, float).reshape(-1, 2)
    if len(polyline) < 2 or not np.isfinite(polyline).all():
        raise ValueError("a line needs two or more finite points")
    return polyline


class LabelledScenes:
    """Random crops of labelled images: zoomed, rotated, mirrored, augmented. Sample i is always the same."""

    def __init__(self, images: list[LabelledImage], size: int = 384, seed: int = 0) -> None:
        self.size, self._seed = size, seed
        self._images, self._pixels = images, [image.load() for image in images]

    def __getitem__(self, index: int) -> Sample:
        rng = np.random.default_rng([self._seed, index])
        which = int(rng.integers(len(self._images)))
        pixels, lines = zoom_and_turn(self._pixels[which], self._images[which].lines, rng, self.size)
        pixels, lines = augment_further(pixels, lines, rng)
        return Sample(to_uint8(pixels), lines)


def zoom_and_turn(
    image: ImageArray, lines: list[Points], rng: Rng, size: int
) -> tuple[Floats32, list[Points]]:
    """Return a (size, size) float32 crop at a random place, zoom, angle and mirroring, with its lines.

    Image and lines are mapped alike. Pixels beyond the image have its mean colour.
    """
    height, width = image.shape[:2]
    zoom = np.exp(rng.uniform(np.log(0.7), np.log(1.6))) * max(1.0, size / min(height, width))
    angle = rng.normal(0, 0.25) + rng.integers(4) * np.pi / 2
    turn = zoom * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    if rng.random() < 0.5:
        turn = turn @ np.diag([-1.0, 1.0])
    centre = np.array([rng.uniform(0.2, 0.8) * width, rng.uniform(0.2, 0.8) * height])
    shift = np.array([size / 2, size / 2]) - turn @ centre
    return affine(image, lines, turn, shift, (size, size))
