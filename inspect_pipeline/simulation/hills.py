"""Draw the ground where it has hills."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from inspect_pipeline.simulation.ground import TEXEL_M

if TYPE_CHECKING:
    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.simulation.route import Route
    from inspect_pipeline.simulation.scene import SimulatedCamera

_LEAST_DOWN = 0.05  # of a ray, which else never meets the ground
_ROUNDS = 8  # each leaves a quarter of the error where the ground rises by a seventh


def draw_hills(tile: ImageArray, camera: SimulatedCamera, route: Route) -> ImageArray:
    """Draw the ground, covered with tiles as seen from above, by following the ray of each pixel."""
    height, width = camera.image_size
    x, y = np.meshgrid(np.arange(width) + 0.5 - width / 2, np.arange(height) + 0.5 - height / 2)
    pixels = np.stack((x, y, np.full_like(x, camera.focal_px)), axis=-1).astype(np.float32)
    rays = pixels @ camera.rotation.astype(np.float32)
    rays /= np.maximum(-rays[..., 2:], _LEAST_DOWN * np.linalg.norm(rays, axis=-1, keepdims=True))
    at = camera.position.astype(np.float32)
    ground_m = np.float32(route.ground_m(at[0]))
    for _ in range(_ROUNDS):
        met = at[:2] + rays[..., :2] * (at[2] - ground_m)[..., np.newaxis]
        ground_m = np.float32(route.ground_m(met[..., 0]))
    rows, columns = (np.float32(n) for n in tile.shape[:2])
    texels = met / np.float32(TEXEL_M) - np.float32(0.5)
    image = cv2.remap(
        tile, texels[..., 0] % columns, texels[..., 1] % rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP
    )
    return image.astype(np.uint8, copy=False)
