"""Small pictures of a flight, kept in its folder: the frames that show its anomalies and spans, and crops.

They have no lines: pages draw these over them. A picture's name says what it shows, so only those that are
missing are made, and those that no report needs any more are removed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import InspectError
from inspect_pipeline.report.evidence import Evidence, find_evidence
from inspect_pipeline.store.images import iter_images, open_images

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.index.reading import IndexReader
    from inspect_pipeline.store.store import Store

FOLDER = "pictures"  # in a flight's folder
_FRAME_PX, _CROP_PX = 520, 300  # longer sides
_FRAME_BYTES, _CROP_BYTES = 9_000, 6_000
_QUALITIES = (75, 62, 50, 40, 30, 22)
_SHRINK = 0.85  # where the least quality is still too large


def make_pictures(index: IndexReader, store: Store, flight_id: str) -> None:
    """Make the missing pictures of a flight; without its images those that are there stay.

    Raises OSError, RulesError, SpansError, and the errors of the index.
    """
    found = find_evidence(index, store, flight_id)
    wanted: dict[str, Evidence] = {}
    for evidence in (*found.of_anomalies.values(), *found.of_spans.values()):
        wanted |= dict.fromkeys(evidence.picture_names, evidence)
    folder = store.flight_dir(flight_id) / FOLDER
    present = {path.name for path in folder.glob("*") if is_made(path)}
    for name in present - wanted.keys():
        (folder / name).unlink()
    missing = [evidence for name, evidence in wanted.items() if name not in present]
    if missing:
        folder.mkdir(exist_ok=True)
        try:
            for evidence, image in _read_images(store, flight_id, missing):
                _write_pictures(folder, evidence, image)
        except InspectError:  # the images are gone or damaged: the page says which pictures it lacks
            return


def _read_images(
    store: Store, flight_id: str, wanted: list[Evidence]
) -> Iterator[tuple[Evidence, ImageArray]]:
    """Yield each evidence with its image. Raises RecordingError."""
    stored = store.find_flight(flight_id)
    if stored is None:
        return
    by_key: dict[tuple[int, int], list[Evidence]] = {}
    for one in wanted:
        by_key.setdefault(one.key, []).append(one)
    topics = {channel.channel_id: channel.topic for channel in stored.record.channels}
    times = {(topics[channel_id], i): all_of[0].log_time_ns for (channel_id, i), all_of in by_key.items()}
    channels = {topic: channel_id for channel_id, topic in topics.items()}
    for topic, frame_idx, image in iter_images(open_images(stored.record, stored.folder), times):
        for one in by_key[channels[topic], frame_idx]:
            yield one, image


def _write_pictures(folder: Path, evidence: Evidence, image: ImageArray) -> None:
    frame, *crops = evidence.picture_names
    if not is_made(folder / frame):
        _write(folder / frame, encode_small(image, _FRAME_PX, _FRAME_BYTES))
    if evidence.crop and not is_made(folder / crops[0]):
        left, top, side = evidence.crop.left, evidence.crop.top, evidence.crop.side
        part = image[top : top + side, left : left + side]
        _write(folder / crops[0], encode_small(part, _CROP_PX, _CROP_BYTES))


def is_made(path: Path) -> bool:
    """Whether a picture is there; a power cut can leave an empty file."""
    return path.exists() and path.stat().st_size > 0


def _write(path: Path, data: bytes) -> None:
    with appearing(path) as part:
        part.write_bytes(data)


def encode_small(image: ImageArray, longer_px: int, max_bytes: int) -> bytes:
    """Return an RGB image as JPEG of at most this size, not enlarged, as good as the bytes allow."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    while True:
        scale = min(1.0, longer_px / max(bgr.shape[:2]))
        size = [max(1, round(scale * n)) for n in bgr.shape[1::-1]]
        small = cv2.resize(bgr, size, interpolation=cv2.INTER_AREA)
        for quality in _QUALITIES:
            data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
            if len(data) <= max_bytes or longer_px < 64:
                return data.tobytes()
        longer_px = int(longer_px * _SHRINK)
