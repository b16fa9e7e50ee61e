"""Subtitles in the layouts of many models: one drone at 48.1 N 11.5 E that is 30 m above take-off."""

from __future__ import annotations

import math
from datetime import datetime

import pytest

from inspect_pipeline.convert.dji_srt import SubtitleBlock, Subtitles, parse_srt

WHERE = (48.1, 11.5)


def parse(body: str) -> Subtitles:
    return parse_srt(f"1\n00:00:02,500 --> 00:00:03,000\n{body}\n")


def only(body: str) -> SubtitleBlock:
    found = parse(body)
    assert found.problem is None
    (block,) = found.blocks
    return block


@pytest.mark.parametrize(
    ("body", "altitude_m", "height_m"),
    [
        ("GPS(48.1000,11.5000,0.0M) BAROMETER:30.0M", None, 30.0),  # Matrice 300
        ("GPS(48.100000,11.500000,550.5) BAROMETER(30.0) HOME(48.1,11.5)", 550.5, 30.0),  # Avata 2
        ("HOME(11.5000,48.1000) 2025.10.09 08:53:20\nGPS(11.5000,48.1000,15) BAROMETER:30.0", None, 30.0),
        (
            "GPS (11.500000, 48.100000, 16), D 2.0m, H 30.00m, H.S 1.00m/s, G.PRY (-45.0°, 0.0°, 90.0°)",
            None,
            30,
        ),
        ("F/2.8, SS 100, GPS (11.5, 48.1, 16), D 0.0m, H 30.00m, H.S 0.0m/s", None, 30.0),  # Phantom 4
        ("GPS(11.5000,48.1000,15) Hb:30.0 Hs:2.0", None, 30.0),  # Phantom 3
        ("[latitude: 48.1] [longitude: 11.5] [rel_alt: 30.000 abs_alt: 550.500]", 550.5, 30.0),
        ("[latitude : 48.1] [longtitude : 11.5] [altitude: 550.5]", 550.5, None),  # Mavic 2
        ("HOME(E: 11.5, N: 48.1)\nGPS(E: 11.500000, N: 48.100000, 550.50m)", 550.5, None),  # Autel
    ],
)
def test_positions_and_heights_by_layout(body: str, altitude_m: float | None, height_m: float | None) -> None:
    block = only(body)
    assert block.position is not None
    assert block.position[:2] == WHERE
    assert block.position.altitude_m == altitude_m or (altitude_m is None and math.isnan(block.position[2]))
    assert block.height_m == height_m
    assert block.offset_ns == 2_500_000_000


def test_letters_of_the_other_hemispheres() -> None:
    block = only("GPS(W: 58.4, S: 34.6, 20.0m)")
    assert block.position == (-34.6, -58.4, 20.0)


@pytest.mark.parametrize(
    ("body", "where"),
    [("GPS(-33.9,151.2,3)", (-33.9, 151.2)), ("GPS(151.2,-33.9,3)", (-33.9, 151.2))],
)
def test_an_unknown_layout_is_read_in_the_order_that_the_numbers_prove(
    body: str, where: tuple[float, float]
) -> None:
    assert only(body).position[:2] == where


def test_home_proves_the_order_too() -> None:
    assert only("GPS(80.0,89.0,3) HOME(80.0,91.0)").position[:2] == (80.0, 89.0)


def test_an_order_that_nothing_proves_is_refused() -> None:
    found = parse("GPS(48.1,11.5,3)")
    assert found.problem == "whether latitude or longitude comes first is not clear"
    assert found.blocks[0].position is None


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1\n2025.10.09 08:53:20,393\n[latitude: 48.1] [longitude: 11.5]\n", "it has no blocks with times"),
        ("1\n00:00:00,000 --> 00:00:01,000\nhello\n", "it has no positions in a known layout"),
        ("", "it has no blocks with times"),
    ],
)
def test_a_file_without_positions_says_why(text: str, problem: str) -> None:
    assert parse_srt(text).problem == problem


def test_gimbals() -> None:
    assert only("GPS (11.5, 48.1, 16), G.PRY (-45.0°, 1.0°, 90.0°)").gimbal == (90.0, -45.0, 1.0)
    fields = "[latitude: 48.1] [longitude: 11.5] [gb_yaw: 90.0 gb_pitch: -45.0 gb_roll: 1.0]"
    assert only(fields).gimbal == (90.0, -45.0, 1.0)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("2025.10.9 8:53:07", datetime(2025, 10, 9, 8, 53, 7)),
        ("2025-10-09 08:53:07.250", datetime(2025, 10, 9, 8, 53, 7, 250_000)),
        ("2025.10.09 08:53:07,393,525", datetime(2025, 10, 9, 8, 53, 7, 393_000)),
        ("2025.13.09 08:53:07", None),
    ],
)
def test_clocks(text: str, wanted: datetime | None) -> None:
    assert parse(text).blocks[0].clock == wanted


@pytest.mark.parametrize(
    ("body", "focal_35mm"),
    [
        ("[focal_len: 24.00] [dzoom_ratio: 1.00]", 24),
        ("[focal_len: 162.00]", 162),
        ("[focal_len : 240] [dzoom_ratio: 10000, delta:0]", 24),
        ("[focal_len : 280] [dzoom_ratio: 20000, delta:0]", 56),
        ("[focal_len: 24]", 24),
        ("[focal_len: 0]", None),
        (f"[focal_len: {'9' * 400}]", None),
        (f"[focal_len: 24.0] [dzoom_ratio: {'9' * 400}]", 24_000),
        ("[fnum: 2.8]", None),
    ],
)
def test_focal_lengths(body: str, focal_35mm: float | None) -> None:
    assert only(f"[latitude: 48.1] [longitude: 11.5] {body}").focal_35mm == focal_35mm
