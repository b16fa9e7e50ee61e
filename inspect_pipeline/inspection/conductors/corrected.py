"""Poses of cameras by what the lines of their frames tell of the errors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats
    from inspect_pipeline.geometry.camera import CameraPoses
    from inspect_pipeline.inspection.conductors.sight import SpanSight


def correct_cameras(sight: SpanSight, corrections: Floats) -> CameraPoses:
    """Return the cameras of a sight as recorded, moved and turned by the corrections (N, 5) of its crossings.

    Those are a shift across, a turn, a scale, and the changes of turn and scale by distance aside: what a
    move across and in height, and turns about three axes do to lines on a plane. Lines along the span tell
    nothing of a move along it.
    """
    shift_m, turn, scale, pitch, roll = corrections.T
    above_m = _mean_above_m(sight)
    # Along the span, to its left, and upwards.
    axes = np.stack((np.append(sight.axis.along, 0.0), np.append(sight.axis.across, 0.0), (0.0, 0.0, 1.0)))
    turns = np.column_stack((roll * above_m, -pitch * above_m, turn))
    rotations = Rotation.from_rotvec(turns @ axes).as_matrix()
    moved = np.outer(shift_m - roll * above_m**2, axes[1]) + np.outer(scale * above_m, axes[2])
    cameras = sight.cameras
    return replace(
        cameras,
        positions=cameras.positions + moved,
        axes=np.einsum("nij,nkj->nik", cameras.axes, rotations),
    )


def _mean_above_m(sight: SpanSight) -> Floats:
    """Return the mean height (N,) of each camera above what it shows of the span, 0 if nothing."""
    total_m = np.where(sight.fine, sight.above_m, 0.0).sum(axis=1)
    return np.asarray(total_m / np.maximum(sight.fine.sum(axis=1), 1))
