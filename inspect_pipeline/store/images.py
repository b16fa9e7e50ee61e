"""The recordings with the images of flights."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote_to_bytes, urlsplit

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.store.records import ANNOTATED

if TYPE_CHECKING:
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


def source_path(source_uri: str) -> Path:
    """Return the path of a recording by the URI that the index has of it."""
    return Path(os.fsdecode(unquote_to_bytes(urlsplit(source_uri).path)))
