"""Where places on spans are in images, by hand: angles of a camera that looks north across a span."""

from __future__ import annotations

import numpy as np
import pytest

from inspect_pipeline.geometry.local_frame import LocalMetres
from inspect_pipeline.inspection.places import see_place
from inspect_pipeline.inspection.rules import load_rules
from inspect_pipeline.inspection.spans import Span

ORIGIN = LocalMetres(47.0, 8.0)
PITCH_DEG, FOCAL_PX, HEIGHT_M, AWAY_M = -20.0, 1000.0, 30.0, 40.0


@pytest.mark.parametrize("slope", [0.0, 0.1, -0.1])
def test_a_place_over_a_slope_is_where_its_angle_says(slope: float) -> None:
    """The camera is 40 m south of the middle of a span to the east; the ground rises to the north."""
    lat_deg, lon_deg = ORIGIN.to_degrees(np.array([[-40.0, 0.0], [40.0, 0.0], [0.0, 0.0], [0.0, -AWAY_M]]))
    ends = (lat_deg[0], lon_deg[0], 12.0, lat_deg[1], lon_deg[1], 12.0)
    span = Span("S1", None, "T1", "T2", *ends, 80.0, 3)
    rules = load_rules(None)
    frame = {
        "lat_deg": lat_deg[3],
        "lon_deg": lon_deg[3],
        "height_m": HEIGHT_M,
        "cam_yaw_deg": 0.0,
        "cam_pitch_deg": PITCH_DEG,
        "cam_roll_deg": 0.0,
        "focal_px": FOCAL_PX,
        "width": 1280,
        "height": 720,
        "rise_m": -slope * AWAY_M if slope else None,
    }
    north_m = np.arange(-AWAY_M, 1.0, 5.0)
    samples = ORIGIN.to_degrees(np.column_stack((np.zeros(len(north_m)), north_m)))
    rises = np.column_stack((*samples, slope * north_m)) if slope else np.zeros((0, 3))
    anomaly = {"lat_deg": lat_deg[2], "lon_deg": lon_deg[2]}
    ((x, y, m_per_px),) = see_place(anomaly, span, [frame], rules, rises).tolist()
    below_m = HEIGHT_M - slope * AWAY_M - (12.0 - rules.coverage["sag_share"] * 80.0)
    down = np.arctan2(below_m, AWAY_M) + np.radians(PITCH_DEG)
    assert x == pytest.approx(640, abs=30)  # of the bin at the middle
    assert y == pytest.approx(360 + FOCAL_PX * np.tan(down), abs=3)
    assert m_per_px == pytest.approx(np.hypot(below_m, AWAY_M) * np.cos(down) / FOCAL_PX, rel=0.01)
