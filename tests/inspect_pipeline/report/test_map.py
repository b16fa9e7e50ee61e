"""The map: places against geodesics of another library call, and what it says of spans and gaps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pyproj import Geod

from inspect_pipeline.report.map import draw_map, simplify

GEOD = Geod(ellps="WGS84")
SPAN = {
    "span_id": "A-B",
    "from_structure": "A",
    "to_structure": "B",
    "from_lat_deg": 52.0,
    "from_lon_deg": 5.0,
    "to_lat_deg": 52.0,
    "to_lon_deg": 5.004,
    "length_m": 274.6,
    "share": 0.5,
    "reason": None,
}


def frames(n: int) -> list[dict[str, Any]]:
    return [{"lat_deg": 52.0005, "lon_deg": 5.0 + i * 1e-4, "log_time_ns": i * 10**9} for i in range(n)]


def drawn(**changes: Any) -> Any:
    rows = {"spans": [SPAN], "stretches": [], "frames": frames(40), "gaps": [], "anomalies": []} | changes
    return draw_map(**rows, targets={"A-B": "span-1"})


def points(text: str) -> np.ndarray:
    return np.array([[float(n) for n in pair.split(",")] for pair in text.split()])


def test_distances_on_the_map_are_those_of_the_scale_bar() -> None:
    stretch = {"span_id": "A-B", "state": "seen", "first": 0, "stop": 10, "n_bins": 10}
    found = drawn(stretches=[stretch])
    (start, end) = points(found.strokes[0].points)
    length_m = GEOD.inv(5.0, 52.0, 5.004, 52.0)[2]
    metres = float(found.scale_label.split()[0])
    assert np.hypot(*(end - start)) / found.scale_px * metres == pytest.approx(length_m, rel=2e-3)
    assert end[0] > start[0]  # east is to the right
    (path,) = (points(text) for text in found.path)
    assert (path[:, 1] < start[1]).all()  # north is up


def test_stretches_lie_at_their_share_of_the_span() -> None:
    first = {"span_id": "A-B", "state": "seen", "first": 0, "stop": 4, "n_bins": 10}
    rest = {"span_id": "A-B", "state": "unseen", "first": 4, "stop": 10, "n_bins": 10}
    found = drawn(stretches=[first, rest])
    one, two = (points(stroke.points) for stroke in found.strokes)
    assert (one[1] == two[0]).all()
    assert (one[1] - one[0])[0] / (two[1] - one[0])[0] == pytest.approx(0.4, abs=0.01)
    assert "50 %" in [mark.label for mark in found.labels]


def test_unknown_coverage_is_no_number() -> None:
    found = drawn(spans=[SPAN | {"share": None, "reason": "lens unknown"}])
    assert "?" in [mark.label for mark in found.labels]
    assert any("not known, lens unknown" in mark.title for mark in found.labels)


def test_the_path_is_cut_where_frames_are_missing() -> None:
    gap = {"kind": "frame", "start_ns": 9 * 10**9, "end_ns": 20 * 10**9, "duration_s": 11.0}
    found = drawn(frames=[row for i, row in enumerate(frames(40)) if not 9 < i < 20], gaps=[gap])
    assert len(found.path) == 2
    assert found.gaps[0].title == "11.0 s: no frames"


def test_without_positions_there_is_no_map() -> None:
    unplaced = [row | {"lat_deg": None, "lon_deg": None} for row in frames(3)]
    assert drawn(spans=[], frames=unplaced) is None
    assert drawn(spans=[], frames=frames(1)).path == []


def test_simplify_keeps_corners_and_drops_what_lies_between() -> None:
    corner = np.array([[0, 0], [5, 0.01], [10, 0], [10, 5], [10, 10]], float)
    assert simplify(corner, 0.1).tolist() == [[0, 0], [10, 0], [10, 10]]
    assert len(simplify(np.zeros((5, 2)), 0.1)) == 2
