"""Proposals: lines before they are scored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from lsnet.arrays import Floats
    from lsnet.lines.polylines import Polylines

    Rate = Callable[["Proposals"], Floats]


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """C polylines of one image with what their segments say about them.

    Attributes:
        polylines: Their points, pixels.
        prior: (C,) score by the odds of the segments and the length alone.
        mean_score: (C,) mean score of the segments.
        support: (C,) segments over each stretch.
        extent_px: (C,) length.
        spread_px: (C,) of the segments about the polyline.
        quantiles: (C, 3) 0.1, 0.5 and 0.9 quantile of the scores of the segments.
        image_size: (height, width) in pixels.
        enlargement: Factor by which the image was enlarged before detection.
    """

    polylines: Polylines
    prior: Floats
    mean_score: Floats
    support: Floats
    extent_px: Floats
    spread_px: Floats
    quantiles: Floats
    image_size: tuple[int, int]
    enlargement: float

    def __len__(self) -> int:
        return len(self.polylines)

    @property
    def ends(self) -> Floats:
        """(C, 4) ends of the polylines: x1, y1, x2, y2."""
        lines = self.polylines
        return np.concatenate([lines.points[lines.first[:-1]], lines.points[lines.first[1:] - 1]], axis=1)
