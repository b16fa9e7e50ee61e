"""Recordings of flights that never were: a drawn line over a drawn landscape, and where its conductors are.

The drone flies along the line, above it and to its side, and looks ahead and down. Images, positions and the
camera's calibration go into the recording; the truth, in pixels, into a JSON file beside it. The same options
give the same pictures.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from inspect_pipeline.authoring import new_recording
from inspect_pipeline.errors import OutputError
from inspect_pipeline.simulate_ground import draw_ground
from inspect_pipeline.simulate_render import Landscape, render
from inspect_pipeline.simulate_scene import (
    Camera,
    conductors,
    look,
    plant_trees,
    pole_positions,
    visible_runs,
)

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.authoring import RecordingAuthor

IMAGE_TOPIC, CALIBRATION_TOPIC, LOCATION_TOPIC = "/camera/image", "/camera/calibration", "/drone/location"
_START_NS = 1_777_887_000 * 10**9  # 2026-05-04 09:30 UTC
_GPS_PERIOD_NS = 100_000_000
_SPEED_M_S = 5.0
_HEIGHT_M, _SIDE_M = 23.0, -7.0
_VIEW_M = (-5.0, 75.0)  # what the camera may see, behind and ahead of the drone
_ORIGIN_DEG, _GROUND_M = (52.09, 5.12), 43.0  # of x = y = z = 0
_METRES_PER_DEG = 111_320.0  # of latitude
_JPEG_QUALITY = 92
_TRUTH_STEP_PX = 12.0


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """How long, how often, how large (height, width), and which landscape."""

    seconds: float = 20.0
    fps: float = 2.0
    image_size: tuple[int, int] = (720, 1280)
    seed: int = 0


@dataclass(frozen=True, slots=True)
class Pose:
    """Where the drone is, in m, and where its camera looks."""

    position: tuple[float, float, float]
    yaw_rad: float
    pitch_rad: float


def simulate_flight(target: Path, options: SimulationOptions) -> Path:
    """Write a recording to `target` and the truth beside it, whose path is returned.

    Raises OutputError when the target exists or cannot be written.
    """
    truth_path = target.with_suffix(".truth.json")
    try:
        with new_recording(target) as author:
            frames = _fly(author, options)
        truth = {"image_topic": IMAGE_TOPIC, "options": asdict(options), "frames": frames}
        truth_path.write_text(json.dumps(truth) + "\n", encoding="utf-8")
    except FileExistsError as error:
        raise OutputError(target, "it exists already", "remove it or name another file") from error
    except OSError as error:
        raise OutputError(target, f"cannot be written ({error.strerror})", "name another file") from error
    return truth_path


def _fly(author: RecordingAuthor, options: SimulationOptions) -> list[dict[str, Any]]:
    """Write all messages in the order of time; return the truth of each frame."""
    rng = np.random.default_rng(options.seed)
    landscape = _make_landscape(rng, options.seconds)
    frames = []
    next_gps_ns = 0
    for i in range(max(1, round(options.seconds * options.fps))):
        time_ns = round(i / options.fps * 1e9)
        while next_gps_ns <= time_ns:
            _write_location(author, next_gps_ns)
            next_gps_ns += _GPS_PERIOD_NS
        camera = _camera(time_ns, options.image_size)
        _write_calibration(author, time_ns, camera)
        _write_image(author, time_ns, render(landscape, camera, rng))
        frames.append(
            {"frame_idx": i, "log_time_ns": _START_NS + time_ns, "lines": _truth(landscape, camera)}
        )
    return frames


def _make_landscape(rng: np.random.Generator, seconds: float) -> Landscape:
    first_m, last_m = _VIEW_M[0], _SPEED_M_S * seconds + _VIEW_M[1]
    sun = np.array([-0.45, -0.5, 0.74])
    sun /= np.linalg.norm(sun)
    return Landscape(
        ground=draw_ground(rng),
        trees=plant_trees(rng, first_m, last_m, sun),
        conductors=conductors(first_m, last_m),
        poles=pole_positions(first_m, last_m).tolist(),
        sun=sun,
    )


def pose_at(time_ns: int) -> Pose:
    """Where the drone is: steady along the line, swaying a little."""
    t = time_ns / 1e9
    return Pose(
        position=(
            _SPEED_M_S * t,
            _SIDE_M + 0.5 * np.sin(0.5 * t),
            _HEIGHT_M + 0.4 * np.sin(0.37 * t + 1),
        ),
        yaw_rad=np.deg2rad(14 + 2.5 * np.sin(0.43 * t)),
        pitch_rad=np.deg2rad(47 + 1.5 * np.sin(0.6 * t + 2)),
    )


def _camera(time_ns: int, image_size: tuple[int, int]) -> Camera:
    pose = pose_at(time_ns)
    focal_px = 0.95 * image_size[1]
    return look(np.array(pose.position), pose.yaw_rad, pose.pitch_rad, focal_px, image_size)


def _truth(landscape: Landscape, camera: Camera) -> list[dict[str, Any]]:
    """The visible conductors as polylines in pixels, with their width in pixels at each point."""
    lines = []
    for conductor in landscape.conductors:
        for pixels, widths_px in visible_runs(camera, conductor):
            walked_px = np.concatenate(([0.0], np.hypot(*np.diff(pixels, axis=0).T).cumsum()))
            _, kept = np.unique(walked_px // _TRUTH_STEP_PX, return_index=True)
            kept = np.union1d(kept, [len(pixels) - 1])
            lines.append(
                {"points": pixels[kept].round(2).tolist(), "width_px": widths_px[kept].round(2).tolist()}
            )
    return lines


def _write_image(author: RecordingAuthor, time_ns: int, image: np.ndarray[Any, np.dtype[np.uint8]]) -> None:
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
    author.write_image(IMAGE_TOPIC, _START_NS + time_ns, "camera", data, "jpeg")


def _write_calibration(author: RecordingAuthor, time_ns: int, camera: Camera) -> None:
    height, width = camera.image_size
    author.write_calibration(
        CALIBRATION_TOPIC,
        _START_NS + time_ns,
        "camera",
        image_size=camera.image_size,
        focal_px=(camera.focal_px, camera.focal_px),
        centre_px=(width / 2, height / 2),
    )


def _write_location(author: RecordingAuthor, time_ns: int) -> None:
    x, y, z = pose_at(time_ns).position
    latitude_deg, longitude_deg = _ORIGIN_DEG
    author.write_location(
        LOCATION_TOPIC,
        _START_NS + time_ns,
        "drone",
        latitude_deg=latitude_deg + y / _METRES_PER_DEG,
        longitude_deg=longitude_deg + x / (_METRES_PER_DEG * np.cos(np.deg2rad(latitude_deg))),
        altitude_m=_GROUND_M + z,
    )
