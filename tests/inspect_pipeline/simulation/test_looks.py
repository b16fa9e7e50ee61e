"""What weather and towers look like in the pictures, over plain ground of grey 90."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.simulation.options import SimulationOptions, TowerKind, WeatherKind
from inspect_pipeline.simulation.plan import plan_flight
from inspect_pipeline.simulation.write import simulate_flight

if TYPE_CHECKING:
    from pathlib import Path

SHOT_S = 8.0  # the pole at x = 55 is ahead of the camera at x = 40
POLE_X_M, POLE_M = 55.0, 12.5
HAZE = (198, 204, 210)


@pytest.fixture
def look_at(tmp_path: Path, flat_ground: None):
    def picture(**options: object) -> tuple[np.ndarray, object]:
        """The last picture of a flight, and its camera."""
        chosen = SimulationOptions(seconds=2 * SHOT_S, fps=1 / SHOT_S, seed=6, **options)
        plan = plan_flight(chosen)
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap"
        simulate_flight(path, chosen)
        *_, shot = plan.shots()
        *_, frame = iter_frames(open_recording(path))
        return frame.image.astype(np.float64), plan.camera(shot.time_ns)

    return picture


def colour_at(image: np.ndarray, camera, point: tuple[float, float, float]) -> np.ndarray:
    ((x, y),), _ = camera.project(np.array([point]))
    row, column = int(y), int(x)
    assert 2 < row < image.shape[0] - 2
    assert 2 < column < image.shape[1] - 2
    return np.median(image[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3), axis=0)


def test_haze_mixes_all_colours_with_its_own(look_at) -> None:
    clear, _ = look_at()
    hazy, _ = look_at(weather=WeatherKind.HAZE)
    for channel, colour in enumerate(HAZE):
        share, light = np.polyfit(clear[..., channel].ravel(), hazy[..., channel].ravel(), 1)
        assert 0.4 < share < 0.7
        assert light / (1 - share) == pytest.approx(colour, abs=8)


def test_the_shadow_of_a_pole_is_as_long_as_the_sun_is_low(look_at) -> None:
    """The shadow ends at the height of the pole times the cotangent of the sun's height."""
    clear, camera = look_at()
    low, same = look_at(weather=WeatherKind.LOW_SUN)
    assert np.array_equal(camera.position, same.position)
    for share in (0.2, 0.4):  # of the shadow when the sun is low, which is to the left and ahead
        x, y = POLE_X_M + share * POLE_M * 0.8 / 0.25, share * POLE_M * 0.55 / 0.25
        shaded, lit = colour_at(low, camera, (x, y, 0.0)), colour_at(clear, camera, (x, y, 0.0))
        assert shaded.mean() < 0.75 * lit.mean()
    x, y = POLE_X_M + 0.5 * POLE_M * 0.45 / 0.74, 0.5 * POLE_M * 0.5 / 0.74
    assert colour_at(clear, camera, (x, y, 0.0)).mean() < 0.75 * colour_at(low, camera, (x, y, 0.0)).mean()


def test_poles_are_brown_and_towers_stand_on_four_grey_legs(look_at) -> None:
    wood, camera = look_at()
    steel, _ = look_at(towers=TowerKind.STEEL)
    red, _, blue = colour_at(wood, camera, (POLE_X_M, 0.0, 5.0))
    assert red - blue > 12
    half_m = 1.1 + (0.35 - 1.1) * 5.0 / POLE_M  # its legs lean inwards
    legs = [
        colour_at(steel, camera, (POLE_X_M + i * half_m, j * half_m, 5.0)) for i in (-1, 1) for j in (-1, 1)
    ]
    assert all(blue >= red + 2 for red, _, blue in legs)
