"""Draw what carries the conductors: wooden poles, and lattice towers of steel."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import cv2
import numpy as np

from inspect_pipeline.simulation.power_line import POLE_HEIGHT_M

if TYPE_CHECKING:
    from collections.abc import Iterable

    from inspect_pipeline.arrays import Floats, ImageArray
    from inspect_pipeline.simulation.power_line import Structure
    from inspect_pipeline.simulation.scene import SimulatedCamera

    Strips = Iterable[tuple[float, float, tuple[int, ...]]]

SUBPIXEL_BITS = 4  # binary places of the coordinates given to OpenCV
# Strips of a beam over each other: share of the width, shift to the light, colour.
_WOOD = (
    (1.0, 0.0, (64, 56, 48)),
    (0.8, 0.05, (96, 84, 72)),
    (0.5, 0.1, (128, 112, 96)),
    (0.2, 0.15, (147, 129, 110)),
)
_STEEL = ((1.0, 0.0, (84, 88, 92)), (0.6, 0.1, (138, 143, 148)))
_ARM_Z_M = 12.1
_POLE = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, POLE_HEIGHT_M]])  # from its foot
_FOOT_HALF_M, _TOP_HALF_M, _N_PANELS = 1.1, 0.35, 5  # of a lattice tower
_LEG_M, _BRACE_M = 0.12, 0.06  # widths of its beams
_CORNERS = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])


def draw_pole(image: ImageArray, camera: SimulatedCamera, structure: Structure, arm_half_m: float) -> None:
    """Draw a wooden pole with a crossarm."""
    draw_beam(image, camera, structure.foot + _POLE, 0.28, _WOOD)
    _draw_arm(image, camera, structure, arm_half_m, 0.16, _WOOD)


def draw_tower(image: ImageArray, camera: SimulatedCamera, structure: Structure, arm_half_m: float) -> None:
    """Draw a lattice tower of four legs with braces, and a crossarm."""
    heights = np.linspace(0, POLE_HEIGHT_M, _N_PANELS + 1)
    halves = np.linspace(_FOOT_HALF_M, _TOP_HALF_M, _N_PANELS + 1)
    left = structure.arm / np.hypot(*structure.arm)
    corners = _CORNERS @ np.array([[left[1], -left[0]], left])
    rings = [
        structure.foot + np.column_stack((half * corners, np.full(4, z)))
        for half, z in zip(halves, heights, strict=True)
    ]
    for low, high in pairwise(rings):
        for i in range(4):
            neighbour = (i + 1) % 4
            draw_beam(image, camera, np.array([low[i], high[neighbour]]), _BRACE_M, _STEEL)
            draw_beam(image, camera, np.array([low[neighbour], high[i]]), _BRACE_M, _STEEL)
            draw_beam(image, camera, np.array([low[i], high[i]]), _LEG_M, _STEEL)
    _draw_arm(image, camera, structure, arm_half_m, 0.2, _STEEL)


def _draw_arm(  # noqa: PLR0917 - what, on what, where, how
    image: ImageArray,
    camera: SimulatedCamera,
    structure: Structure,
    half_m: float,
    width_m: float,
    strips: Strips,
) -> None:
    end = np.array([*(half_m * structure.arm), 0.0])
    middle = structure.foot + np.array([0.0, 0.0, _ARM_Z_M])
    draw_beam(image, camera, np.stack((middle - end, middle + end)), width_m, strips)


def draw_beam(
    image: ImageArray,
    camera: SimulatedCamera,
    ends: Floats,
    diameter_m: float,
    strips: Strips,
) -> None:
    """Draw a straight beam between two points, lit from one side."""
    pixels, depths = camera.project(ends)
    if depths.min() < 1:
        return
    along = pixels[1] - pixels[0]
    across = np.array([-along[1], along[0]]) / max(np.hypot(*along), 1e-6)
    half_px = diameter_m * camera.focal_px / depths / 2
    for share, shift, colour in strips:
        offsets = half_px[:, np.newaxis] * across
        left, right = pixels + offsets * (2 * shift - share), pixels + offsets * (2 * shift + share)
        outline = np.rint((np.vstack((left, right[::-1])) - 0.5) * (1 << SUBPIXEL_BITS)).astype(np.int32)
        cv2.fillPoly(image, [outline], colour, cv2.LINE_AA, SUBPIXEL_BITS)
