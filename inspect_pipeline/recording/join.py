"""Merge the parts of a recording into one file.

Channel ids may differ between parts, so messages are written again, in log-time order; their content does not
change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from mcap.records import Attachment, Metadata

from inspect_pipeline.recording.file import Damage
from inspect_pipeline.recording.frames import iter_channel_messages
from inspect_pipeline.recording.summary import load_record
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from mcap.records import AttachmentIndex, MetadataIndex

    from inspect_pipeline.recording.part import Part
    from inspect_pipeline.recording.reader import Recording

_R = TypeVar("_R", Attachment, Metadata)


def join_parts(recording: Recording, target: Path) -> tuple[int, tuple[str, ...]]:
    """Write the messages, metadata and attachments of a recording to one file.

    Channels get the ids that they have in `recording` when it has several parts.

    Returns:
        The number of messages, and a phrase for each stretch that could not be read.

    Raises:
        RecordingError: anything is lost of a `strict` recording.
        OSError: the target cannot be written.
    """
    losses: list[str] = []
    with new_recording(target, profile=recording.profile) as author:
        for channel in sorted(recording.channels, key=lambda channel: channel.channel_id):
            author.copy_channel(channel.channel_id, *recording.definition(channel.channel_id))
        messages, n_messages = iter_channel_messages(recording, [c.channel_id for c in recording.channels]), 0
        for message in messages:
            author.copy_message(
                message.channel_id, message.log_time_ns, message.publish_time_ns, bytes(message.data)
            )
            n_messages += 1
        for part in recording.parts:
            for metadata in _iter_records(recording, part, Metadata, part.layout.metadata, losses):
                author.add_metadata(metadata.name, metadata.metadata)
            for attachment in _iter_records(recording, part, Attachment, part.layout.attachments, losses):
                author.add_attachment(attachment)
    return n_messages, (*messages.losses, *losses)


def _iter_records(
    recording: Recording,
    part: Part,
    kind: type[_R],
    indexes: Iterable[AttachmentIndex | MetadataIndex],
    losses: list[str],
) -> Iterator[_R]:
    """Iterate over the records of a kind in a part; one that cannot be read is added to `losses`."""
    with part.open() as file:
        for index in indexes:
            try:
                yield load_record(file, kind, index.offset)
            except Damage as damage:
                losses.append(recording.loss_in(part, f"{damage} at byte {part.start + index.offset:,}"))
