"""Recordings made of what drones give: a folder of JPEGs, a video with its subtitles, a recording in parts.

Images, video and messages are taken as they are, nothing is encoded again.
"""

from __future__ import annotations

import statistics
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

from inspect_pipeline.convert.dji_srt import SubtitleBlock, parse_srt
from inspect_pipeline.convert.exif import PhotographTags, read_tags
from inspect_pipeline.errors import OutputError, RecordingError
from inspect_pipeline.geometry.attitude import to_enu
from inspect_pipeline.recording.join import join_parts
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.split import find_parts
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import av

    from inspect_pipeline.geometry.attitude import Position, YawPitchRoll
    from inspect_pipeline.recording.writer import RecordingAuthor

IMAGE_TOPIC, VIDEO_TOPIC = "/camera/image/compressed", "/camera/video"
FIX_TOPIC, ATTITUDE_TOPIC, CALIBRATION_TOPIC = "/gps/fix", "/camera/attitude", "/camera/calibration"
_FRAME_ID = "camera"
_STEP_NS = 1_000_000  # between photographs of one second, whose stamps must differ
_ZONE_STEP = timedelta(minutes=15)
_MICROSECOND = timedelta(microseconds=1)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_ANNEX_B = {"h264": "h264_mp4toannexb", "hevc": "hevc_mp4toannexb"}


@dataclass(frozen=True, slots=True)
class PackResult:
    """What a recording was made of: numbers by what they count, and a phrase for each thing left out."""

    counts: Mapping[str, int]
    warnings: tuple[str, ...] = ()


def pack(source: Path, target: Path) -> PackResult:
    """Make a recording of a folder of JPEGs or of a recording's parts, or of a video with its subtitles.

    Raises RecordingError when the source cannot be used, OutputError when the target cannot be written.
    """
    if target.exists():
        raise OutputError(target, "it exists already", "name another file")
    if not source.exists():
        raise RecordingError(source, "there is no such file or folder", "check the name")
    try:
        if not source.is_dir():
            return pack_video(source, target)
        if find_parts(source):
            return pack_parts(source, target)
        return pack_photographs(source, target)
    except OSError as error:
        what = error.filename or target
        raise OutputError(
            target, f"it cannot be made ({what}: {error.strerror})", "check rights and disk"
        ) from error


def pack_parts(folder: Path, target: Path) -> PackResult:
    """Make one file of the parts of a split recording."""
    recording = open_recording(folder)
    if recording.is_annotated_copy:
        raise RecordingError(recording.path, "it carries annotations already", "use what it was made from")
    n_messages, losses = join_parts(recording, target)
    losses = tuple(dict.fromkeys((*recording.losses, *losses)))
    return PackResult({"parts": len(recording.parts), "messages": n_messages}, losses)


def pack_photographs(folder: Path, target: Path) -> PackResult:
    """A recording of the JPEGs of a folder in the order of their times.

    Times are those of the camera's clock, moved to UTC by the zone that EXIF or the GPS time tell; without
    either they are taken for UTC.
    """
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in {".jpg", ".jpeg"})
    found = {path: read_tags(path) for path in paths}
    tags_by_path = {path: tags for path, tags in found.items() if tags and tags.clock}
    if not tags_by_path:
        raise RecordingError(
            folder, "it has no MCAP file, and no JPEG that says when it was taken", "name another folder"
        )
    zone = _zone(list(tags_by_path.values()))
    shots = sorted((_utc_ns(tags, zone), path) for path, tags in tags_by_path.items())
    before_ns = 0
    with new_recording(target) as author:
        for clock_ns, path in shots:
            before_ns = time_ns = max(clock_ns, before_ns + _STEP_NS)
            _write_photograph(author, time_ns, path, tags_by_path[path])
    counts = {
        "images": len(shots),
        "positions": sum(tags.position is not None for tags in tags_by_path.values()),
        "attitudes": sum(tags.gimbal is not None for tags in tags_by_path.values()),
    }
    without = (
        f"{path} {'does not say when it was taken' if tags else 'cannot be read'}, it is left out"
        for path, tags in found.items()
        if path not in tags_by_path
    )
    return PackResult(counts, tuple(without))


def _write_photograph(author: RecordingAuthor, time_ns: int, path: Path, tags: PhotographTags) -> None:
    """The image behind what is known of it, so that readers know it when the image comes."""
    _write_pose(author, time_ns, tags.position, tags.gimbal, tags.height_m)
    if tags.focal_px:
        height, width = tags.image_size
        author.write_calibration(
            CALIBRATION_TOPIC,
            time_ns,
            _FRAME_ID,
            image_size=tags.image_size,
            focal_px=(tags.focal_px, tags.focal_px),
            centre_px=(width / 2, height / 2),
        )
    author.write_image(IMAGE_TOPIC, time_ns, _FRAME_ID, path.read_bytes(), "jpeg", is_photograph=True)


def _write_pose(
    author: RecordingAuthor,
    time_ns: int,
    position: Position | None,
    gimbal: YawPitchRoll | None,
    height_m: float | None,
) -> None:
    if position:
        author.write_location(
            FIX_TOPIC,
            time_ns,
            "gps",
            latitude_deg=position.latitude_deg,
            longitude_deg=position.longitude_deg,
            altitude_m=position.altitude_m,
        )
    if gimbal:
        place_m = (0.0, 0.0, height_m or 0.0)  # all 0 where it is not known
        author.write_attitude(
            ATTITUDE_TOPIC, time_ns, "map", _FRAME_ID, to_enu(gimbal), translation_m=place_m
        )


def _zone(photographs: Sequence[PhotographTags]) -> timedelta:
    """How far the camera's clock is ahead of UTC: by EXIF, else by GPS to a quarter of an hour, else 0."""
    zones = [tags.zone for tags in photographs if tags.zone is not None]
    if zones:
        return statistics.mode(zones)
    ahead = [
        round((tags.clock.replace(tzinfo=UTC) - tags.gps_clock) / _ZONE_STEP)
        for tags in photographs
        if tags.clock and tags.gps_clock
    ]
    return statistics.mode(ahead) * _ZONE_STEP if ahead else timedelta()


def _utc_ns(tags: PhotographTags, zone: timedelta) -> int:
    assert tags.clock is not None  # noqa: S101 - those without were left out
    return _to_ns(tags.clock.replace(tzinfo=UTC), zone)


def _to_ns(time: datetime, zone: timedelta = timedelta()) -> int:
    """Nanoseconds since 1970 of a clock that is `zone` ahead; clocks may begin in the year 1."""
    return (time - _EPOCH - zone) // _MICROSECOND * 1000


def pack_video(video: Path, target: Path) -> PackResult:
    """A recording of a video as it is, H.264 or H.265, with the poses of the subtitles beside it.

    The video begins when the subtitles say, taken for UTC, else when its own head says. Needs the extra
    `video`.
    """
    try:
        import av  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise RecordingError(
            video, "videos need PyAV", "install lsnet-pipe with the extra 'video'"
        ) from error
    blocks = _subtitles(video)
    try:
        with closing(av.open(str(video))) as container:
            start_ns = _start_ns(video, blocks, container)
            with new_recording(target) as author:
                for block in blocks:
                    _write_pose(
                        author, start_ns + block.offset_ns, block.position, block.gimbal, block.height_m
                    )
                n_images = _write_packets(author, video, container, start_ns)
    except av.FFmpegError as error:
        raise RecordingError(video, "it is not a video that can be read", "name an MP4 file") from error
    return PackResult(
        {
            "images": n_images,
            "positions": sum(block.position is not None for block in blocks),
            "attitudes": sum(block.gimbal is not None for block in blocks),
        }
    )


def _subtitles(video: Path) -> list[SubtitleBlock]:
    beside = [path for path in video.parent.glob("*") if path.stem == video.stem]
    path = next((path for path in beside if path.suffix.lower() == ".srt"), None)
    return list(parse_srt(path.read_text("utf-8", errors="replace"))) if path else []


def _start_ns(video: Path, blocks: Sequence[SubtitleBlock], container: av.container.InputContainer) -> int:
    for block in blocks:
        if block.clock:
            return _to_ns(block.clock) - block.offset_ns
    try:
        created = datetime.fromisoformat(container.metadata.get("creation_time", ""))
    except ValueError as error:
        raise RecordingError(
            video, "it does not say when it was taken", "put its SRT file beside it"
        ) from error
    return _to_ns(created if created.tzinfo else created.replace(tzinfo=UTC))


def _write_packets(
    author: RecordingAuthor, video: Path, container: av.container.InputContainer, start_ns: int
) -> int:
    """A message per picture, from the first key frame on. Returns their number."""
    from av.bitstream import BitStreamFilterContext  # noqa: PLC0415

    stream = next(iter(container.streams.video), None)
    codec = stream.codec_context.name if stream else ""
    if stream is None or codec not in _ANNEX_B:
        raise RecordingError(video, "it holds neither H.264 nor H.265", "convert it with ffmpeg")
    annex_b, n_images, last_ns = BitStreamFilterContext(_ANNEX_B[codec], stream), 0, 0
    name = "h265" if codec == "hevc" else codec
    for packet in container.demux(stream):
        if packet.pts is None or packet.time_base is None:
            continue
        time_ns = start_ns + round(packet.pts * Fraction(packet.time_base) * 10**9)
        if time_ns <= last_ns:
            raise RecordingError(video, "its pictures are out of order", "convert it with ffmpeg -bf 0")
        for part in annex_b.filter(packet):
            author.write_video(VIDEO_TOPIC, time_ns, _FRAME_ID, bytes(part), name)
        n_images, last_ns = n_images + 1, time_ns
    return n_images
