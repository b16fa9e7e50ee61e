"""Make recordings of what drones give: photographs, a video with its subtitles, a recording in parts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from inspect_pipeline.convert.messages import PackResult
from inspect_pipeline.convert.photographs import pack_photographs
from inspect_pipeline.convert.video import pack_video
from inspect_pipeline.errors import OutputError, RecordingError
from inspect_pipeline.recording.join import join_parts
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.split import find_parts

if TYPE_CHECKING:
    from datetime import datetime, tzinfo
    from pathlib import Path

__all__ = ["PackResult", "pack"]


def pack(
    source: Path, target: Path, *, zone: tzinfo | None = None, start: datetime | None = None
) -> PackResult:
    """Make a recording of a folder of JPEGs or of a recording's parts, or of a video with its subtitles.

    Args:
        source: the folder, or the video.
        target: the recording to make, which must not exist.
        zone: of cameras' clocks that say none; by default what most photographs say, else UTC.
        start: of a video, instead of what it says itself.

    Raises:
        RecordingError: the source cannot be used.
        OutputError: the target cannot be written.
    """
    if target.exists():
        raise OutputError(target, "it exists already", "name another file")
    if not source.exists():
        raise RecordingError(source, "there is no such file or folder", "check the name")
    try:
        if not source.is_dir():
            return pack_video(source, target, zone, start)
        if find_parts(source):
            return _pack_parts(source, target)
        return pack_photographs(source, target, zone)
    except OSError as error:
        what = error.filename or target
        raise OutputError(
            target, f"it cannot be made ({what}: {error.strerror})", "check rights and disk"
        ) from error


def _pack_parts(folder: Path, target: Path) -> PackResult:
    """Make one file of the parts of a split recording."""
    recording = open_recording(folder)
    if recording.is_annotated_copy:
        raise RecordingError(recording.path, "it carries annotations already", "use what it was made from")
    n_messages, losses = join_parts(recording, target)
    losses = tuple(dict.fromkeys((*recording.losses, *losses)))
    return PackResult({"parts": len(recording.parts), "messages": n_messages}, losses)
