"""Functions on segments given as (N, 4) arrays x1 y1 x2 y2, in any unit of length."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from lsnet.arrays import RealArray


def length(endpoints: RealArray) -> RealArray:
    """Return (N,) Euclidean lengths."""
    return np.hypot(endpoints[:, 2] - endpoints[:, 0], endpoints[:, 3] - endpoints[:, 1])


def orientation(endpoints: RealArray) -> RealArray:
    """Return (N,) angles of the segments to the x axis, radians in [0, pi)."""
    angle = np.arctan2(endpoints[:, 3] - endpoints[:, 1], endpoints[:, 2] - endpoints[:, 0])
    return np.mod(angle, np.pi) % np.pi


def angle_between(a: RealArray, b: RealArray) -> RealArray:
    """Return the smallest difference of orientations, elementwise, radians in [0, pi / 2]."""
    difference = np.abs(a - b) % np.pi
    return np.minimum(difference, np.pi - difference)


def cross(a: RealArray, b: RealArray) -> RealArray:
    """Return (N,) cross products of vectors (N, 2)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def clip_to_boxes(endpoints: ArrayLike, boxes: ArrayLike) -> tuple[RealArray, RealArray]:
    """Clip each segment to each axis-parallel box (Liang and Barsky).

    Args:
        endpoints: (..., 4).
        boxes: (..., 4) as x_min y_min x_max y_max; the shapes broadcast.

    Returns:
        (t_in, t_out), the parameters along each segment between which it is inside the box, 0 at the first
        endpoint and 1 at the second. The segment misses the box where t_in >= t_out.
    """
    endpoints, boxes = np.broadcast_arrays(np.asarray(endpoints, float), np.asarray(boxes, float))
    t_in, t_out = np.zeros(endpoints.shape[:-1]), np.ones(endpoints.shape[:-1])
    for axis in (0, 1):
        start = endpoints[..., axis]
        step = endpoints[..., axis + 2] - start
        low, high = boxes[..., axis] - start, boxes[..., axis + 2] - start
        is_parallel = np.abs(step) < 1e-12
        safe_step = np.where(is_parallel, 1.0, step)
        near, far = low / safe_step, high / safe_step
        is_outside = is_parallel & ((low > 0) | (high < 0))
        t_in = np.where(is_parallel, t_in, np.maximum(t_in, np.minimum(near, far)))
        t_out = np.where(is_parallel, t_out, np.minimum(t_out, np.maximum(near, far)))
        t_out = np.where(is_outside, -1.0, t_out)
    return t_in, t_out
