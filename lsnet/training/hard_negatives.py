"""Hard negatives from photographs without lines: squares with false alarms of a detector."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lsnet.errors import LSNetError
from lsnet.files import make_folder, write_png
from lsnet.images import load_rgb
from lsnet.synth.backgrounds import BackgroundFolder

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from lsnet.detector import Detector
    from lsnet.segments import Segments

SQUARE_PX = 512  # of the network's image; a training image is cut out of it


def mine(detector: Detector, backgrounds: Sequence[str], output: Path) -> Iterator[int]:
    """Write the squares of each photograph as PNG; yield their number per photograph.

    Args:
        detector: Reports the false alarms.
        backgrounds: Folders of photographs, DIR or DIR:FIRST.
        output: Folder to write to.

    Raises:
        LSNetError: As of `named_photos`, or the folder cannot be written.
    """
    make_folder(output)
    for name, file in named_photos(backgrounds).items():
        squares = hard_squares(load_rgb(file), detector)
        for i, square in enumerate(squares):
            write_png(output / f"{name}_{i:03d}.png", square)
        yield len(squares)


def named_photos(backgrounds: Sequence[str]) -> dict[str, Path]:
    """Return the photographs by the prefix of the names of their squares: folder and file.

    Raises:
        LSNetError: A folder has no images, or two photographs have the same prefix.
    """
    named: dict[str, Path] = {}
    for folder in map(BackgroundFolder.parse, backgrounds):
        for file in folder.files():
            name = f"{folder.path.name}_{file.stem}"
            if name in named:
                raise LSNetError(
                    f"{named[name]} and {file} would have squares of the same names; mine them separately"
                )
            named[name] = file
    return named


def hard_squares(photo: NDArray[np.uint8], detector: Detector) -> list[NDArray[np.uint8]]:
    """Cut squares around the reported segments, highest score first; each segment is in one of them."""
    height, width = photo.shape[:2]
    side = min(round(SQUARE_PX / detector.levels_of(photo)[0]), height, width)
    found = detector.detect([photo])[0].segments
    return [photo[y : y + side, x : x + side] for x, y in _corners(found, side)]


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
