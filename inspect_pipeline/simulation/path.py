"""Compute the pose of the simulated drone and its camera at any time, for each kind of flight."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.simulation.options import FlightKind
from inspect_pipeline.simulation.power_line import SPAN_M
from inspect_pipeline.simulation.route import Route

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats

SPEED_M_S = 5.0
_HEIGHT_M, _SIDE_M = 23.0, -7.0
_AHEAD_RAD, _DOWN_RAD = np.deg2rad(14), np.deg2rad(47)
_ORBIT_AT_M, _ORBIT_Z_M, _ORBIT_RADIUS_M, _ORBIT_RAD_S = SPAN_M, 11.0, 14.0, np.deg2rad(12)
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
    """A flight of a kind and length along a route, at a constant height above the ground.

    raised_m: how much higher above wider lines. phases (4,): of its `sway`.
    """

    kind: FlightKind
    seconds: float
    raised_m: float
    phases: Floats
    sway: float = 1.0
    route: Route = Route()  # noqa: RUF009 - immutable

    def at(self, t: float) -> DronePose:
        """Return the pose at a time in s since the start."""
        if self.kind == FlightKind.ORBIT:
            return self._orbit(t)
        pose = self._beside(t, _HOVER_X_M if self.kind == FlightKind.HOVER else SPEED_M_S * t)
        if self.kind == FlightKind.HOVER:
            return replace(pose, yaw_rad=pose.yaw_rad + _SCAN_RAD * np.sin(_SCAN_RAD_S * t))
        if self.kind == FlightKind.LOSS:
            return replace(pose, yaw_rad=pose.yaw_rad + _LOSS_RAD * self._share_lost(t))
        return pose

    def _beside(self, t: float, along: float) -> DronePose:
        """Return a pose beside and above the line, with some sway."""
        a, b, c, d = self.phases
        k = self.sway
        (x, y), heading_rad = self.route.beside(along, _SIDE_M + k * 0.5 * np.sin(0.5 * t + a))
        above_m = _HEIGHT_M + self.raised_m + k * 0.4 * np.sin(0.37 * t + b)
        return DronePose(
            position=(float(x), float(y), float(self.route.ground_m(x)) + above_m),
            heading_rad=heading_rad,
            yaw_rad=heading_rad + _AHEAD_RAD + k * np.deg2rad(2.5) * np.sin(0.43 * t + c),
            pitch_rad=_DOWN_RAD + k * np.deg2rad(1.5) * np.sin(0.6 * t + d),
        )

    def _orbit(self, t: float) -> DronePose:
        """Return a pose on a circle around a structure, which stays in the centre of the image."""
        around = _ORBIT_RAD_S * t + self.phases[0]
        radius_m = _ORBIT_RADIUS_M + self.raised_m
        away = radius_m * np.array([np.cos(around), np.sin(around)])
        above_m = _HEIGHT_M + self.raised_m + 0.4 * np.sin(0.37 * t) - _ORBIT_Z_M
        centre = self.route.places(_ORBIT_AT_M)
        x, y = (centre + away).tolist()
        z = float(self.route.ground_m(centre[0])) + _ORBIT_Z_M + above_m
        inwards = around + np.pi
        return DronePose((x, y, z), inwards, inwards, float(np.arctan2(above_m, radius_m)))

    def _share_lost(self, t: float) -> float:
        """Return how far the camera is turned away: 0 at first, 1 for a part of the flight, then 0 again."""
        leaves, returns = (share * self.seconds for share in _LOSS_SHARE)
        away, back = ((t - at) / _LOSS_TURN_S for at in (leaves, returns))
        return float(np.clip(away, 0, 1) - np.clip(back, 0, 1))
