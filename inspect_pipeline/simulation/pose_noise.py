"""Errors of recorded poses: white noise and slow drift of positions, white noise of attitudes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from inspect_pipeline.simulation.options import SimulationOptions
    from inspect_pipeline.simulation.path import DronePose

_DRIFT_PERIODS_S = (47.0, 61.0, 83.0)  # of east, north and up, so that they never repeat together


def disturb_pose(pose: DronePose, time_ns: int, options: SimulationOptions) -> DronePose:
    """Return the pose as it is recorded at a time: the same at every call."""
    rng = np.random.default_rng([options.seed, 3, time_ns])
    starts = np.random.default_rng([options.seed, 4]).uniform(0, 2 * np.pi, 3)
    white_m = options.position_noise_m * rng.standard_normal(3)
    drift_m = options.drift_m * np.sin(2 * np.pi * time_ns / 1e9 / np.array(_DRIFT_PERIODS_S) + starts)
    yaw_rad, pitch_rad, roll_rad = np.deg2rad(options.attitude_noise_deg) * rng.standard_normal(3)
    x, y, z = (np.asarray(pose.position) + white_m + drift_m).tolist()
    return replace(
        pose,
        position=(x, y, z),
        yaw_rad=pose.yaw_rad + yaw_rad,
        pitch_rad=pose.pitch_rad + pitch_rad,
        roll_rad=pose.roll_rad + roll_rad,
    )
