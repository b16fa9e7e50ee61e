"""Write pictures to a video file (H.264 in MP4); needs the extra `video`."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, cast

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import av

    from inspect_pipeline.arrays import ImageArray

_CODEC, _OPTIONS = "libx264", {"crf": "20", "preset": "veryfast"}
_TIME_BASE = Fraction(1, 1000)  # s
_SHORTEST_MS = 1


def write_film(path: Path, pictures: Iterable[tuple[int, ImageArray]]) -> int:
    """Write pictures at their times, whole or not at all, and return how many there are.

    Args:
        path: the MP4 file.
        pictures: time in ns, increasing, and RGB image; all of the size of the first. An odd last row or
            column is left out, as the format has none.

    Raises:
        OutputError: PyAV is not installed, or the file cannot be written.
    """
    try:
        import av  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise OutputError(path, "videos need PyAV", "install lsnet-pipe with the extra 'video'") from error
    try:
        with appearing(path) as part, av.open(str(part), "w", format="mp4") as container:
            return _encode(container, pictures)
    except (OSError, av.FFmpegError) as error:
        raise OutputError(path, f"cannot be written ({error})", "name another file") from error


def _encode(container: av.container.OutputContainer, pictures: Iterable[tuple[int, ImageArray]]) -> int:
    import av  # noqa: PLC0415

    stream, first_ns, last_ms, n_pictures = None, 0, -1, 0
    for time_ns, image in pictures:
        if stream is None:
            stream = cast("av.VideoStream", container.add_stream(_CODEC, rate=30, options=_OPTIONS))
            height, width = (n - n % 2 for n in image.shape[:2])
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            stream.time_base = stream.codec_context.time_base = _TIME_BASE
            first_ns = time_ns
        picture = av.VideoFrame.from_ndarray(image[: stream.height, : stream.width], format="rgb24")
        picture.pts = last_ms = max((time_ns - first_ns) // 1_000_000, last_ms + _SHORTEST_MS)
        picture.time_base = _TIME_BASE
        container.mux(stream.encode(picture))
        n_pictures += 1
    if stream is not None:
        container.mux(stream.encode(None))
    return n_pictures
