"""Split recordings: the parts of one flight in a folder, and how they become one file.

Parts are the files that a rosbag2's metadata.yaml lists, or that differ by the number at the end of their
names only (flight_0.mcap, flight_1.mcap, ...). A channel's number may differ from part to part, so messages
are written anew; nothing in them changes.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from inspect_pipeline.authoring import new_recording
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording_frames import iter_channel_messages

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from inspect_pipeline.authoring import RecordingAuthor
    from inspect_pipeline.recording import Recording

_LISTED = re.compile(r"^\s*-\s*[\"']?(.+?\.mcap)[\"']?\s*$", re.MULTILINE)
_NUMBERED = re.compile(r"(.*?)_?(\d+)")


def find_parts(folder: Path) -> list[Path]:
    """The parts of a split recording in order; empty when the folder holds none.

    Raises RecordingError when its files are not parts of one recording, or one of those listed is absent.
    """
    index = folder / "metadata.yaml"
    if index.is_file():
        # Paths in old bags begin with the name of the bag.
        listed = [
            folder / name.rsplit("/", 1)[-1] for name in _LISTED.findall(index.read_text("utf-8", "replace"))
        ]
        for part in listed:
            if not part.is_file():
                raise RecordingError(part, "metadata.yaml lists it but it is absent", "copy the folder again")
        return listed
    matches = {path: _NUMBERED.fullmatch(path.stem) for path in folder.glob("*.mcap")}
    names = {match[1] if match else path.stem for path, match in matches.items()}
    if len(names) > 1 or (len(matches) > 1 and None in matches.values()):
        raise RecordingError(folder, "its recordings are not parts of one", "name one of them")
    return sorted(matches, key=lambda path: int(match[2]) if (match := matches[path]) else 0)


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
        schema, times_ns = (
            layout.schemas.get(channel.schema_id),
            (message.log_time_ns, message.publish_time_ns),
        )
        author.copy_message(channel, schema, *times_ns, bytes(message.data))
        n_messages += 1
    for name, fields in part.metadata.items():
        author.add_metadata(name, fields)
    for attachment in part.iter_attachments():
        author.add_attachment(attachment)
    return n_messages
