"""Towers and insulators by their geometry."""

from __future__ import annotations

import numpy as np
import pytest

from lsnet.synth.pbr.hardware import DISC_M, PITCH_M, insulators, lattice_tower, pole

FOOT = np.array([10.0, -3.0, 2.0])


def test_a_pole_is_upright() -> None:
    assert pole(FOOT, 8.0, 0.2) == [((10.0, -3.0, 2.0), (10.0, -3.0, 10.0), 0.2)]


def test_a_tower_stands_on_a_square_and_tapers_to_a_third() -> None:
    rods = lattice_tower(FOOT, 30.0, 6.0, 5)
    assert len(rods) == 4 + 5 * 4 * 2
    legs = np.array([(start, end) for start, end, _ in rods[:4]]) - FOOT
    np.testing.assert_allclose(np.abs(legs[:, 0]), [[3, 3, 0]] * 4)
    np.testing.assert_allclose(np.abs(legs[:, 1]), [[1, 1, 30]] * 4)


def test_braces_cross_and_end_on_the_legs() -> None:
    for start, end, radius_m in lattice_tower(FOOT, 30.0, 6.0, 5)[4:]:
        for x, y, z in (start, end):
            half = 3 - 2 * (z - 2) / 30
            assert (abs(x - 10), abs(y + 3)) == pytest.approx((half, half))
        assert end[2] - start[2] == pytest.approx(6)
        assert radius_m == pytest.approx(0.09)


def test_insulator_string_has_evenly_spaced_discs() -> None:
    pin, *discs = insulators(FOOT, 7)
    assert pin[0] == (10.0, -3.0, 2.0)
    middles = [(start[2] + end[2]) / 2 - 2 for start, end, _ in discs]
    np.testing.assert_allclose(middles, PITCH_M * np.arange(1, 8))
    assert {radius_m for _, _, radius_m in discs} == {DISC_M}
