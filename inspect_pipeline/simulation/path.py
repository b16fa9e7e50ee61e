"""Compute the pose of the simulated drone and its camera at any time, for each kind of flight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.simulation.options import FlightKind
from inspect_pipeline.simulation.power_line import SPAN_M

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats

SPEED_M_S = 5.0
_HEIGHT_M, _SIDE_M = 23.0, -7.0
_AHEAD_RAD, _DOWN_RAD = np.deg2rad(14), np.deg2rad(47)
_ORBIT_CENTRE, _ORBIT_RADIUS_M, _ORBIT_RAD_S = np.array([SPAN_M, 0.0, 11.0]), 14.0, np.deg2rad(12)
_HOVER_X_M, _SCAN_RAD, _SCAN_RAD_S = 20.0, np.deg2rad(12), 2 * np.pi / 10
_LOSS_RAD, _LOSS_SHARE, _LOSS_TURN_S = np.deg2rad(-75), (0.4, 0.6), 1.0


@dataclass(frozen=True, slots=True)
class DronePose:
    """The drone's position in m and its camera's direction.

    Yaw and heading are turned left from x, the roll to the right.
    """

    position: tuple[float, float, float]
    heading_rad: float
    yaw_rad: float
    pitch_rad: float  # downwards
    roll_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Path:
    """A flight of a kind and length; `raised_m` lifts it above wider lines, `phases` (4,) vary its `sway`."""

    kind: FlightKind
    seconds: float
    raised_m: float
    phases: Floats
    sway: float = 1.0

    def at(self, t: float) -> DronePose:
        """Return the pose at a time in s since the start."""
        if self.kind == FlightKind.ORBIT:
            return self._orbit(t)
        x = _HOVER_X_M if self.kind == FlightKind.HOVER else SPEED_M_S * t
        pose = self._beside(t, x)
        if self.kind == FlightKind.HOVER:
            return replace(pose, yaw_rad=pose.yaw_rad + _SCAN_RAD * np.sin(_SCAN_RAD_S * t))
        if self.kind == FlightKind.LOSS:
            return replace(pose, yaw_rad=pose.yaw_rad + _LOSS_RAD * self._share_lost(t))
        return pose

    def _beside(self, t: float, x: float) -> DronePose:
        """Return a pose beside and above the line, with some sway."""
        a, b, c, d = self.phases
        k = self.sway
        return DronePose(
            position=(
                x,
                _SIDE_M + k * 0.5 * np.sin(0.5 * t + a),
                _HEIGHT_M + self.raised_m + k * 0.4 * np.sin(0.37 * t + b),
            ),
            heading_rad=0.0,
            yaw_rad=_AHEAD_RAD + k * np.deg2rad(2.5) * np.sin(0.43 * t + c),
            pitch_rad=_DOWN_RAD + k * np.deg2rad(1.5) * np.sin(0.6 * t + d),
        )

    def _orbit(self, t: float) -> DronePose:
        """Return a pose on a circle around a structure, which stays in the centre of the image."""
        around = _ORBIT_RAD_S * t + self.phases[0]
        radius_m = _ORBIT_RADIUS_M + self.raised_m
        away = radius_m * np.array([np.cos(around), np.sin(around)])
        above_m = _HEIGHT_M + self.raised_m + 0.4 * np.sin(0.37 * t) - _ORBIT_CENTRE[2]
        x, y, z = _ORBIT_CENTRE + np.array([*away, above_m])
        inwards = around + np.pi
        return DronePose((x, y, z), inwards, inwards, float(np.arctan2(above_m, radius_m)))

    def _share_lost(self, t: float) -> float:
        """Return how far the camera is turned away: 0 at first, 1 for a part of the flight, then 0 again."""
        leaves, returns = (share * self.seconds for share in _LOSS_SHARE)
        away, back = ((t - at) / _LOSS_TURN_S for at in (leaves, returns))
        return float(np.clip(away, 0, 1) - np.clip(back, 0, 1))
