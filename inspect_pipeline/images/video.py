"""Video to pixels: H.264, H.265, VP9 and AV1, one picture per message, by PyAV (the extra `video`).

A picture of a video stands on those before it, back to a key frame, and with B-frames it comes out of the
decoder only after those behind it have gone in. So pictures are asked for when they go in, and fetched when
they are known. Messages are kept from one key frame to the next, and decoded only when a picture among them
is wanted.
"""

from __future__ import annotations

import re
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from inspect_pipeline.images.h264 import GapFinder
from inspect_pipeline.messages.image import ImageError

if TYPE_CHECKING:
    import av

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.messages.image import ImageMessage

_NAL_HEAD = re.compile(rb"\x00\x00\x01([\s\S])")  # the first byte behind a start code of Annex B
_START_CODE = b"\0\0\0\1"
_H264_SEQUENCE, _H264_KEY = 7, 5
_H265_KEYS, _H265_CLOSED_KEYS = range(16, 24), range(16, 21)  # IRAP; of them BLA and IDR
_AV1_SEQUENCE, _MAX_AV1_SIZE_BYTES = 1, 8
_MAX_DELAY = 17  # packets: H.264 and H.265 put no picture further out of order than 16
_MAX_WAITING_BYTES = 64 << 20  # of messages that wait for one that is wanted

_MAX_PIXELS = 64 << 20  # twice those of 8K video; a stream that claims more is damage or an attack
_NO_PICTURE = "the picture of the video cannot be decoded"

_Key = Literal["none", "open", "closed"]


def can_decode() -> bool:
    """Whether PyAV is installed."""
    return find_spec("av") is not None


class VideoDecoder:
    """Decodes the messages of one channel, which must all be added to it in order, numbered from 0."""

    def __init__(self) -> None:
        self._codec: av.VideoCodecContext | None = None
        self._codec_name = ""
        self._gaps = GapFinder()
        self._is_started = False  # whether there was a key frame
        self._is_torn = False  # whether a piece is missing since the last one
        self._waiting: list[tuple[int, bytes]] = []  # not decoded, since the last key frames
        self._waiting_bytes = 0
        self._last_key = 0  # where the last key frame is among those
        self._wanted: set[int] = set()  # numbers of pictures that did not come out yet
        self._settled: dict[int, av.VideoFrame | str] = {}  # by number: the picture, or why there is none

    def add(self, number: int, message: ImageMessage, *, is_wanted: bool) -> None:
        """Take the next message; when its picture is wanted it is to be fetched by `take`."""
        self._codec_name = _codec_name(message.encoding)
        data = (
            to_annex_b(bytes(message.data)) if self._codec_name in {"h264", "hevc"} else bytes(message.data)
        )
        key = key_of(data, self._codec_name)
        self._is_torn |= self._codec_name == "h264" and self._gaps.is_after_gap(data)
        if key != "none":
            self._is_started, self._is_torn = True, False
            self._forget_before(key)
        if is_wanted and not self._is_started:
            self._settled[number] = "the video has had no key frame yet"
        elif is_wanted and self._is_torn:
            self._settled[number] = "a piece of the video before it is missing"
        elif is_wanted:
            self._wanted.add(number)
        if self._is_started:
            self._waiting.append((number, data))
            self._waiting_bytes += len(data)
        if self._wanted or self._waiting_bytes > _MAX_WAITING_BYTES:
            self._decode_waiting()

    def is_settled(self, number: int) -> bool:
        """Whether it is known of a wanted picture what it is, or that there is none."""
        return number in self._settled

    def take(self, number: int) -> ImageArray:
        """A wanted picture: uint8 (height, width, 3) RGB. Raises ImageError when there is none."""
        self._wanted.discard(number)
        found = self._settled.pop(number, _NO_PICTURE)
        if isinstance(found, str):
            raise ImageError(found)
        return np.ascontiguousarray(found.to_ndarray(format="rgb24"), np.uint8)

    def finish(self) -> None:
        """Settle what is wanted; nothing can be added afterwards."""
        if self._codec is not None:
            self._keep(self._decode(None), 0)
        self._settled |= dict.fromkeys(self._wanted, _NO_PICTURE)
        self._wanted.clear()

    def _forget_before(self, key: _Key) -> None:
        """At a key frame, drop what no later picture stands on.

        The pictures behind an open one, in the order of decoding, may stand on those of one key frame before.
        """
        if self._wanted or not self._waiting:
            return
        first = len(self._waiting) if key == "closed" else self._last_key
        if first and self._codec is not None:
            self._codec.flush_buffers()
        self._waiting = self._waiting[first:]
        self._waiting_bytes = sum(len(data) for _, data in self._waiting)
        self._last_key = len(self._waiting)

    def _decode_waiting(self) -> None:
        for number, data in self._waiting:
            self._keep(self._decode(data, number), number)
        self._waiting, self._waiting_bytes, self._last_key = [], 0, 0

    def _decode(self, data: bytes | None, number: int = 0) -> list[av.VideoFrame]:
        """The pictures that come out when a packet goes in, or at the end with None."""
        import av  # noqa: PLC0415 - an extra, and slow to import

        try:
            if self._codec is None or self._codec.name != self._codec_name:
                self._codec = _new_codec(self._codec_name)
            if data is None:
                return self._codec.decode(None)
            packet = av.Packet(data)
            packet.pts = number
            return self._codec.decode(packet)
        except av.codec.codec.UnknownCodecError:
            why = f"PyAV has no decoder {self._codec_name}; install av from PyPI, which has it"
            self._settled |= dict.fromkeys(self._wanted, why)
            self._wanted.clear()
            return []
        except av.FFmpegError:  # those behind it still have a chance
            return []

    def _keep(self, pictures: list[av.VideoFrame], number: int) -> None:
        """Keep the pictures that are wanted; give up those that packet `number` should have driven out."""
        for picture in pictures:
            if picture.pts in self._wanted:
                self._settled[picture.pts] = picture
        late = (wanted for wanted in self._wanted if number - wanted > _MAX_DELAY)
        self._settled |= dict.fromkeys(late, _NO_PICTURE)
        self._wanted -= self._settled.keys()


def _new_codec(name: str) -> av.VideoCodecContext:
    import av  # noqa: PLC0415

    codec = cast("av.VideoCodecContext", av.CodecContext.create(name, "r"))
    codec.options = {"max_pixels": str(_MAX_PIXELS)}
    codec.thread_count = 1  # threads that take a frame each give pictures late
    return codec


def _codec_name(encoding: str) -> str:
    """FFmpeg's name of a codec by what the message calls it; H.264 when it does not say."""
    known = {"h265": "hevc", "hevc": "hevc", "vp9": "vp9", "av1": "libdav1d"}
    return next((name for word, name in known.items() if word in encoding.lower()), "h264")


def to_annex_b(data: bytes) -> bytes:
    """A packet with start codes before its units, given one with those or with lengths of four bytes.

    A length of 256 to 511 begins like a start code, so lengths that lead exactly to the end are believed.
    """
    if data.startswith(_START_CODE):
        return data
    units, at = [], 0
    while at < len(data):
        length = int.from_bytes(data[at : at + 4])
        units.append(data[at + 4 : at + 4 + length])
        at += 4 + length
        if not length:
            return data
    return b"".join(_START_CODE + unit for unit in units) if at == len(data) else data


def key_of(data: bytes, codec_name: str) -> _Key:
    """Whether decoding can begin at a packet; what comes behind a closed key needs nothing before it."""
    if codec_name == "vp9":
        return "closed" if _is_vp9_key_frame(data) else "none"
    if codec_name == "libdav1d":
        return "closed" if _AV1_SEQUENCE in _av1_units(data) else "none"
    heads = [match[1][0] for match in _NAL_HEAD.finditer(data)]
    if codec_name == "hevc":
        kinds = {head >> 1 & 0x3F for head in heads}
        is_key, is_closed = kinds & set(_H265_KEYS), kinds & set(_H265_CLOSED_KEYS)
    else:
        kinds = {head & 0x1F for head in heads}
        is_key, is_closed = kinds & {_H264_SEQUENCE, _H264_KEY}, kinds & {_H264_KEY}
    return "closed" if is_closed else "open" if is_key else "none"


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
        for byte in data[at : at + _MAX_AV1_SIZE_BYTES]:
            size |= (byte & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if byte < 0x80:
                break
        at += size
    return types
