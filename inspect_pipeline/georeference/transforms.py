"""Poses from a tree of transforms: chains from a world frame to the vehicle or a camera."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from inspect_pipeline.georeference.samples import PoseSamples, SampleRows, longest
from inspect_pipeline.messages.pose import FrameRole, frame_role, is_world

if TYPE_CHECKING:
    from inspect_pipeline.messages.pose import Transform

# From forward, left, up to optical axes: right, down, ahead.
_OPTICAL_FLU = Rotation.from_matrix([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


class Chain(NamedTuple):
    """The pose of a frame in the world.

    rotations: (w, x, y, z) from forward, left, up to east, north, up; places: east, north, up in m.
    """

    role: FrameRole
    rotations: PoseSamples
    places: PoseSamples


class TransformTree:
    """Collects transforms and composes those that lead to the vehicle or a camera."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, str], dict[int, SampleRows]] = defaultdict(
            lambda: defaultdict(SampleRows)
        )

    def add(self, channel_id: int, time_ns: int, transform: Transform) -> None:
        """Add a transform; of several channels that have it, the one with most samples counts."""
        rows = self._rows[transform.parent, transform.child][channel_id]
        rows.append(time_ns, *transform.rotation, *transform.translation_m)

    def chains(self) -> list[Chain]:
        """Return the chains from a world frame to frames with a role, the longest first.

        A camera on a gimbal comes before the gimbal.
        """
        edges = {
            pair: longest(map(SampleRows.to_samples, rows.values())) for pair, rows in self._rows.items()
        }
        # Of two parents of a frame, the one with most samples stands last and counts.
        parents = {child: parent for parent, child in sorted(edges, key=lambda pair: len(edges[pair]))}
        paths = [(role, _path(child, parents)) for child in parents if (role := frame_role(child))]
        return [
            _compose(role, [edges[pair] for pair in path])
            for role, path in sorted(paths, key=lambda item: -len(item[1]))
            if path
        ]


def _path(child: str, parents: dict[str, str]) -> list[tuple[str, str]]:
    """Return the pairs from the topmost world frame to a frame; none without such a frame or in a loop."""
    path: list[tuple[str, str]] = []
    while child in parents and len(path) <= len(parents):
        path.insert(0, (parents[child], child))
        child = parents[child]
    is_loop = len(path) > len(parents)
    starts = [i for i, (parent, _) in enumerate(path) if is_world(parent)]
    return path[starts[0] :] if starts and not is_loop else []


def _compose(role: FrameRole, edges: list[PoseSamples]) -> Chain:
    """Multiply the last known transforms at each time of a change; one of a single sample is constant."""
    moving = [edge for edge in edges if len(edge) > 1]
    if moving:
        times_ns = np.unique(np.concatenate([edge.times_ns for edge in moving]))
        times_ns = times_ns[times_ns >= max(edge.times_ns[0] for edge in moving)]
    else:
        times_ns = np.array([max(edge.times_ns[0] for edge in edges)], np.uint64)
    rotation, places = Rotation.identity(len(times_ns)), np.zeros((len(times_ns), 3))
    for edge in edges:
        at = np.maximum(np.searchsorted(edge.times_ns, times_ns, side="right") - 1, 0)
        places += rotation.apply(edge.values[at, 4:])
        rotation *= Rotation.from_quat(edge.values[at][:, [1, 2, 3, 0]])
    if role == "optics":
        rotation *= _OPTICAL_FLU
    wxyz = rotation.as_quat()[:, [3, 0, 1, 2]]
    return Chain(role, PoseSamples(times_ns, wxyz), PoseSamples(times_ns, places))
