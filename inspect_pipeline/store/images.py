"""The recordings with the images of flights."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote_to_bytes, urlsplit

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.records import ANNOTATED

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.store.records import FlightRecord


def open_images(flight: FlightRecord, folder: Path) -> Recording:
    """Open the recording with the images of a flight in the store's `folder`: annotated copy, else source.

    Raises RecordingError, also when the source has another size than when the flight was made.
    """
    if flight.annotations == ANNOTATED:
        return open_recording(folder / ANNOTATED)
    source = open_recording(source_path(flight.source_uri))
    if source.size_bytes != flight.source_bytes:
        raise RecordingError(source.path, "it is no longer what the flight was made from", "process it again")
    return source


def iter_images(
    source: Recording, wanted: Mapping[tuple[str, int], int]
) -> Iterator[tuple[str, int, ImageArray]]:
    """Yield topic, frame_idx and image, uint8 (height, width, 3) RGB, of those frames that have one.

    Args:
        source: the recording.
        wanted: log times in ns by topic and frame_idx.

    Raises:
        RecordingError: the recording cannot be read, or lacks one of the topics.
    """
    for topic in dict.fromkeys(topic for topic, _ in wanted):
        cameras = source.select_cameras([topic])
        own = sorted((frame_idx, time_ns) for (name, frame_idx), time_ns in wanted.items() if name == topic)
        # A video is decoded from its start in any case, so once; of others only the wanted images are.
        is_video = cameras[0].channel_id in source.video_channel_ids
        for first_ns, last_ns in [(own[0][1], own[-1][1])] if is_video else _time_ranges(own):
            for frame in iter_frames(source, cameras, start_ns=first_ns, end_ns=last_ns + 1):
                if frame.image is not None and (topic, frame.frame_idx) in wanted:
                    yield topic, frame.frame_idx, frame.image


def _time_ranges(frames: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the first and last time of each run of frames that follow each other."""
    ranges: list[tuple[int, int]] = []
    previous = None
    for frame_idx, time_ns in frames:
        is_next = previous is not None and frame_idx <= previous + 1
        ranges[-1:] = [(ranges[-1][0], time_ns)] if is_next else [*ranges[-1:], (time_ns, time_ns)]
        previous = frame_idx
    return ranges


def source_path(source_uri: str) -> Path:
    """Return the path of a recording from its URI in the index."""
    return Path(os.fsdecode(unquote_to_bytes(urlsplit(source_uri).path)))
