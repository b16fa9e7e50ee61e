"""Video to pixels: H.264, H.265, VP8, VP9 and AV1, one picture per message, by PyAV (the extra `video`).

A picture of a video depends on those before it, back to a key frame, and with B-frames it comes out of the
decoder only after later packets have gone in. So pictures are requested when their packets go in, and fetched
when they are known. Packets are kept from one key frame to the next, and decoded only when a picture among
them is wanted.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, cast

import numpy as np

from inspect_pipeline.images.codec import codec_of, key_of, to_annex_b
from inspect_pipeline.images.h264 import GapFinder
from inspect_pipeline.messages.image import ImageError

if TYPE_CHECKING:
    import av

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.images.codec import KeyKind
    from inspect_pipeline.messages.image import ImageMessage

_MAX_DELAY = 17  # packets: H.264 and H.265 put no picture further out of order than 16
_MAX_WAITING_BYTES = 64 << 20  # of messages that wait for one that is wanted

_MAX_PIXELS = 64 << 20  # twice those of 8K video; a stream that claims more is damage or an attack
_DECODERS = {"av1": "libdav1d"}  # FFmpeg's, of codecs that have another name than their decoder
_NO_PICTURE = "the picture of the video cannot be decoded"


def can_decode() -> bool:
    """Whether PyAV is installed."""
    return find_spec("av") is not None


class VideoPicture:
    """A picture that came out of a video, or the reason why there is none; any thread may convert it."""

    def __init__(self, found: av.VideoFrame | str) -> None:
        self._found = found

    def to_rgb(self) -> ImageArray:
        """Return uint8 (height, width, 3). Raises ImageError when there is no picture."""
        if isinstance(self._found, str):
            raise ImageError(self._found)
        return np.ascontiguousarray(self._found.to_ndarray(format="rgb24"), np.uint8)


class VideoDecoder:
    """Decodes the messages of one channel, which must all be added in order, numbered from 0."""

    def __init__(self) -> None:
        self._decoder: av.VideoCodecContext | None = None
        self._codec: str | None = None
        self._gaps = GapFinder()
        self._has_begun = False  # whether there was a key frame
        self._is_broken = False  # whether a packet is missing since the last key frame
        self._waiting: list[tuple[int, bytes]] = []  # not decoded, since the last key frames
        self._waiting_bytes = 0
        self._last_key = 0  # index of the last key frame in `_waiting`
        self._wanted: set[int] = set()  # numbers of pictures that did not come out yet
        self._settled: dict[int, av.VideoFrame | str] = {}  # by number: the picture, or why there is none

    def add(self, number: int, message: ImageMessage, *, is_wanted: bool) -> None:
        """Take the next message; if its picture is wanted it must be fetched with `take`."""
        data = bytes(message.data)
        self._codec = codec_of(data, message.encoding, self._codec)
        if self._codec in {"h264", "hevc"}:
            data = to_annex_b(data)
        key = key_of(data, self._codec) if self._codec else "none"
        self._is_broken |= self._codec == "h264" and self._gaps.is_after_gap(data)
        if key != "none":
            self._has_begun, self._is_broken = True, False
            self._forget_before(key)
        if is_wanted and self._codec is None:
            self._settled[number] = f"the video codec {message.encoding!r} is not known"
        elif is_wanted and not self._has_begun:
            self._settled[number] = "the video has had no key frame yet"
        elif is_wanted and self._is_broken:
            self._settled[number] = "a packet of the video before it is missing"
        elif is_wanted:
            self._wanted.add(number)
        if self._has_begun:
            self._waiting.append((number, data))
            self._waiting_bytes += len(data)
        if self._wanted or self._waiting_bytes > _MAX_WAITING_BYTES:
            self._decode_waiting()

    def is_settled(self, number: int) -> bool:
        """Whether a wanted picture, or the reason why there is none, is known."""
        return number in self._settled

    def take(self, number: int) -> VideoPicture:
        """Return a wanted picture."""
        self._wanted.discard(number)
        return VideoPicture(self._settled.pop(number, _NO_PICTURE))

    def finish(self) -> None:
        """Settle all wanted pictures; nothing can be added afterwards."""
        if self._decoder is not None:
            self._keep(self._decode(None), 0)
        self._settled |= dict.fromkeys(self._wanted, _NO_PICTURE)
        self._wanted.clear()

    def _forget_before(self, key: KeyKind) -> None:
        """At a key frame, drop what no later picture depends on.

        The pictures that follow an open one in decoding order may depend on those since the key frame before.
        """
        if self._wanted or not self._waiting:
            return
        first = len(self._waiting) if key == "closed" else self._last_key
        if first and self._decoder is not None:
            self._decoder.flush_buffers()
        self._waiting = self._waiting[first:]
        self._waiting_bytes = sum(len(data) for _, data in self._waiting)
        self._last_key = len(self._waiting)

    def _decode_waiting(self) -> None:
        for number, data in self._waiting:
            self._keep(self._decode(data, number), number)
        self._waiting, self._waiting_bytes, self._last_key = [], 0, 0

    def _decode(self, data: bytes | None, number: int = 0) -> list[av.VideoFrame]:
        """Return the pictures that come out when a packet goes in, or at the end with None."""
        import av  # noqa: PLC0415 - an extra, and slow to import

        name = _DECODERS.get(self._codec or "", self._codec or "")
        try:
            if self._decoder is None or self._decoder.name != name:
                self._decoder = _new_decoder(name)
            if data is None:
                return self._decoder.decode(None)
            packet = av.Packet(data)
            packet.pts = number
            return self._decoder.decode(packet)
        except av.codec.codec.UnknownCodecError:
            why = f"PyAV has no decoder {name}; install av from PyPI, which has it"
            self._settled |= dict.fromkeys(self._wanted, why)
            self._wanted.clear()
            return []
        except av.FFmpegError:  # the packets after it may still be decoded
            return []

    def _keep(self, pictures: list[av.VideoFrame], number: int) -> None:
        """Keep the pictures that are wanted; give up those that should have come out before `number`."""
        for picture in pictures:
            if picture.pts in self._wanted:
                self._settled[picture.pts] = picture
        late = (wanted for wanted in self._wanted if number - wanted > _MAX_DELAY)
        self._settled |= dict.fromkeys(late, _NO_PICTURE)
        self._wanted -= self._settled.keys()


def _new_decoder(name: str) -> av.VideoCodecContext:
    import av  # noqa: PLC0415

    decoder = cast("av.VideoCodecContext", av.CodecContext.create(name, "r"))
    decoder.options = {"max_pixels": str(_MAX_PIXELS)}
    decoder.thread_count = 1  # threads that take a frame each return pictures late
    return decoder
