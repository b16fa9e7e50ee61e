"""Decoded pixels before they are RGB, and the range of those of 16 bits.

Sensors of 10, 12 or 14 bits write containers of 16, and thermal cameras use a narrow band far above zero.
Scaled by the size of the container both come out nearly uniform. So 16-bit values are scaled by the range
that is in use in the first images of a camera, and that range is kept, so that brightness is comparable over
the flight.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from inspect_pipeline.arrays import ImageArray

if TYPE_CHECKING:
    from collections.abc import Iterable

SensorArray = NDArray[np.uint8 | np.uint16]
ToRgb = Callable[[ImageArray], ImageArray]

_MAX_SIDE_SAMPLES = 256  # of an image whose values are sampled
_USED_PERCENT = (0.1, 99.9)  # of the values; the rest may be dead or hot pixels
_DARK_VALUE = 16  # an image without greater values says nothing about the range
_MIN_BITS, _MAX_BITS = 8, 16
_BAND_SHARE, _BAND_MARGIN = 1 / 8, 2  # how narrow a band is, and its margins in multiples of its width


class Pixels(NamedTuple):
    """Decoded pixels.

    Attributes:
        values: uint8 or uint16 (height, width) or (height, width, channels).
        to_rgb: converts uint8 values to (height, width, 3) RGB; None when they are RGB.
        doubt: what is probably wrong with them, a short phrase; None when nothing is known to be.
    """

    values: SensorArray
    to_rgb: ToRgb | None = None
    doubt: str | None = None

    @property
    def is_deep(self) -> bool:
        """Whether the values have 16 bits."""
        return self.values.dtype == np.uint16

    def rgb(self, values: ValueRange) -> ImageArray:
        """Return uint8 (height, width, 3) RGB, 16-bit values scaled by their range."""
        eight_bits = values.scale(self.values) if self.is_deep else np.asarray(self.values, np.uint8)
        image = self.to_rgb(eight_bits) if self.to_rgb else eight_bits
        return np.ascontiguousarray(image, np.uint8)


class ValueRange(NamedTuple):
    """The range of 16-bit values that is scaled to 0 to 255; what lies outside is clipped."""

    low: int
    high: int  # inclusive

    def scale(self, values: SensorArray) -> ImageArray:
        """Scale uint16 values to uint8."""
        levels = (np.arange(1 << _MAX_BITS) - self.low) * 256 // (self.high - self.low + 1)
        scaled: ImageArray = np.clip(levels, 0, 255).astype(np.uint8)[values]
        return scaled


FULL_RANGE = ValueRange(0, (1 << _MAX_BITS) - 1)


def range_in_use(images: Iterable[SensorArray]) -> ValueRange:
    """Return the range of the values of some images; the full range when all are dark.

    It reaches from 0 to the top of the least number of bits that holds the values, unless they lie in a
    narrow band far above 0, as those of thermal cameras do: then it is that band with margins.
    """
    samples = [_sample(image) for image in images]
    bright = [values for values in samples if values.max(initial=0) >= _DARK_VALUE]
    if not bright:
        return FULL_RANGE
    low, high = (int(value) for value in np.percentile(np.concatenate(bright), _USED_PERCENT))
    top = 1 << min(max(high.bit_length(), _MIN_BITS), _MAX_BITS)
    width = max(high - low, 1)
    if width < top * _BAND_SHARE and low > top / 4:
        margin = max(_BAND_MARGIN * width, 64)
        return ValueRange(max(low - margin, 0), min(high + margin, (1 << _MAX_BITS) - 1))
    return ValueRange(0, top - 1)


def is_dark(image: SensorArray) -> bool:
    """Whether an image says nothing about the range of its camera."""
    return int(_sample(image).max(initial=0)) < _DARK_VALUE


def _sample(image: SensorArray) -> SensorArray:
    step_y, step_x = (max(side // _MAX_SIDE_SAMPLES, 1) for side in image.shape[:2])
    return image[::step_y, ::step_x].ravel()


def conversion(code: int) -> ToRgb:
    """Return the conversion to RGB that is a code of OpenCV."""

    def convert(values: ImageArray) -> ImageArray:
        return np.asarray(cv2.cvtColor(values, code), np.uint8)

    return convert
