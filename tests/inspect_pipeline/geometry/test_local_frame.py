"""The local frame against pyproj: geodesics, and projections that PROJ computes another way."""

from __future__ import annotations

import numpy as np
import pyproj
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inspect_pipeline.geometry.local_frame import LocalMetres

EARTH = pyproj.Geod(ellps="WGS84")
ORIGINS = st.tuples(st.floats(-80, 80), st.floats(-180, 180))
WITHIN_10_KM = st.lists(st.tuples(st.floats(0, 360), st.floats(0, 10_000)), min_size=1, max_size=20)


@given(ORIGINS, WITHIN_10_KM)
def test_directions_and_distances_are_those_of_geodesics(
    origin: tuple[float, float], polar: list[tuple[float, float]]
) -> None:
    azimuth_deg, distance_m = np.array(polar).T
    lat, lon = np.full(len(polar), origin[0]), np.full(len(polar), origin[1])
    lon_deg, lat_deg, _ = EARTH.fwd(lon, lat, azimuth_deg, distance_m)
    wanted = distance_m * np.array([np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))])
    np.testing.assert_allclose(LocalMetres(*origin).to_metres(lat_deg, lon_deg).T, wanted, atol=1e-3)


@pytest.mark.parametrize("lat_deg", [-33.0, 0.0, 47.3, 60.0, 78.0])
def test_metres_are_those_of_the_azimuthal_equidistant_projection(lat_deg: float) -> None:
    aeqd = pyproj.Proj(proj="aeqd", lat_0=lat_deg, lon_0=11.0, ellps="WGS84")
    metres = np.random.default_rng(0).uniform(-10_000, 10_000, (100, 2))
    lon, lat = aeqd(*metres.T, inverse=True)
    np.testing.assert_allclose(LocalMetres(lat_deg, 11.0).to_metres(lat, lon), metres, atol=1e-3)


def test_near_the_origin_metres_are_those_of_the_tangent_plane() -> None:
    """The topocentric east and north of PROJ, from geocentric coordinates: no geodesics in it."""
    to_plane = pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=cart +ellps=WGS84"
        " +step +proj=topocentric +ellps=WGS84 +lat_0=52.1 +lon_0=5.1 +h_0=0"
    )
    lat, lon = LocalMetres(52.1, 5.1).to_degrees(np.array([[800.0, 0.0], [-300.0, 900.0], [0.0, -1000.0]]))
    east, north, _ = to_plane.transform(lon, lat, np.zeros(3))
    found = LocalMetres(52.1, 5.1).to_metres(lat, lon)
    np.testing.assert_allclose(found, np.column_stack((east, north)), atol=1e-3)


@given(ORIGINS, WITHIN_10_KM)
def test_there_and_back(origin: tuple[float, float], metres: list[tuple[float, float]]) -> None:
    frame = LocalMetres(*origin)
    np.testing.assert_allclose(frame.to_metres(*frame.to_degrees(np.array(metres))), metres, atol=1e-6)


def test_shapes_are_kept_and_unknown_positions_stay_unknown() -> None:
    frame = LocalMetres(52.0, 5.0)
    assert frame.to_metres(52.0, 5.0).tolist() == [0, 0]
    metres = frame.to_metres(np.array([[52.0, np.nan]]), np.array([[5.0, 5.0]]))
    assert metres.shape == (1, 2, 2)
    assert np.isnan(metres).tolist() == [[[False, False], [True, True]]]
    lat, lon = frame.to_degrees(np.array([3.0, 4.0]))
    assert (lat.shape, lon.shape) == ((), ())


def test_lengths_away_from_the_origin_are_kept_to_half_a_millimetre_per_kilometre() -> None:
    frame, rng = LocalMetres(47.3, 8.5), np.random.default_rng(0)
    starts = rng.uniform(-7_000, 7_000, (200, 2))
    steps = rng.uniform(-500, 500, (200, 2))
    (lat_a, lon_a), (lat_b, lon_b) = (frame.to_degrees(points) for points in (starts, starts + steps))
    _, _, true_m = EARTH.inv(lon_a, lat_a, lon_b, lat_b)
    assert np.abs(np.hypot(*steps.T) / true_m - 1).max() < 5e-7
