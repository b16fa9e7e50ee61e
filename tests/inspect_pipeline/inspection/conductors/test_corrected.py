"""Cameras corrected by the lines of their frames: wires whose places are known, poses with known errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from inspect_rows import rules

from inspect_pipeline.geometry.camera import CameraPoses, camera_axes
from inspect_pipeline.inspection.conductors.layout import Place
from inspect_pipeline.inspection.conductors.realign import realign
from inspect_pipeline.inspection.conductors.refine import FREE_SD, refine
from inspect_pipeline.inspection.conductors.sight import look_at_span
from inspect_pipeline.inspection.rows import LineRows
from inspect_pipeline.inspection.span_view import SpanAxis

if TYPE_CHECKING:
    from inspect_pipeline.arrays import Floats, Mask
    from inspect_pipeline.inspection.conductors.sight import SpanSight

N_FRAMES, HEIGHT_M, FOCAL_PX = 12, 10.0, 1200.0
PLACES = [Place(y, 0.0) for y in (-4.0, -2.5, 0.0, 0.4, 0.8, 1.2, 3.0)]


def cameras(*, moved: Floats, turned_deg: Floats) -> CameraPoses:
    """Cameras that fly north 14 m above wires and 6 m beside them, and look ahead and down."""
    north_m = np.linspace(-10.0, 20.0, N_FRAMES)
    positions = np.column_stack((np.full(N_FRAMES, 6.0), north_m, np.full(N_FRAMES, HEIGHT_M + 14.0)))
    return CameraPoses(
        positions + moved,
        camera_axes(np.array((-10.0, -45.0, 0.0)) + turned_deg),
        np.full(N_FRAMES, FOCAL_PX),
        np.tile((1280.0, 720.0), (N_FRAMES, 1)),
    )


TRUE = cameras(moved=np.zeros((N_FRAMES, 3)), turned_deg=np.zeros((N_FRAMES, 3)))


def axis() -> SpanAxis:
    """A span of 60 m to the north, 10 m high, without sag."""
    along_m = np.arange(0.5, 60.0)
    level = np.full(60, HEIGHT_M)
    return SpanAxis(
        "A-B",
        np.zeros(2),
        np.array((0.0, 1.0)),
        np.array((-1.0, 0.0)),
        60.0,
        1.0,
        HEIGHT_M,
        np.column_stack((np.zeros(60), along_m, level)),
        level,
        np.zeros(60),
        is_ground_known=True,
        expected_conductors=None,
    )


def wire(place: Place) -> Floats:
    """Points of a wire every metre."""
    return np.column_stack((np.full(60, -place.across_m), axis().bins_m, np.full(60, HEIGHT_M)))


def seen_by(recorded: CameraPoses) -> SpanSight:
    """What the true cameras see of all wires, as it looks by the recorded ones."""
    seen = [(frame, _seen(frame, place)) for frame in range(N_FRAMES) for place in PLACES]
    found = [(frame, points) for frame, points in seen if len(points) > 1]
    lines = LineRows(
        np.array([frame for frame, _ in found]),
        np.arange(len(found)),
        np.cumsum([0, *(len(points) for _, points in found)]),
        np.concatenate([points for _, points in found]),
    )
    return look_at_span(axis(), np.arange(N_FRAMES), recorded, lines, rules())


def _seen(frame: int, place: Place) -> Floats:
    (pixels,), (depths_m,) = TRUE[frame : frame + 1].project(wire(place))
    return pixels[_is_inside(pixels, depths_m)]


def _is_inside(pixels: Floats, depths_m: Floats) -> Mask:
    return (depths_m > 0) & (pixels >= 0).all(axis=1) & (pixels < (1280, 720)).all(axis=1)


def off_px(found: CameraPoses) -> float:
    """How far from their pixels cameras expect most points of wires that they see."""
    off: list[float] = []
    for place in PLACES:
        (pixels, depths_m), (expected, _) = TRUE.project(wire(place)), found.project(wire(place))
        for frame in range(N_FRAMES):
            seen = _is_inside(pixels[frame], depths_m[frame])
            off += np.linalg.norm(pixels[frame] - expected[frame], axis=1)[seen].tolist()
    return float(np.quantile(off, 0.9))


@pytest.mark.parametrize(
    ("moved_m", "turned_deg"),
    [
        ((0.0, 0.0, 0.0), (1.5, 1.0, -1.0)),
        ((1.0, 0.0, 0.5), (0.0, 0.0, 0.0)),
        ((0.7, 0.0, -0.5), (1.0, 1.0, 1.0)),
    ],
)
def test_cameras_are_moved_and_turned_as_their_lines_say(
    moved_m: tuple[float, ...], turned_deg: tuple[float, ...]
) -> None:
    """Errors of each frame are others, and none is along the span."""
    rng = np.random.default_rng(5)
    errors = [rng.uniform(-1, 1, (N_FRAMES, 3)) * one for one in (moved_m, turned_deg)]
    recorded = cameras(moved=errors[0], turned_deg=errors[1])
    sight = seen_by(recorded)
    (corrected,), _ = refine([sight], [realign(sight, PLACES)], PLACES, FREE_SD)
    assert off_px(recorded) > 15
    assert off_px(corrected.cameras) < 0.5 * off_px(recorded)


def test_a_frame_aligned_by_the_next_wire_of_a_bundle_is_shifted_back() -> None:
    sight = seen_by(TRUE)
    shift_m = np.where(np.arange(N_FRAMES) == 3, 0.4, 0.0)
    wrong = sight.move(sight.view.across_m + shift_m[sight.view.frame], shift_m, np.ones(N_FRAMES))
    right = realign(wrong, PLACES)
    assert right.side_m - sight.side_m == pytest.approx(np.zeros(N_FRAMES), abs=0.051)
    assert realign(sight, PLACES).side_m == pytest.approx(sight.side_m)
