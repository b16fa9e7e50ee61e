"""Image motion caused by rotations of the camera.

A camera that circles a structure rotates steadily while the structure stays in the image: removing the
whole rotation would move it. The mean rotation rate of the last seconds is therefore taken as intended, and
only the difference from it is removed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from inspect_pipeline.geometry.camera import camera_axes

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.geometry.attitude import YawPitchRoll


_RATE_TIME_CONSTANT_S = 4.0


class CameraMotion:
    """Estimate the unintended rotation of one camera between consecutive frames."""

    def __init__(self) -> None:
        self._axes: Floats | None = None
        self._time_ns = 0
        self._mean_rate: Floats | None = None  # rad/s about right, down, ahead

    def update(
        self, attitude: YawPitchRoll | None, time_ns: int, focal_px: float | None, image_size: tuple[int, int]
    ) -> Floats | None:
        """Return the homography (3, 3) from pixels of the previous frame to pixels of this one.

        It holds for distant objects, with the principal point at the centre of `image_size` (height, width).
        None when the attitude of either frame or the focal length is unknown.
        """
        if attitude is None or not focal_px:
            self._axes = self._mean_rate = None
            return None
        previous, self._axes = self._axes, camera_axes(attitude)
        elapsed_s, self._time_ns = (time_ns - self._time_ns) / 1e9, time_ns
        if previous is None or elapsed_s <= 0:
            return None
        rotation = cv2.Rodrigues(self._axes @ previous.T)[0].ravel()
        mean_rate = rotation / elapsed_s if self._mean_rate is None else self._mean_rate
        gain = 1 - np.exp(-elapsed_s / _RATE_TIME_CONSTANT_S)
        self._mean_rate = mean_rate + gain * (rotation / elapsed_s - mean_rate)
        height, width = image_size
        intrinsics = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
        unintended = cv2.Rodrigues(np.asarray(rotation - mean_rate * elapsed_s, np.float64))[0]
        return np.asarray(intrinsics @ unintended @ np.linalg.inv(intrinsics), np.float64)
