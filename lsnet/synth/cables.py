"""Cables drawn from their centrelines: anti-aliased, shaded as cylinders, stranded if wide.

Images are float32 (H, W, 3) RGB in [0, 255] and are painted in place.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from lsnet.arrays import FloatImage, Points


@dataclass(frozen=True, slots=True)
class Arc:
    """A parabola over the chord from `start` to `end`: the image of a hanging cable.

    Attributes:
        start, end: x, y in pixels.
        sag_px: Signed greatest distance from the chord, positive to the right of the direction from start
            to end in image coordinates.
    """

    start: tuple[float, float]
    end: tuple[float, float]
    sag_px: float

    def points(self, count: int = 17) -> Points:
        """Return (count, 2) points along the arc, including its ends."""
        origin, along, across, length = self._frame()
        t = np.linspace(0, 1, count)[:, None]
        return origin + along * t * length + across * 4 * self.sag_px * t * (1 - t)

    def distance(self, height: int, width: int) -> tuple[FloatImage, FloatImage]:
        """Return (H, W) signed distances of the pixel centres from the arc, and positions along it, px.

        To first order: the offset across the chord divided by the arc's local slope.
        """
        origin, along, across, length = self._frame()
        x = np.arange(width, dtype=np.float32) + np.float32(0.5 - origin[0])
        y = (np.arange(height, dtype=np.float32) + np.float32(0.5 - origin[1]))[:, None]
        u = x * np.float32(along[0]) + y * np.float32(along[1])
        v = x * np.float32(across[0]) + y * np.float32(across[1])
        if self.sag_px == 0:
            return v, u
        k = np.float32(4 * self.sag_px / length)
        t = u / np.float32(length)
        v -= k * u * (1 - t)
        slope = k * (1 - 2 * t)
        v /= np.sqrt(1 + slope * slope)
        return v, u

    def _frame(self) -> tuple[Points, Points, Points, float]:
        start, end = np.array(self.start, float), np.array(self.end, float)
        length = float(np.hypot(*(end - start)))
        along = (end - start) / length
        return start, along, np.array([-along[1], along[0]]), length


@dataclass(frozen=True, slots=True)
class Finish:
    """Appearance of a cable.

    Attributes:
        rgb: Colour in [0, 255].
        ambient, diffuse, specular: Shares of the light.
        light: Direction of the light across the cable, from -1 (one side) to 1 (the other).
        strand_px: Length of a strand's turn, 0 for a smooth insulated cable.
    """

    rgb: tuple[float, float, float]
    ambient: float
    diffuse: float
    specular: float
    light: float
    strand_px: float


def draw_cable(
    image: FloatImage,
    arc: Arc,
    width_px: tuple[float, float],
    finish: Finish,
    visible: FloatImage | None = None,
) -> None:
    """Paint a cable along an arc.

    Cables thinner than a pixel keep their coverage: they fade instead of vanishing.

    Args:
        image: Painted in place.
        arc: The centreline.
        width_px: Width at the start and at the end of the arc, for perspective.
        finish: Appearance.
        visible: (H, W) in [0, 1], 0 where something hides the cable.
    """
    height, width = image.shape[:2]
    distance, along = arc.distance(height, width)
    length = float(np.hypot(arc.end[0] - arc.start[0], arc.end[1] - arc.start[1]))
    near = np.abs(distance) <= max(width_px) / 2 + 1
    near &= (along >= -0.5) & (along <= length + 0.5)
    rows, columns = np.nonzero(near)
    if not len(rows):
        return
    d, u = distance[rows, columns], along[rows, columns]
    w = width_px[0] + (width_px[1] - width_px[0]) * np.clip(u / length, 0, 1)
    coverage = np.clip(np.maximum(w, 1) / 2 + 0.5 - np.abs(d), 0, 1) * np.minimum(w, 1)
    if visible is not None:
        coverage = coverage * visible[rows, columns]
    shade = _shade(np.clip(2 * d / np.maximum(w, 1), -1, 1), u, w, finish)
    colour = np.clip(
        shade[:, None] * np.array(finish.rgb, np.float32) + _glint(shade, finish)[:, None], 0, 255
    )
    patch = image[rows, columns]
    image[rows, columns] = patch + coverage[:, None].astype(np.float32) * (colour - patch)


def _shade(s: FloatImage, u: FloatImage, w: FloatImage, finish: Finish) -> FloatImage:
    """Return the brightness at s in [-1, 1] across a cylinder: Lambertian, with strands if wide enough."""
    facing = np.maximum(s * finish.light + np.sqrt(np.maximum(1 - s * s, 0)) * (1 - abs(finish.light)), 0)
    shade = finish.ambient + finish.diffuse * facing
    if finish.strand_px > 0:
        depth = 0.25 * np.clip((w - 3) / 5, 0, 1)
        shade = shade * (1 + depth * np.sin(2 * np.pi * (u / finish.strand_px + 0.5 * s)))
    out: FloatImage = shade.astype(np.float32)
    return out


def _glint(shade: FloatImage, finish: Finish) -> FloatImage:
    brightest = finish.ambient + finish.diffuse
    out: FloatImage = (255 * finish.specular * np.clip(shade / brightest, 0, 1) ** 8).astype(np.float32)
    return out
