"""Lines of frames as labels: COCO for a folder, labelme for each image. `model train --data` reads both."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from inspect_pipeline.atomic import appearing
from inspect_pipeline.export.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    Row = Mapping[str, Any]

COCO_FILE = "annotations.json"
_LABEL = "wire"


def image_name(flight_id: str, channel_id: int, frame_idx: int) -> str:
    """Return the file name of an exported frame; labelme's labels of it have the same with .json."""
    return f"{flight_id[:16]}_{channel_id}_{frame_idx:06d}.jpg"


def write_labels(path: Path, labels: dict[str, Any]) -> None:
    """Write labels as JSON, whole or not at all. Raises OSError."""
    with appearing(path) as part:
        part.write_text(json.dumps(labels, indent=1) + "\n", encoding="utf-8")


def to_coco(images: Iterable[tuple[str, Row, Sequence[Row]]]) -> dict[str, Any]:
    """Return COCO labels of images, each a file name, its row of `frames`, and rows of `lines`.

    "line" holds the polyline x1, y1, x2, y2, ...; "segmentation" the same there and back, since COCO has
    polygons only.
    """
    coco: dict[str, Any] = {"images": [], "annotations": [], "categories": [{"id": 1, "name": _LABEL}]}
    for image_id, (name, frame, lines) in enumerate(images, 1):
        coco["images"].append(
            {
                "id": image_id,
                "file_name": name,
                "width": frame["width"],
                "height": frame["height"],
                "date_captured": plain(frame["log_time_utc"]),
            }
        )
        for line in lines:
            coco["annotations"].append(_to_annotation(len(coco["annotations"]) + 1, image_id, line))
    return coco


def _to_annotation(annotation_id: int, image_id: int, line: Row) -> dict[str, Any]:
    points = _points(line)
    (left, top), (right, bottom) = (tuple(map(end, zip(*points, strict=True))) for end in (min, max))
    flat = [value for point in points for value in point]
    back = [value for point in reversed(points) for value in point]
    return {
        "id": annotation_id,
        "image_id": image_id,
        "category_id": 1,
        "line": flat,
        "segmentation": [flat + back],
        "bbox": [left, top, right - left, bottom - top],
        "area": (right - left) * (bottom - top),
        "iscrowd": 0,
        "score": line["score"],
        "track_id": line["track_id"],
    }


def to_labelme(name: str, frame: Row, lines: Sequence[Row]) -> dict[str, Any]:
    """Return the labelme file of an image."""
    shapes = [
        {
            "label": _LABEL,
            "points": _points(line),
            "group_id": line["track_id"],
            "shape_type": "linestrip",
            "flags": {},
        }
        for line in lines
    ]
    return {
        "version": "5.0.0",
        "flags": {},
        "shapes": shapes,
        "imagePath": name,
        "imageData": None,
        "imageHeight": frame["height"],
        "imageWidth": frame["width"],
    }


def _points(line: Row) -> list[tuple[float, float]]:
    return [(point["x"], point["y"]) for point in line["points"]]
