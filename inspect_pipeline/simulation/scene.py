"""Cameras, visible parts of conductors, and trees, in the axes of `route`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Mask
    from inspect_pipeline.simulation.power_line import Conductor
    from inspect_pipeline.simulation.route import Route


_NEAREST_M = 1.0
_FARTHEST_M = 70.0  # objects beyond it are too small to matter


class Tree(NamedTuple):
    """A crown of leaf clumps: centres (N, 3) and radii (N,) in m, their light (N,) in [0, 1].

    ground_m: height of the ground that it stands on.
    """

    clumps: Floats
    radii_m: Floats
    light: Floats
    tint: float
    ground_m: float


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedCamera:
    """A pinhole camera.

    position: (3,) in m; rotation: (3, 3) from the world to the camera (x right, y down, z ahead).
    focal_px is that of both axes; the optical axis meets the middle of the image of (height, width).
    """

    position: Floats
    rotation: Floats
    focal_px: float
    image_size: tuple[int, int]

    @property
    def matrix(self) -> Floats:
        """Return the (3, 4) projection from homogeneous world coordinates to homogeneous pixels."""
        height, width = self.image_size
        f = self.focal_px
        intrinsics = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
        return intrinsics @ np.column_stack((self.rotation, -self.rotation @ self.position))

    def sees(self, pixels: Floats, depths: Floats) -> Mask:
        """Return which projected points are inside the image and not too near."""
        height, width = self.image_size
        x, y = pixels.T
        seen: Mask = (depths > _NEAREST_M) & (x >= 0) & (x <= width) & (y >= 0) & (y <= height)
        return seen

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Return (N, 2) pixels, invalid behind the camera, and (N,) depths in m of (N, 3) points."""
        height, width = self.image_size
        seen = (points - self.position) @ self.rotation.T
        depths = seen[:, 2]
        scale = self.focal_px / np.where(np.abs(depths) < 1e-9, 1e-9, depths)
        return seen[:, :2] * scale[:, np.newaxis] + (width / 2, height / 2), depths


class Gaze(NamedTuple):
    """Direction of a camera relative to x: yaw to the left, pitch downwards, then roll to the right."""

    yaw_rad: float
    pitch_rad: float
    roll_rad: float = 0.0


def look(position: Floats, gaze: Gaze, focal_px: float, size: tuple[int, int]) -> SimulatedCamera:
    """Return the camera at (3,) m with an image of (height, width)."""
    (sin_y, sin_p, sin_r), (cos_y, cos_p, cos_r) = np.sin(gaze), np.cos(gaze)
    ahead = np.array([cos_y * cos_p, sin_y * cos_p, -sin_p])
    level = np.array([sin_y, -cos_y, 0.0])
    under = np.array([-sin_p * cos_y, -sin_p * sin_y, -cos_p])
    right, down = level * cos_r + under * sin_r, under * cos_r - level * sin_r
    return SimulatedCamera(position, np.stack((right, down, ahead)), focal_px, size)


def near(camera: SimulatedCamera, points: Floats) -> slice:
    """Return which of (N, 3) points, in order along a line, are near enough to be seen."""
    away = points[:, :2] - camera.position[:2]
    within = np.flatnonzero(np.hypot(*away.T) <= _FARTHEST_M)
    return slice(int(within[0]), int(within[-1]) + 1) if len(within) else slice(0, 0)


class VisiblePart(NamedTuple):
    """A part of a conductor inside the image: its points' numbers [first, last), pixels (N, 2), widths (N,).

    Where the conductor continues outside the image, the pixels begin or end at the border.
    """

    first: int
    last: int
    pixels: Floats
    widths_px: Floats


def visible_parts(camera: SimulatedCamera, conductor: Conductor) -> list[VisiblePart]:
    """Return the parts of a conductor inside the image, without those that are missing."""
    window = near(camera, conductor.points)
    offset = window.start
    is_there = conductor.is_there[window]
    pixels, depths = camera.project(conductor.points[window])
    edges = np.flatnonzero(
        np.diff(is_there & camera.sees(pixels, depths), prepend=False, append=False)
    ).reshape(-1, 2)
    parts = []
    for first, last in edges.tolist():
        kept = slice(first, last)
        shown, widths_px = pixels[kept].copy(), conductor.diameter_m * camera.focal_px / depths[kept]
        for inside, outside, end in ((first, first - 1, 0), (last - 1, last, -1)):
            if 0 <= outside < len(pixels) and is_there[outside] and depths[outside] > _NEAREST_M:
                shown[end] = _at_border(pixels[inside], pixels[outside], camera.image_size)
        if last - first > 1:
            parts.append(VisiblePart(offset + first, offset + last, shown, widths_px))
    return parts


def _at_border(inside: Floats, outside: Floats, image_size: tuple[int, int]) -> Floats:
    """Return where the line from a point inside the image to one outside crosses the border."""
    step = outside - inside
    border = np.where(step > 0, image_size[::-1], 0.0)
    shares = np.divide(border - inside, step, out=np.full(2, np.inf), where=step != 0)
    left: Floats = inside + max(0.0, float(shares.min())) * step
    return left


def plant_trees(
    rng: np.random.Generator, first_m: float, last_m: float, sun: Floats, route: Route
) -> list[Tree]:
    """Return trees on both sides of the line, too low and too far away to hide it."""
    count = int((last_m - first_m) * 0.5)
    trees = []
    for along in rng.uniform(first_m, last_m, count):
        side, distance_m = rng.choice((-1, 1)), 7 + rng.gamma(2.0, 7.0)
        radius_m = rng.uniform(0.8, 2.6)
        (x, y), _ = route.beside(along, side * distance_m)
        trees.append(_grow(rng, np.array([x, y, route.ground_m(x)]), radius_m, sun))
    return trees


def _grow(rng: np.random.Generator, foot: Floats, radius_m: float, sun: Floats) -> Tree:
    centre = foot + np.array([0.0, 0.0, 1.1 * radius_m])
    n_clumps = int(420 * radius_m**1.5)
    outward = rng.normal(size=(n_clumps, 3)) * (1, 1, 0.9)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    lumps = 1 + 0.22 * np.sin(outward @ rng.normal(0, 3, (3, 3)) + rng.uniform(0, 6, 3)).sum(axis=1)
    reach = radius_m * lumps * rng.uniform(0.7, 1.0, n_clumps)
    light = 0.42 + 0.36 * outward @ sun + 0.5 * (lumps - 1) + rng.normal(0, 0.12, n_clumps)
    return Tree(
        clumps=centre + outward * reach[:, np.newaxis],
        radii_m=rng.uniform(0.05, 0.14, n_clumps),
        light=np.clip(light, 0, 1),
        tint=rng.uniform(0, 1) ** 2,
        ground_m=float(foot[2]),
    )
