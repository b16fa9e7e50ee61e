"""The parts of a split recording made one file.

A channel's number may differ from part to part, so messages are written anew; nothing in them changes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.frames import iter_channel_messages
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.recording.writer import RecordingAuthor


def join_parts(parts: Sequence[Recording], target: Path) -> int:
    """Write the messages, metadata and attachments of all parts to one recording, part by part.

    Returns the number of messages; what cannot be read is in the losses of the parts. Raises RecordingError
    when a part is an annotated copy, or anything is lost of a `strict` one, OSError when the target cannot be
    written.
    """
    for part in parts:
        if part.is_annotated_copy:
            raise RecordingError(part.path, "it carries annotations already", "join what it is from")
    with new_recording(target, profile=parts[0].profile) as author:
        return sum(_append(author, part) for part in parts)


def _append(author: RecordingAuthor, part: Recording) -> int:
    layout, n_messages = part.layout, 0
    for message in iter_channel_messages(part, layout.channels.keys()):
        channel = layout.channels[message.channel_id]
        schema = layout.schemas.get(channel.schema_id)
        times_ns = message.log_time_ns, message.publish_time_ns
        author.copy_message(channel, schema, *times_ns, bytes(message.data))
        n_messages += 1
    for record in part.iter_metadata():
        author.add_metadata(record.name, record.metadata)
    for attachment in part.iter_attachments():
        author.add_attachment(attachment)
    return n_messages
