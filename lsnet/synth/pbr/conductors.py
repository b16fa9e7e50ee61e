"""Stranded conductors: helical strands in layers of opposite twist, along a hanging cable.

World coordinates in metres, z up. The visible stretch is short compared with the span, so it is a parabola.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import Points


LAYERS = (1, 6, 12)  # strands of an ACSR conductor, the steel core first
LAY_DIAMETERS = 12.0  # length of a turn, in outer diameters of its layer
POINTS_PER_TURN = 10


@dataclass(frozen=True, slots=True)
class Hang:
    """A stretch of a hanging cable.

    Attributes:
        middle: Its middle, x, y, z in m.
        along: Unit vector along it there.
        curvature: Second derivative of its height, 1/m.
    """

    middle: tuple[float, float, float]
    along: tuple[float, float, float]
    curvature: float

    def points(self, s: Points) -> Points:
        """Return the (K, 3) centreline at positions s (K,) in metres from the middle."""
        line: Points = np.array(self.middle) + s[:, None] * np.array(self.along)
        line[:, 2] += self.curvature * s**2 / 2
        return line

    def frame(self, s: Points) -> tuple[Points, Points]:
        """Return two unit vectors (K, 3) across the cable at s, perpendicular to it and to each other."""
        tangent = np.array(self.along) + np.stack([0 * s, 0 * s, self.curvature * s], axis=1)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        side: Points = np.cross(tangent, [0.0, 0.0, 1.0])
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        return side, np.cross(side, tangent)


def strands(hang: Hang, radius_m: float, half_length_m: float) -> tuple[list[Points], float]:
    """Return the (K, 3) centrelines of the strands of a conductor, and the radius of a strand.

    The strands of a layer lie side by side around the inner one, so a conductor with two layers around the
    core is five strands wide. Layers twist in opposite directions.
    """
    strand_m = radius_m / (2 * len(LAYERS) - 1)
    found = []
    for layer, count in enumerate(LAYERS):
        from_axis = 2 * strand_m * layer
        turn_m = LAY_DIAMETERS * 2 * (from_axis + strand_m)
        n_points = max(8, round(2 * half_length_m / turn_m * POINTS_PER_TURN)) if layer else 24
        s = np.linspace(-half_length_m, half_length_m, n_points)
        centre, (side, up) = hang.points(s), hang.frame(s)
        for k in range(count):
            angle = 2 * np.pi * (k / count + (-1) ** layer * s / turn_m)
            found.append(centre + from_axis * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up))
    return found, strand_m


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera that looks at a point; square images of `size` pixels, `fov_deg` from side to side."""

    origin: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_deg: float
    size: int

    @property
    def focal_px(self) -> float:
        """Focal length in pixels."""
        return float(self.size / 2 / np.tan(np.radians(self.fov_deg) / 2))

    def project(self, points: Points) -> Points:
        """Project points (K, 3) to pixels x, y (K, 2); points behind the camera are dropped."""
        forward = np.array(self.target) - np.array(self.origin)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        relative = points - np.array(self.origin)
        depth = relative @ forward
        relative, depth = relative[depth > 1e-3], depth[depth > 1e-3]
        x, y = relative @ right / depth, relative @ -np.cross(right, forward) / depth
        return self.size / 2 + self.focal_px * np.stack([x, y], axis=1)
