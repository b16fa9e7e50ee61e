"""Video to pixels: H.264, H.265, VP9 and AV1, one picture per message, by PyAV (the extra `video`).

A picture of a video stands on those before it, back to a key frame. Messages are therefore kept from one
key frame to the next and decoded only when a picture among them is wanted.
"""

from __future__ import annotations

import re
from importlib.util import find_spec
from typing import TYPE_CHECKING, cast

import numpy as np

from inspect_pipeline.image_messages import ImageError

if TYPE_CHECKING:
    import av
    from numpy.typing import NDArray

    from inspect_pipeline.image_messages import ImageMessage

_NAL_HEAD = re.compile(rb"\x00\x00\x01([\s\S])")  # the first byte behind a start code of Annex B
_H264_SEQUENCE, _H264_KEY = 7, 5
_H265_KEYS = range(16, 24)  # IRAP
_AV1_SEQUENCE = 1
_MAX_WAITING_BYTES = 256 << 20  # a stream without key frames is given up before it fills the memory


def can_decode() -> bool:
    """Whether PyAV is installed."""
    return find_spec("av") is not None


class VideoDecoder:
    """Decodes the messages of one channel, which must all pass through it in order."""

    def __init__(self) -> None:
        self._codec: av.VideoCodecContext | None = None
        self._codec_name = ""
        self._waiting: list[bytes] = []  # since the last key frame or decoded picture
        self._waiting_bytes = 0
        self._is_started = False  # whether what waits follows a key frame, with nothing missing

    def pass_over(self, message: ImageMessage) -> None:
        """Take note of a message whose picture is not wanted."""
        data = bytes(message.data)
        self._codec_name = _codec_name(message.encoding)
        if is_key_frame(data, self._codec_name):
            self._waiting.clear()
            self._waiting_bytes = 0
            self._is_started = True
        self._waiting.append(data)
        self._waiting_bytes += len(data)
        if self._waiting_bytes > _MAX_WAITING_BYTES or not self._is_started:
            self._waiting.clear()
            self._waiting_bytes = 0
            self._is_started = False

    def decode(self, message: ImageMessage) -> NDArray[np.uint8]:
        """The picture of a message: uint8 (height, width, 3) RGB. Raises ImageError when there is none."""
        self.pass_over(message)
        if not self._is_started:
            raise ImageError("the video has had no key frame yet")
        waiting, self._waiting, self._waiting_bytes = self._waiting, [], 0
        frame = None
        for data in waiting:
            frame = self._decode_packet(data)
        if frame is None:
            raise ImageError("the picture of the video cannot be decoded")
        return np.ascontiguousarray(frame.to_ndarray(format="rgb24"), np.uint8)

    def _decode_packet(self, data: bytes) -> av.VideoFrame | None:
        """The picture of a packet; None when it cannot be decoded, which leaves those behind it a chance."""
        import av  # noqa: PLC0415 - an extra, and slow to import

        if self._codec is None or self._codec.name != self._codec_name:
            self._codec = _new_codec(self._codec_name)
        try:
            frames = self._codec.decode(av.Packet(data))
        except av.FFmpegError:
            return None
        return frames[-1] if frames else None


def _new_codec(name: str) -> av.VideoCodecContext:
    import av  # noqa: PLC0415
    from av.codec.context import Flags  # noqa: PLC0415

    codec = cast("av.VideoCodecContext", av.CodecContext.create(name, "r"))
    codec.thread_count = 1  # threads that take a frame each give pictures late
    codec.flags |= Flags.low_delay
    return codec


def _codec_name(encoding: str) -> str:
    """FFmpeg's name of a codec by what the message calls it; H.264 when it does not say."""
    known = {"h265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "libdav1d"}
    return next((name for word, name in known.items() if word in encoding.lower()), "h264")


def is_key_frame(data: bytes, codec_name: str) -> bool:
    """Whether decoding can begin at a packet."""
    if codec_name == "vp9":
        return _is_vp9_key_frame(data)
    if codec_name == "libdav1d":
        return _AV1_SEQUENCE in _av1_units(data)
    heads = (match[1][0] for match in _NAL_HEAD.finditer(data))
    if codec_name == "hevc":
        return any(head >> 1 & 0x3F in _H265_KEYS for head in heads)
    return any(head & 0x1F in {_H264_SEQUENCE, _H264_KEY} for head in heads)


def _is_vp9_key_frame(data: bytes) -> bool:
    """By the uncompressed header: marker (2 bits), profile (2, or 3 of profile 3), repeats, is no key."""
    head = data[0] if data else 0
    n_before = 5 if head >> 4 & 3 == 3 else 4
    return head >> 6 == 2 and not head >> (7 - n_before) & 1 and not head >> (6 - n_before) & 1


def _av1_units(data: bytes) -> set[int]:
    """The types of the open bitstream units of a packet."""
    types, at = set(), 0
    while at < len(data):
        head = data[at]
        types.add(head >> 3 & 15)
        at += 2 if head & 4 else 1
        if not head & 2:
            break
        size = shift = 0
        while at < len(data):
            byte, at = data[at], at + 1
            size |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                break
        at += size
    return types
