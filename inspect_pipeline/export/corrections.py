"""Frames whose lines a person corrected in `review`, as labelled images for `model train --data`."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from inspect_pipeline.errors import InspectError, OutputError
from inspect_pipeline.export.labels import COCO_FILE, image_name, to_coco, to_labelme, write_labels
from inspect_pipeline.images.draw import write_picture
from inspect_pipeline.store.feedback import load_corrections
from inspect_pipeline.store.images import iter_images, open_images

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.store.feedback import Correction
    from inspect_pipeline.store.store import Store

CORRECTION_FORMATS = ("labelme", "coco")


def export_corrections(
    store: Store, flight_ids: Collection[str], folder: Path, form: str
) -> tuple[int, tuple[str, ...]]:
    """Write the corrected frames of flights into a folder, with all their lines as labels.

    Args:
        store: the store.
        flight_ids: the flights.
        folder: made if missing; files of the same names are replaced.
        form: one of CORRECTION_FORMATS.

    Returns:
        The number of images, and a sentence for each flight whose images cannot be read.

    Raises:
        OutputError, StoreError
    """
    corrections = [one for one in load_corrections(store) if one.flight_id in flight_ids]
    failures: list[str] = []
    labelled = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for one, image in _read_images(store, corrections, failures):
            name = image_name(one.flight_id, one.channel_id, one.frame_idx)
            write_picture(folder / name, image)
            labelled.append((name, _frame_of(one), _lines_of(one)))
            if form == "labelme":
                write_labels((folder / name).with_suffix(".json"), to_labelme(*labelled[-1]))
        if form == "coco":
            write_labels(folder / COCO_FILE, to_coco(labelled))
    except OSError as error:
        raise OutputError(folder, f"cannot be written ({error.strerror})", "name another folder") from error
    return len(labelled), tuple(failures)


def _read_images(
    store: Store, corrections: list[Correction], failures: list[str]
) -> Iterator[tuple[Correction, ImageArray]]:
    """Yield corrections with their images; flights that cannot be read are added to `failures`."""
    for flight_id in dict.fromkeys(one.flight_id for one in corrections):
        stored = store.find_flight(flight_id)
        if stored is None:
            failures.append(f"flight {flight_id[:16]} is not in the store")
            continue
        topics = {channel.channel_id: channel.topic for channel in stored.record.channels}
        own = {
            (topics[one.channel_id], one.frame_idx): one
            for one in corrections
            if one.flight_id == flight_id and one.channel_id in topics
        }
        wanted = {key: one.log_time_ns for key, one in own.items()}
        try:
            for topic, frame_idx, image in iter_images(open_images(stored.record, stored.folder), wanted):
                yield own[topic, frame_idx], image
        except InspectError as error:
            failures.append(str(error))


def _frame_of(one: Correction) -> dict[str, Any]:
    time = datetime.fromtimestamp(one.log_time_ns // 10**9, UTC).replace(tzinfo=None)
    return {"width": one.width, "height": one.height, "log_time_utc": time}


def _lines_of(one: Correction) -> list[dict[str, Any]]:
    return [
        {"points": [{"x": x, "y": y} for x, y in points], "score": 1.0, "track_id": None}
        for points in one.lines
    ]
