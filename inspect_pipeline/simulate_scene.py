"""The drawn world: a camera, conductors between poles, trees. In m: x along the line, y left, z up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

SPAN_M = 55.0
POLE_HEIGHT_M = 12.5
CROSSARM_HALF_M = 1.8
_CONDUCTORS = (
    (-1.6, 12.3, 0.045),
    (0.0, 12.9, 0.045),
    (1.6, 12.3, 0.045),
    (0.35, 9.2, 0.06),
)  # y, z, diameter
_SAG_M = 1.1
_SAMPLE_M = 0.02
_NEAREST_M = 1.0


class Conductor(NamedTuple):
    """Points (N, 3) in m along one conductor, and its diameter."""

    points: Floats
    diameter_m: float


class Tree(NamedTuple):
    """A crown of leaf clumps: centres (N, 3) and radii (N,) in m, their light (N,) in [0, 1]."""

    clumps: Floats
    radii_m: Floats
    light: Floats
    tint: float


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
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
        """(3, 4) from homogeneous world to homogeneous pixels."""
        height, width = self.image_size
        f = self.focal_px
        intrinsics = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
        return intrinsics @ np.column_stack((self.rotation, -self.rotation @ self.position))

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """(N, 2) pixels and (N,) depths in m of (N, 3) points; the pixels mean nothing behind the camera."""
        projected = np.column_stack((points, np.ones(len(points)))) @ self.matrix.T
        depths = projected[:, 2]
        return projected[:, :2] / np.where(np.abs(depths) < 1e-9, 1e-9, depths)[:, np.newaxis], depths


def look(
    position: Floats, yaw_rad: float, pitch_rad: float, focal_px: float, size: tuple[int, int]
) -> Camera:
    """A camera without roll that looks along x, turned left by yaw and down by pitch."""
    ahead = np.array(
        [np.cos(yaw_rad) * np.cos(pitch_rad), np.sin(yaw_rad) * np.cos(pitch_rad), -np.sin(pitch_rad)]
    )
    right = np.array([np.sin(yaw_rad), -np.cos(yaw_rad), 0.0])
    return Camera(position, np.stack((right, np.cross(ahead, right), ahead)), focal_px, size)


def pole_positions(first_m: float, last_m: float) -> Floats:
    """Where along x the poles between two x stand."""
    return np.arange(np.ceil(first_m / SPAN_M), np.floor(last_m / SPAN_M) + 1) * SPAN_M


def conductors(first_m: float, last_m: float) -> list[Conductor]:
    """The conductors between two x: hanging as parabolas, which catenaries this flat are to a centimetre."""
    x = np.arange(first_m, last_m, _SAMPLE_M)
    along = x / SPAN_M % 1
    drop = 4 * _SAG_M * along * (1 - along)
    return [
        Conductor(np.column_stack((x, np.full_like(x, y), z - drop)), diameter)
        for y, z, diameter in _CONDUCTORS
    ]


def visible_runs(camera: Camera, conductor: Conductor) -> list[tuple[Floats, Floats]]:
    """The parts of a conductor inside the image: (N, 2) pixels and (N,) widths in pixels of each."""
    pixels, depths = camera.project(conductor.points)
    height, width = camera.image_size
    is_inside = (depths > _NEAREST_M) & np.all((pixels >= 0) & (pixels <= (width, height)), axis=1)
    edges = np.flatnonzero(np.diff(is_inside, prepend=False, append=False))
    return [
        (pixels[first:last], conductor.diameter_m * camera.focal_px / depths[first:last])
        for first, last in edges.reshape(-1, 2)
        if last - first > 1
    ]


def plant_trees(rng: np.random.Generator, first_m: float, last_m: float, sun: Floats) -> list[Tree]:
    """Trees on both sides of the line, too low and too far to hide it."""
    count = int((last_m - first_m) * 0.5)
    trees = []
    for x in rng.uniform(first_m, last_m, count):
        side, distance_m = rng.choice((-1, 1)), 7 + rng.gamma(2.0, 7.0)
        radius_m = rng.uniform(0.8, 2.6)
        trees.append(_grow(rng, np.array([x, side * distance_m, 1.1 * radius_m]), radius_m, sun))
    return trees


def _grow(rng: np.random.Generator, centre: Floats, radius_m: float, sun: Floats) -> Tree:
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
    )
