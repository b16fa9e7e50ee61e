"""How far a camera's turns move its pixels, beyond what tracks expect of themselves.

A camera that circles what it looks at turns steadily, and what it looks at stays where it is: undoing all of
the turn would move it. So the turn of the last seconds is taken for intended, and what differs is undone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from inspect_pipeline.geometry.camera import camera_axes

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.geometry.attitude import YawPitchRoll


_STEADY_S = 4.0


class CameraMotion:
    """Follows how one camera is turned."""

    def __init__(self) -> None:
        self._axes: Floats | None = None
        self._time_ns = 0
        self._steady: Floats | None = None  # rad/s about right, down, ahead

    def update(
        self, turns: YawPitchRoll | None, time_ns: int, focal_px: float | None, image_size: tuple[int, int]
    ) -> Floats | None:
        """(3, 3) from the pixels of the frame before to those of this one, for far things.

        The optical axis is taken to meet the middle of (height, width). None where the turns of this frame or
        of the one before, or the lens, are not known.
        """
        if turns is None or not focal_px:
            self._axes = self._steady = None
            return None
        before, self._axes = self._axes, camera_axes(turns)
        elapsed_s, self._time_ns = (time_ns - self._time_ns) / 1e9, time_ns
        if before is None or elapsed_s <= 0:
            return None
        turned = cv2.Rodrigues(self._axes @ before.T)[0].ravel()
        steady = turned / elapsed_s if self._steady is None else self._steady
        share = 1 - np.exp(-elapsed_s / _STEADY_S)
        self._steady = steady + share * (turned / elapsed_s - steady)
        height, width = image_size
        lens = np.array([[focal_px, 0, width / 2], [0, focal_px, height / 2], [0, 0, 1]])
        unsteady = cv2.Rodrigues(np.asarray(turned - steady * elapsed_s, np.float64))[0]
        return np.asarray(lens @ unsteady @ np.linalg.inv(lens), np.float64)
