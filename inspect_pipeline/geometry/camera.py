"""Pinhole cameras: their axes in the world, the ray of a pixel, the pixel of a point.

World directions are (east, north, up). Where rays meet the ground: `terrain`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from inspect_pipeline.geometry.attitude import YawPitchRoll, to_rotation, to_turns

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from inspect_pipeline.arrays import Floats, Ints, Mask


# Distortion models whose coefficients OpenCV takes in this order, and the numbers of coefficients it accepts.
_UNDISTORTED, _N_COEFFICIENTS = frozenset({"plumb_bob", "rational_polynomial"}), frozenset({4, 5, 8, 12, 14})
_DOWN = to_rotation((0.0, -90.0, 0.0))


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole camera with lens distortion, of the image as it is stored.

    Attributes:
        image_size: (height, width) in pixels.
        focal_px: (x, y).
        centre_px: (x, y), counted from the top-left corner of the top-left pixel.
        distortion_model: as in sensor_msgs/CameraInfo, such as "plumb_bob".
        distortion: coefficients of the model, such as k1, k2, p1, p2, k3; empty without distortion.
    """

    image_size: tuple[int, int]
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion_model: str
    distortion: tuple[float, ...]


def lens_of_view(image_size: tuple[int, int], view_deg: float) -> Intrinsics:
    """Return an undistorted lens with a horizontal field of view, for images of (height, width)."""
    height, width = image_size
    focal_px = float(width / 2 / np.tan(np.radians(view_deg) / 2))
    return Intrinsics(image_size, (focal_px, focal_px), (width / 2, height / 2), "", ())


def resized(lens: Intrinsics, image_size: tuple[int, int]) -> Intrinsics:
    """Return the lens of the same picture scaled to (height, width)."""
    sy, sx = (now / then for now, then in zip(image_size, lens.image_size, strict=True))
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    return Intrinsics(
        image_size, (fx * sx, fy * sy), (cx * sx, cy * sy), lens.distortion_model, lens.distortion
    )


def camera_axes(turns_deg: ArrayLike) -> Floats:
    """Return the camera's right, down and ahead as unit vectors (east, north, up).

    Args:
        turns_deg: (..., 3) yaw, pitch and roll, as in `YawPitchRoll`.

    Returns:
        (..., 3, 3); NaN where a turn is NaN.
    """
    body_to_ned = to_rotation(turns_deg).as_matrix()  # columns: forward, right, down
    axes: Floats = np.swapaxes(body_to_ned, -1, -2)[..., [1, 2, 0], :][..., [1, 0, 2]] * (1.0, 1.0, -1.0)
    return axes


def pixel_rays(lens: Intrinsics, turns: YawPitchRoll, pixels: ArrayLike) -> Floats:
    """Return the (N, 3) unit vectors (east, north, up) along which (N, 2) pixels look.

    Distortion is undone for the models "plumb_bob" and "rational_polynomial" with a number of coefficients
    that OpenCV knows; other lenses are treated as undistorted.
    """
    centred = (np.asarray(pixels, np.float64).reshape(-1, 2) - lens.centre_px) / lens.focal_px
    is_known = lens.distortion_model in _UNDISTORTED and len(lens.distortion) in _N_COEFFICIENTS
    if is_known and any(lens.distortion):
        flat = cv2.undistortPoints(centred[:, np.newaxis], np.eye(3), np.array(lens.distortion))
        centred = np.asarray(flat, np.float64).reshape(-1, 2)
    rays: Floats = np.column_stack((centred, np.ones(len(centred)))) @ camera_axes(turns)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    return rays


def turned_down(vehicle: YawPitchRoll) -> YawPitchRoll:
    """Return the turns of a camera fixed to look straight down, the top of its image towards the nose."""
    return YawPitchRoll(*to_turns(to_rotation(vehicle) * _DOWN).tolist())


@dataclass(frozen=True, slots=True, eq=False)
class CameraPoses:
    """Pinhole cameras of N frames, with the optical axis through the middle of the image.

    positions (N, 3) in m; axes (N, 3, 3) are right, down and ahead; focal_px (N,); sizes (N, 2) are
    (width, height). NaN where the pose is unknown.
    """

    positions: Floats
    axes: Floats
    focal_px: Floats
    sizes: Floats

    def __getitem__(self, frames: Ints | Mask | slice) -> CameraPoses:
        return CameraPoses(
            self.positions[frames], self.axes[frames], self.focal_px[frames], self.sizes[frames]
        )

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the pixels (N, P, 2) and depths (N, P) in m of points (P, 3) or (N, P, 3).

        The pixels of points behind a camera (depth below 0) are meaningless.
        """
        away = points - self.positions[:, np.newaxis]
        seen = np.einsum("nij,npj->npi", self.axes, away)
        depths = seen[..., 2]
        scale = self.focal_px[:, np.newaxis] / np.where(np.abs(depths) < 1e-9, 1e-9, depths)
        return seen[..., :2] * scale[..., np.newaxis] + self.sizes[:, np.newaxis] / 2, depths

    def rays(self, frames: Ints, pixels: Floats) -> Floats:
        """Return the directions (P, 3), of depth 1, of pixels (P, 2) in the frames (P,)."""
        offsets = (pixels - self.sizes[frames] / 2) / self.focal_px[frames, np.newaxis]
        ahead = np.column_stack((offsets, np.ones(len(pixels))))
        rays: Floats = np.einsum("pij,pi->pj", self.axes[frames], ahead)
        return rays
