"""Ends and gaps of conductors near the border of what a flight shows, on lines made by hand.

A camera 20 m above three conductors looks straight down; it shows 10 m to both sides, 50 px per metre.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inspect_rows import flight, rules, span

from inspect_pipeline.inspection.anomalies.find import Anomaly, find_anomalies
from inspect_pipeline.inspection.rows import LineRows

RULES = rules()
PX_PER_M, MIDDLE_PX, SHOWN_M = 50.0, 500.0, 10.0
ACROSS_M = (-4.0, 0.0, 4.0)
WHOLE = ((-1e3, 1e3),)


def found(
    along_m: np.ndarray, pieces: tuple[tuple[float, float], ...], length_m: float = 100.0
) -> list[Anomaly]:
    """Anomalies of a flight over a span whose middle conductor consists of pieces from and to some metres."""
    rows, tracks, points = [], [], []
    for row, at_m in enumerate(along_m):
        for track, across_m in enumerate(ACROSS_M):
            for piece in pieces if track == 1 else WHOLE:
                ends = np.clip(piece, at_m - SHOWN_M, at_m + SHOWN_M)
                if ends[0] < ends[1]:
                    rows.append(row)
                    tracks.append(track)
                    points += [
                        (MIDDLE_PX + PX_PER_M * across_m, MIDDLE_PX - PX_PER_M * (s - at_m)) for s in ends
                    ]
    lines = LineRows(np.array(rows), np.array(tracks), 2 * np.arange(len(rows) + 1), np.array(points))
    camera = flight(along_m, np.zeros(len(along_m), bool))
    return find_anomalies([replace(camera, lines=lines)], [span(length_m, expected=3)], RULES)


@pytest.mark.parametrize("length_m", [100.0, 100.0 - 1e-6])
def test_a_gap_of_two_bins_is_found_however_lengths_are_rounded(length_m: float) -> None:
    (one,) = found(np.arange(40.0, 60.0, 0.5), ((0.0, 49.8), (52.2, 100.0)), length_m)
    assert one.kind == "conductor_gap"
    assert "2 of 3 conductors for 2.0 m from 50 m" in one.reason


def test_the_interval_of_a_gap_is_one_visit_of_it() -> None:
    """Six frames over it, and eight when the drone comes back; far away in between."""
    away = np.linspace(20.0, 30.0, 10)
    along_m = np.concatenate((np.linspace(50.0, 52.0, 6), away, np.linspace(50.0, 52.0, 8)))
    (one,) = found(along_m, ((0.0, 50.0), (53.0, 100.0)))
    assert (one.kind, one.first_frame_idx, one.last_frame_idx) == ("conductor_gap", 16, 23)


def test_an_end_two_metres_before_the_end_of_the_view_is_found() -> None:
    (one,) = found(np.full(20, 50.0), ((0.0, 58.0),))
    assert one.kind == "conductor_lost"
    assert "2 of 3 conductors beyond 58 m" in one.reason


def test_a_gap_near_a_structure_is_no_end() -> None:
    (one,) = found(np.full(20, 92.0), ((0.0, 94.8), (97.2, 100.0)))
    assert one.kind == "conductor_gap"
