"""Copy a recording: the bytes of one file, or all parts merged into one file.

Channel ids may differ between parts, so their messages are written again, in log-time order; the content of
messages does not change.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, TypeVar

from mcap.records import Attachment, Metadata

from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.file import Damage
from inspect_pipeline.recording.frames import iter_channel_messages
from inspect_pipeline.recording.summary import load_record
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import BinaryIO

    from mcap.records import AttachmentIndex, MetadataIndex

    from inspect_pipeline.recording.part import Part
    from inspect_pipeline.recording.reader import Recording

_COPY_BYTES = 256 << 20
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


@contextmanager
def copying_prefix(source: BinaryIO, target: BinaryIO, length: int) -> Iterator[None]:
    """Copy the first `length` bytes in a thread: complete on a clean exit, stopped by an exception."""
    stop = Event()
    with ThreadPoolExecutor(1) as pool:
        copy = pool.submit(_copy_prefix, source, target, length, stop)
        try:
            yield
        except BaseException:
            stop.set()
            raise
        copy.result()


def _copy_prefix(source: BinaryIO, target: BinaryIO, length: int, stop: Event) -> None:
    """Copy between files, inside the kernel where that works.

    Raises RecordingError when the source cannot be read, OSError when the target cannot be written.
    """
    path, offset, in_kernel = Path(source.name), 0, True
    while offset < length and not stop.is_set():
        count = min(length - offset, _COPY_BYTES)
        try:
            if in_kernel:
                n_copied = os.copy_file_range(source.fileno(), target.fileno(), count, offset, offset)
            else:
                n_copied = os.pwrite(
                    target.fileno(), _read(path, source, offset, min(count, 1 << 20)), offset
                )
        except OSError:
            if not in_kernel:
                raise
            in_kernel = False  # which works on any file system, and shows which of the two files fails
            continue
        if n_copied == 0:
            raise RecordingError(path, "it became shorter while it was copied", "wait until it is complete")
        offset += n_copied


def _read(path: Path, source: BinaryIO, offset: int, count: int) -> bytes:
    try:
        return os.pread(source.fileno(), count, offset)
    except OSError as error:
        raise RecordingError(path, f"it cannot be read ({error.strerror})", "check the disk") from error
