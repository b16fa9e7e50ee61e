"""Make a recording of a video (H.264 or H.265, extra `video`) and of the subtitles beside it."""

from __future__ import annotations

from contextlib import closing
from datetime import UTC, datetime, tzinfo
from fractions import Fraction
from itertools import islice, pairwise
from typing import TYPE_CHECKING, cast

from inspect_pipeline.convert.dji_srt import SubtitleBlock, parse_srt
from inspect_pipeline.convert.lenses import focal_px_of_film
from inspect_pipeline.convert.messages import CAMERA_FRAME, PackResult, write_lens, write_pose
from inspect_pipeline.convert.times import to_ns
from inspect_pipeline.errors import RecordingError
from inspect_pipeline.recording.writer import new_recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import av

    from inspect_pipeline.recording.writer import RecordingAuthor

_VIDEO_TOPIC, _LENS_TOPIC = "/camera/video", "/camera/calibration"
_ANNEX_B = {"h264": "h264_mp4toannexb", "hevc": "hevc_mp4toannexb"}
_ENCODER, _ENCODER_OPTIONS = "libx264", {"bf": "0", "crf": "17", "preset": "veryfast", "tune": "zerolatency"}
_KEY_EVERY = 30  # pictures
_MAX_PROBED = 1000  # packets, to see whether there are B-frames


def pack_video(
    video: Path, target: Path, zone: tzinfo | None = None, start: datetime | None = None
) -> PackResult:
    """Make a recording of a video as it is, with the poses of the subtitles beside it.

    The video starts at `start`, else when the subtitles say, else when its container says. Clocks without a
    time zone are in `zone`, else UTC. A video with B-frames, which players of recordings do not take, is
    encoded again without them.

    Raises:
        RecordingError: it is no such video, has no time, or PyAV is missing.
        OSError: the target cannot be written.
    """
    try:
        import av  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise RecordingError(
            video, "videos need PyAV", "install lsnet-pipe with the extra 'video'"
        ) from error
    zone = zone or UTC
    blocks, warnings = _read_subtitles(video)
    try:
        with closing(av.open(str(video))) as container:
            start_ns = _start_ns(video, blocks, container.metadata, zone, start)
            has_b_frames = _has_b_frames(video, container)
            if has_b_frames:
                warnings.append(f"{video} has B-frames, it is encoded again without them")
            with new_recording(target) as author:
                stream = container.streams.video[0]
                for block in blocks:
                    _write_block(author, start_ns, block, (stream.height, stream.width))
                pictures = _encode_again(container) if has_b_frames else _copy_packets(container)
                n_images = _write_pictures(author, video, start_ns, pictures)
    except av.FFmpegError as error:
        raise RecordingError(video, "it is not a video that can be read", "name an MP4 file") from error
    counts = {
        "images": n_images,
        "positions": sum(block.position is not None for block in blocks),
        "attitudes": sum(block.gimbal is not None for block in blocks),
    }
    return PackResult(counts, tuple(warnings))


def _write_pictures(
    author: RecordingAuthor, video: Path, start_ns: int, pictures: Iterator[tuple[int, bytes, str]]
) -> int:
    """Write pictures, whose times are since the start, and return their number."""
    n_images, last_ns = 0, -1
    for since_start_ns, data, codec in pictures:
        if since_start_ns <= last_ns:
            raise RecordingError(video, "its pictures are out of order", "convert it with ffmpeg -bf 0")
        author.write_video(_VIDEO_TOPIC, start_ns + since_start_ns, CAMERA_FRAME, data, codec)
        n_images, last_ns = n_images + 1, since_start_ns
    return n_images


def _write_block(
    author: RecordingAuthor, start_ns: int, block: SubtitleBlock, image_size: tuple[int, int]
) -> None:
    time_ns = start_ns + block.offset_ns
    write_pose(author, time_ns, block.position, block.gimbal, block.height_m)
    if block.focal_35mm and min(image_size) > 0:
        focal_px = focal_px_of_film(block.focal_35mm, image_size)
        write_lens(author, _LENS_TOPIC, time_ns, image_size, focal_px)


def _read_subtitles(video: Path) -> tuple[Sequence[SubtitleBlock], list[str]]:
    """Return the blocks of the SRT file beside a video, and a warning when they have no positions."""
    beside = [path for path in video.parent.glob("*") if path.stem == video.stem]
    path = next((path for path in beside if path.suffix.lower() == ".srt"), None)
    if path is None:
        return [], []
    blocks, problem = parse_srt(path.read_text("utf-8", errors="replace"))
    return blocks, [f"{path} gives no positions: {problem}"] if problem else []


def _start_ns(
    video: Path,
    blocks: Sequence[SubtitleBlock],
    metadata: dict[str, str],
    zone: tzinfo,
    start: datetime | None,
) -> int:
    if start:
        return to_ns(start, zone)
    for block in blocks:
        if block.clock:
            return to_ns(block.clock, zone) - block.offset_ns
    try:
        return to_ns(datetime.fromisoformat(metadata.get("creation_time", "")), zone)
    except ValueError as error:
        raise RecordingError(
            video, "it does not say when it was taken", "put its SRT file beside it, or name the time"
        ) from error


def _has_b_frames(video: Path, container: av.container.InputContainer) -> bool:
    """Whether pictures are stored in another order than they are shown; rewinds the container."""
    stream = next(iter(container.streams.video), None)
    if stream is None or stream.codec_context.name not in _ANNEX_B:
        raise RecordingError(video, "it holds neither H.264 nor H.265", "convert it with ffmpeg")
    packets = islice(container.demux(stream), _MAX_PROBED)
    times = [packet.pts for packet in packets if packet.pts is not None]
    container.seek(0)
    return any(after < before for before, after in pairwise(times))


def _to_ns(pts: int, time_base: Fraction) -> int:
    return round(pts * Fraction(time_base) * 10**9)


def _copy_packets(container: av.container.InputContainer) -> Iterator[tuple[int, bytes, str]]:
    """Yield the time since the start, data in Annex B and codec of each picture."""
    from av.bitstream import BitStreamFilterContext  # noqa: PLC0415

    stream = container.streams.video[0]
    codec = stream.codec_context.name
    annex_b = BitStreamFilterContext(_ANNEX_B[codec], stream)
    for packet in container.demux(stream):
        if packet.pts is not None and packet.time_base is not None:
            time_ns = _to_ns(packet.pts, packet.time_base)
            data = b"".join(bytes(part) for part in annex_b.filter(packet))
            yield time_ns, data, "h265" if codec == "hevc" else codec


def _encode_again(container: av.container.InputContainer) -> Iterator[tuple[int, bytes, str]]:
    """Yield the same of H.264 without B-frames, in the order in which pictures are shown."""
    import av  # noqa: PLC0415

    stream = container.streams.video[0]
    encoder = cast("av.VideoCodecContext", av.CodecContext.create(_ENCODER, "w"))
    encoder.width, encoder.height, encoder.pix_fmt = stream.width, stream.height, "yuv420p"
    encoder.time_base = time_base = stream.time_base or Fraction(1, 90_000)
    encoder.options, encoder.gop_size = _ENCODER_OPTIONS, _KEY_EVERY
    for picture in container.decode(stream):
        if picture.pts is None:
            continue
        picture.pict_type = av.video.frame.PictureType.NONE  # the encoder chooses key frames
        pts = picture.pts
        for packet in encoder.encode(picture.reformat(format="yuv420p")):
            yield _to_ns(pts, time_base), bytes(packet), "h264"
