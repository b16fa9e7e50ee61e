"""A short recording around an anomaly, with all topics of its flight, for those who have no store."""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Any, NamedTuple

from inspect_pipeline.errors import OutputError, UnknownIdError
from inspect_pipeline.recording.frames import iter_channel_messages
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.writer import new_recording
from inspect_pipeline.store.images import open_images
from inspect_pipeline.store.records import SIDECAR

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.recording.reader import Recording
    from inspect_pipeline.store.store import Store

MARGIN_NS = 5 * 10**9  # before the anomaly and after it
_IDS = 1 << 16  # channel ids of a second recording are moved by this


class _Copied(NamedTuple):
    """A message with the id that its channel has in the snippet."""

    log_time_ns: int
    channel_id: int
    publish_time_ns: int
    data: bytes


def export_snippet(store: Store, anomaly: Mapping[str, Any], output: Path) -> int:
    """Write all messages from five seconds before an anomaly to five seconds after it.

    They are those of the annotated copy, or of the recording and the sidecar. A channel that is silent in
    that time, as that of a calibration may be, begins with its last message before it. A video shows from its
    first key frame on.

    Args:
        store: the store.
        anomaly: a row of `anomalies`.
        output: the recording to write; a pipe or device is written to.

    Returns:
        The number of messages.

    Raises:
        RecordingError: the images of the flight are gone or damaged.
        UnknownIdError: the store lacks the flight.
        OutputError
    """
    recordings = _open_recordings(store, anomaly["flight_id"])
    start_ns = max(0, anomaly["start_ns"] - MARGIN_NS)
    end_ns = anomaly["end_ns"] + MARGIN_NS + 1
    n_messages = 0
    try:
        with new_recording(output, profile=recordings[0].profile, replace=True) as author:
            for number, recording in enumerate(recordings):
                for channel in recording.channels:
                    own = _IDS * number + channel.channel_id
                    author.copy_channel(own, *recording.definition(channel.channel_id))
            streams = (_messages(r, _IDS * n, start_ns, end_ns) for n, r in enumerate(recordings))
            for message in heapq.merge(*streams):
                author.copy_message(
                    message.channel_id, message.log_time_ns, message.publish_time_ns, message.data
                )
                n_messages += 1
            for name, metadata in {k: v for r in recordings for k, v in r.metadata.items()}.items():
                author.add_metadata(name, metadata)
    except OSError as error:
        raise OutputError(output, f"cannot be written ({error.strerror})", "name another file") from error
    return n_messages


def _open_recordings(store: Store, flight_id: str) -> Sequence[Recording]:
    """Open the recording with the images of a flight, and that with its annotations if it is another."""
    stored = store.find_flight(flight_id)
    if stored is None:
        raise UnknownIdError("flight of the store", flight_id[:16], "index verify")
    images = open_images(stored.record, stored.folder)
    if stored.record.annotations == SIDECAR:
        return images, open_recording(stored.folder / SIDECAR)
    return (images,)


def _messages(recording: Recording, first_id: int, start_ns: int, end_ns: int) -> Iterator[_Copied]:
    """Yield the messages of a time in their order, those of silent channels first."""
    ids = {channel.channel_id for channel in recording.channels}
    heard = {m.channel_id for m in iter_channel_messages(recording, ids, start_ns=start_ns, end_ns=end_ns)}
    yield from _last_before(recording, ids - heard, first_id, start_ns)
    for m in iter_channel_messages(recording, heard, start_ns=start_ns, end_ns=end_ns):
        yield _Copied(m.log_time_ns, first_id + m.channel_id, m.publish_time_ns, bytes(m.data))


def _last_before(
    recording: Recording, ids: Collection[int], first_id: int, start_ns: int
) -> Iterator[_Copied]:
    """Yield the last message before a time of some channels, at that time."""
    last = {
        m.channel_id: _Copied(start_ns, first_id + m.channel_id, m.publish_time_ns, bytes(m.data))
        for m in iter_channel_messages(recording, ids, end_ns=start_ns)
    }
    yield from sorted(last.values())
