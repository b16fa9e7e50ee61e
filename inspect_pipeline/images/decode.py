"""Image messages to uint8 RGB, whatever they hold."""

from __future__ import annotations

import re
from itertools import islice
from threading import Lock
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from inspect_pipeline.images.codec import codec_of
from inspect_pipeline.images.compressed import decode_compressed
from inspect_pipeline.images.pixels import FULL_RANGE, Pixels, ValueRange, is_dark, range_in_use
from inspect_pipeline.images.raw import decode_raw, is_raw_encoding
from inspect_pipeline.images.video import can_decode
from inspect_pipeline.messages.image import ImageError, ImageMessage, is_picture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.images.pixels import SensorArray

_N_RANGE_IMAGES = 8  # first images of a camera whose values decide the range of all
_DISTANCE_TOPICS = re.compile(r"depth|disparity|range_image|/tof/", re.IGNORECASE)

# What is wrong with an image is reported with its frame, not on stderr.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


class Picture(NamedTuple):
    """A decoded image: uint8 (height, width, 3) RGB, and what is probably wrong with it."""

    image: ImageArray
    doubt: str | None = None


class ImageDecoder:
    """Decodes the images of one camera, in any threads.

    Args:
        first_images: returns the first images of the camera, in order. It is called once, at the first
            image of 16-bit values: the range of theirs is scaled to 0 to 255 for all. By default the first
            image that is decoded decides.
    """

    def __init__(self, first_images: Callable[[], Iterable[ImageMessage]] = tuple) -> None:
        self._first_images = first_images
        self._range: ValueRange | None = None
        self._lock = Lock()

    def decode(self, message: ImageMessage) -> Picture:
        """Return the pixels as stored, EXIF orientation ignored. Raises ImageError."""
        pixels = _unpack(message)
        in_use = self._range_of(pixels) if pixels.is_deep else FULL_RANGE
        try:
            return Picture(pixels.rgb(in_use), pixels.doubt)
        except cv2.error as error:
            raise ImageError("the image cannot be decoded") from error

    def _range_of(self, pixels: Pixels) -> ValueRange:
        """Return the range of the camera; threads that decode its first images wait for the first of them."""
        with self._lock:
            if self._range is None:
                bright = islice(_bright_values(self._first_images()), _N_RANGE_IMAGES)
                self._range = range_in_use(list(bright) or [pixels.values])
            return self._range


def decode_file(path: Path) -> Picture:
    """Decode an image file, 16-bit values scaled by their own range. Raises ImageError, OSError."""
    return ImageDecoder().decode(ImageMessage(0, "", "", path.read_bytes()))


def refusal(message: ImageMessage, topic: str) -> str | None:
    """Return why the images of a topic, of which `message` is one, are not processed; None when they are."""
    if _is_depth(message.encoding.lower(), topic):
        return "it holds distances"
    if message.is_video:
        return _video_refusal(message)
    if message.raw is None or is_raw_encoding(message.encoding) or is_picture(message.data):
        return None
    return f"its pixel encoding {message.encoding!r} is not known"


def _is_depth(encoding: str, topic: str) -> bool:
    """Whether an image holds distances: "16UC1", or "16UC1; png compressed", on a depth topic."""
    pixels = encoding.partition(";")[0].strip()
    if "compresseddepth" in encoding or topic.endswith("/compressedDepth") or pixels == "32fc1":
        return True
    return pixels in {"16uc1", "mono16"} and bool(_DISTANCE_TOPICS.search(topic))


def _video_refusal(message: ImageMessage) -> str | None:
    if codec_of(bytes(message.data), message.encoding) is None:
        return f"its video codec {message.encoding!r} is not known"
    return None if can_decode() else "it holds video, which needs the extra 'video'"


def _unpack(message: ImageMessage) -> Pixels:
    if not message.data:
        raise ImageError("the image is empty")
    if message.is_video:
        raise ImageError("the image is a packet of a video")
    if message.raw is None or (is_picture(message.data) and not is_raw_encoding(message.encoding)):
        return decode_compressed(memoryview(message.data))
    try:
        return decode_raw(message.encoding, message.raw, np.frombuffer(message.data, np.uint8))
    except cv2.error as error:
        raise ImageError("the image cannot be decoded") from error


def _bright_values(messages: Iterable[ImageMessage]) -> Iterator[SensorArray]:
    """Iterate over the 16-bit values of those images that say something about their range."""
    for message in messages:
        try:
            pixels = _unpack(message)
        except ImageError:
            continue
        if pixels.is_deep and not is_dark(pixels.values):
            yield pixels.values
