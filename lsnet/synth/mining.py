"""Hard negatives from photographs without lines: the squares in which a detector says there are some."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from lsnet.errors import LSNetError
from lsnet.files import make_folder
from lsnet.synth.backgrounds import BackgroundFolder, load_rgb

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lsnet.detector import Detector
    from lsnet.segments import Segments

SQUARE_PX = 512  # of the network's image; a training image is cut out of it


def mine(detector: Detector, backgrounds: Sequence[str], output: Path) -> Iterator[int]:
    """Write the squares of one photograph after the other as PNG; how many each of them gave.

    backgrounds: DIR or DIR:FIRST. Raises LSNetError for folders without images or one that cannot be
    written.
    """
    make_folder(output)
    for text in backgrounds:
        folder = BackgroundFolder.parse(text)
        for file in folder.files():
            photo = load_rgb(file)
            squares = hard_squares(photo, detector)
            for i, square in enumerate(squares):
                name = output / f"{folder.path.name}_{file.stem}_{i:03d}.png"
                if not cv2.imwrite(str(name), square[..., ::-1]):
                    raise LSNetError(f"{name}: cannot be written; name another folder")
            yield len(squares)


def count_photos(backgrounds: Sequence[str]) -> int:
    """How many photographs `mine` looks at. Raises LSNetError for folders without images."""
    return sum(len(BackgroundFolder.parse(text).files()) for text in backgrounds)


def hard_squares(photo: NDArray[np.uint8], detector: Detector) -> list[NDArray[np.uint8]]:
    """Squares about the segments told, from the surest on; each segment lies in one of them."""
    height, width = photo.shape[:2]
    side = min(round(SQUARE_PX / detector.scale_of(photo)), height, width)
    told = detector.detect([photo])[0].segments
    return [photo[y : y + side, x : x + side] for x, y in _corners(told, side)]


def _corners(segments: Segments, side: int) -> Iterator[tuple[int, int]]:
    height, width = segments.image_size
    middles = (segments.endpoints[:, :2] + segments.endpoints[:, 2:]) / 2
    middles = middles[(-segments.scores).argsort()]
    while len(middles):
        x, y = (
            int(min(max(at - side / 2, 0), most - side))
            for at, most in zip(middles[0], (width, height), strict=True)
        )
        yield x, y
        is_inside = np.all((middles >= (x, y)) & (middles <= (x + side, y + side)), axis=1)
        middles = middles[1:][~is_inside[1:]]
