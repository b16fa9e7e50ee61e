"""Where a line goes: straight on or round a corner, over flat ground or hills.

In m: x along the line before its corner, y left, z up from the ground at x = 0. `along` is the horizontal
distance along the line, which is x before the corner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from inspect_pipeline.arrays import Floats

_HILL_M = 220.0  # from one valley to the next, along x
_CHAMFER_M = 8.0  # before and after a corner, within which a drone turns


@dataclass(frozen=True, slots=True)
class Route:
    """A line that turns left by `corner_rad` at `corner_m`, over hills `hills_m` high across x."""

    corner_m: float = 0.0
    corner_rad: float = 0.0
    hills_m: float = 0.0

    def places(self, along: ArrayLike) -> Floats:
        """Return the x, y (..., 2) of distances along the line (...)."""
        at = np.asarray(along, np.float64)
        beyond = np.maximum(at - self.corner_m, 0.0)
        turned = np.array([np.cos(self.corner_rad) - 1, np.sin(self.corner_rad)])
        places: Floats = beyond[..., np.newaxis] * turned
        places[..., 0] += at
        return places

    def along(self, places: Floats) -> Floats:
        """Return how far along the line (...) the places x, y (..., 2) beside it are."""
        ahead = np.array([np.cos(self.corner_rad), np.sin(self.corner_rad)])
        beyond: Floats = np.maximum((places - (self.corner_m, 0.0)) @ ahead, 0.0)
        return np.minimum(places[..., 0], self.corner_m) + beyond

    def headings_rad(self, along: ArrayLike) -> Floats:
        """Return the directions (...) of the line, turned left from x, at distances along it (...)."""
        headings: Floats = np.where(np.asarray(along) > self.corner_m, self.corner_rad, 0.0)
        return headings

    def ground_m(self, x: ArrayLike) -> Floats:
        """Return the heights (...) of the ground at x (...), wherever in y."""
        heights: Floats = self.hills_m / 2 * (1 - np.cos(2 * np.pi * np.asarray(x, np.float64) / _HILL_M))
        return heights

    def arm(self, along: float) -> Floats:
        """Return (2,) how far left a conductor is attached for each metre from the axis.

        At the corner that is along the bisector, and longer, so that spans stay as wide as they are.
        """
        half_rad = self.corner_rad / 2 if along == self.corner_m else 0.0
        heading_rad = float(self.headings_rad(along)) + half_rad
        arm: Floats = np.array([-np.sin(heading_rad), np.cos(heading_rad)]) / np.cos(half_rad)
        return arm

    def beside(self, along: float, left_m: float) -> tuple[Floats, float]:
        """Return x, y (2,) and the direction in rad of a path `left_m` left of the line, its corner cut."""
        before, after = self.places((along - _CHAMFER_M, along + _CHAMFER_M))
        heading_rad = float(np.arctan2(*(after - before)[::-1]))
        left = np.array([-np.sin(heading_rad), np.cos(heading_rad)])
        return (before + after) / 2 + left_m * left, heading_rad
