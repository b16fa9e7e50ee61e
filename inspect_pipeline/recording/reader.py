"""Recordings: what an MCAP file, or a split recording, holds. Frames are read by `frames`.

    recording = open_recording("flight.mcap")
    cameras = recording.select_cameras()
    for frame in iter_frames(recording, cameras): ...

Times are integer nanoseconds, ranges are start <= t < end.
"""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from inspect_pipeline.errors import DamagedRecordingError, NoImagesError, RecordingError
from inspect_pipeline.recording.cameras import find_cameras, is_image, to_camera
from inspect_pipeline.recording.file import reading
from inspect_pipeline.recording.log_times import usual_times
from inspect_pipeline.recording.merge import PartExtent
from inspect_pipeline.recording.part import number_channels, open_parts, part_counts, summarize_channels
from inspect_pipeline.recording.split import find_parts, missing_numbers

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from mcap.records import Channel, Schema

    from inspect_pipeline.recording.log_times import TimeRange
    from inspect_pipeline.recording.part import Part
    from inspect_pipeline.recording.types import CameraChannel, ChannelSummary

_DIGEST_BYTES = 1 << 20
_MAX_PHRASES = 10  # of a message
_PLAUSIBLE_S = (946_684_800, 4_102_444_800)  # the years 2000 to 2100
_WRONG_UNITS = {"seconds": 1, "milliseconds": 10**3, "microseconds": 10**6}
_YEAR_NS = 365 * 86_400 * 10**9
RUN_METADATA = "lsnet_pipe.run"  # name of the Metadata record that marks an annotated copy


class Identity(NamedTuple):
    """The flight_id of a recording, and a phrase for each file whose bytes do not match their CRC."""

    flight_id: str
    losses: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Recording:
    """What an MCAP file, or the folder of a split recording, holds.

    path: the file or folder. parts: its MCAP files in order.
    start_ns, end_ns: first and last log time, both 0 without messages.
    channels: of all parts. A single part keeps its channel ids; those of several are renumbered from 1.
    camera_channels: the colour cameras, each once, in the order of their topics.
    refusals: topics of images that are not cameras, and why.
    video_channel_ids: channels with images that are pieces of a video.
    metadata: the Metadata records by name.
    losses: one phrase for each stretch that was found to be unreadable when the recording was opened.
    strict: whether a loss raises RecordingError.
    """

    path: Path
    parts: tuple[Part, ...]
    strict: bool
    profile: str
    start_ns: int
    end_ns: int
    channels: tuple[ChannelSummary, ...]
    camera_channels: tuple[CameraChannel, ...]
    refusals: Mapping[str, str]
    video_channel_ids: frozenset[int]
    metadata: Mapping[str, Mapping[str, str]]
    losses: tuple[str, ...]

    @property
    def files(self) -> Mapping[Path, int]:
        """The size in bytes of each file, in order."""
        return {part.path: part.file_bytes for part in self.parts}

    @property
    def size_bytes(self) -> int:
        """The size of all files together."""
        return sum(self.files.values())

    @property
    def warnings(self) -> list[str]:
        """What is unusual about the log times and parts, one phrase each."""
        found = [
            f"its log times look like {unit} instead of nanoseconds"
            for unit, factor in _WRONG_UNITS.items()
            if _PLAUSIBLE_S[0] <= self.start_ns / factor <= self.end_ns / factor < _PLAUSIBLE_S[1]
        ]
        years = (self.end_ns - self.start_ns) / _YEAR_NS
        if years > 1:
            found.append(f"its log times span {round(years)} {'year' if round(years) == 1 else 'years'}")
        if missing := missing_numbers(list(self.files)):
            found.append(f"parts between the first and the last are missing: {join_phrases(missing, ', ')}")
        for part in self.parts:
            starts = [e.start_ns for e in part.layout.extents if e.channel_ids is None or e.channel_ids]
            if n_early := sum(after < before for before, after in pairwise(starts)):
                text = f"its messages are out of order in {n_early:,} {'place' if n_early == 1 else 'places'}"
                found.append(_name_part(self.parts, part, text))
        return found

    @property
    def is_annotated_copy(self) -> bool:
        """Whether this program wrote annotations into the file."""
        return RUN_METADATA in self.metadata

    @property
    def flight_id(self) -> str:
        """`identity.flight_id`; reads the whole recording at its first use. Raises RecordingError."""
        return self.identity.flight_id

    @cached_property
    def identity(self) -> Identity:
        """The flight_id, and what its computation found to be damaged.

        It is the SHA-256 in hex of the file, or of the lines with those of several files; of an annotated
        copy, that of the flight it belongs to. Reads all files once, and checks the CRC of each data section
        on the way. Raises RecordingError.
        """
        named = self.metadata.get(RUN_METADATA, {}).get("flight_id")
        if named:
            return Identity(named, ())
        sums, losses = [], []
        for path in self.files:
            parts = [part for part in self.parts if part.path == path]
            sha256, crc = _digest(path, parts[0].layout.data_end if parts[0].layout.data_crc else 0)
            sums.append(sha256)
            if crc != parts[0].layout.data_crc:
                losses.append(self.loss_in(parts[0], "its data section does not match its CRC"))
        lines = "".join(f"{each}\n" for each in sums)
        flight_id = sums[0] if len(sums) == 1 else hashlib.sha256(lines.encode()).hexdigest()
        return Identity(flight_id, tuple(losses))

    def loss_in(self, part: Part, loss: str) -> str:
        """Return the phrase of a loss, which names the part where there are several.

        Raises RecordingError when the recording is `strict`.
        """
        if self.strict:
            raise DamagedRecordingError(part.path, loss)
        return _name_part(self.parts, part, loss)

    def select_cameras(self, topics: Collection[str] | None = None) -> tuple[CameraChannel, ...]:
        """Return the cameras of `topics`, or all colour cameras. Raises RecordingError when there is none."""
        if topics is None:
            if not self.camera_channels:
                raise self._no_camera()
            return self.camera_channels
        images_by_topic = {c.topic: c for c in self.channels if is_image(c)}
        for topic in topics:
            if topic not in images_by_topic:
                known = ", ".join(sorted(images_by_topic)) or "none"
                raise RecordingError(self.path, f"no images on topic {topic}", f"its image topics: {known}")
        return tuple(to_camera(c) for c in self.channels if c.topic in topics and is_image(c))

    def _no_camera(self) -> RecordingError:
        """Say what was lost and why topics of images were refused, or else which topics there are."""
        reasons = [*self.losses, *(f"{topic}: {reason}" for topic, reason in self.refusals.items())]
        if reasons:
            where = " in the part that can be read" if self.losses else ""
            return RecordingError(self.path, f"no camera topic{where}", join_phrases(reasons))
        topics = [channel.topic for channel in self.channels]
        return NoImagesError(
            self.path, "no camera topic", f"its topics: {join_phrases(topics, ', ') or 'none'}"
        )

    def definition(self, channel_id: int) -> tuple[Channel, Schema | None]:
        """Return the Channel and Schema records of a channel, with the ids they have in their part."""
        part, id_of_part = self._first_parts[channel_id]
        channel = part.layout.channels[id_of_part]
        return channel, part.layout.schemas.get(channel.schema_id)

    @cached_property
    def _first_parts(self) -> Mapping[int, tuple[Part, int]]:
        """By channel id: the first part that has the channel, and its id there."""
        return {i: (part, of_part) for part in reversed(self.parts) for of_part, i in part.ids.items()}

    def schema_data(self, channel_id: int) -> bytes:
        """Return the schema of a channel as the file has it; empty when it has none."""
        schema = self.definition(channel_id)[1]
        return schema.data if schema else b""

    def extents(self, channel_ids: Collection[int]) -> list[PartExtent]:
        """Return the extents that may hold messages of these channels."""
        found = (
            PartExtent(number, part, extent)
            for number, part in enumerate(self.parts)
            for extent in part.layout.extents
        )
        wanted = frozenset(channel_ids)
        return [each for each in found if (ids := each.channel_ids) is None or ids & wanted]

    def usual_times(self, cameras: Iterable[CameraChannel]) -> TimeRange:
        """Return the range of log times of some cameras without outliers. Raises RecordingError."""
        ids = frozenset(camera.channel_id for camera in cameras)
        return usual_times(self.extents(ids), ids)

    def message_counts(self) -> Counter[int]:
        """Count messages per channel id, reading chunks where neither statistics nor indexes say.

        Raises RecordingError.
        """
        counts = Counter[int]()
        for part in self.parts:
            for channel_id, count in part_counts(part).items():
                if channel_id in part.ids:
                    counts[part.ids[channel_id]] += count
        return counts


def open_recording(path: Path | str, *, strict: bool = False) -> Recording:
    """Read what an MCAP file, or the folder of a split recording, holds.

    Args:
        path: the file or folder.
        strict: raise RecordingError for anything that cannot be read, now and when it is read on.

    Raises:
        RecordingError: it is not a recording, or damaged and `strict`.
    """
    path = Path(path)
    parts = number_channels([part for each in files_of(path) for part in open_parts(each)])
    extents = [e for part in parts for e in part.layout.extents if e.channel_ids is None or e.channel_ids]
    channels = summarize_channels(parts)
    cameras = find_cameras(parts, channels)
    recording = Recording(
        path=path,
        parts=parts,
        strict=strict,
        profile=parts[0].layout.header.profile,
        start_ns=min((e.start_ns for e in extents), default=0),
        end_ns=max((e.end_ns for e in extents), default=0),
        channels=channels,
        camera_channels=cameras.channels,
        refusals=cameras.refusals,
        video_channel_ids=cameras.video_channel_ids,
        metadata={name: record for part in parts for name, record in part.metadata.items()},
        losses=tuple(_name_part(parts, part, loss) for part in parts for loss in part.layout.losses),
    )
    for part in parts:
        for loss in part.layout.losses:
            recording.loss_in(part, loss)
        if len(parts) > 1 and RUN_METADATA in part.metadata:
            raise RecordingError(part.path, "it carries annotations already", "use what it was made from")
    return recording


def check_recording(path: Path) -> None:
    """Raise the RecordingError of `open_recording` for what is seen at once, such as a missing file."""
    for each in files_of(path):
        with reading(each):
            pass


def files_of(path: Path) -> list[Path]:
    """Return the files of a recording: itself, or those of a folder. Raises RecordingError."""
    paths = find_parts(path) if path.is_dir() else [path]
    if not paths:
        raise RecordingError(
            path, "the folder has no recording", f"make one of photographs: lsnet-pipe pack {path} FILE"
        )
    return paths


def join_phrases(phrases: Sequence[str], separator: str = "; ") -> str:
    """Join the first few phrases, and say how many more there are."""
    shown = separator.join(phrases[:_MAX_PHRASES])
    n_more = len(phrases) - _MAX_PHRASES
    return f"{shown}{separator}and {n_more:,} more" if n_more > 0 else shown


def _name_part(parts: Sequence[Part], part: Part, text: str) -> str:
    return f"{part.path.name}: {text}" if parts[0].path != parts[-1].path else text


def _digest(path: Path, n_crc_bytes: int) -> tuple[str, int]:
    """Return (SHA-256 of a file in hex, CRC-32 of its first `n_crc_bytes`)."""
    sha256, crc = hashlib.sha256(), 0
    with reading(path) as file:
        for offset in range(0, file.size_bytes, _DIGEST_BYTES):
            block = file.read(offset, min(_DIGEST_BYTES, file.size_bytes - offset))
            sha256.update(block)
            if offset < n_crc_bytes:
                crc = zlib.crc32(memoryview(block)[: n_crc_bytes - offset], crc)
    return sha256.hexdigest(), crc
