"""Write recordings of simulated flights along a drawn power line, or the photographs of such flights.

Images, positions, attitudes and calibrations go into the recording, the truth into a JSON file beside it. The
same options give the same pictures.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError
from inspect_pipeline.geometry.attitude import Quaternion
from inspect_pipeline.images.photograph import write_photograph
from inspect_pipeline.recording.ros2_writer import Ros2Author
from inspect_pipeline.recording.writer import new_recording
from inspect_pipeline.simulation.ground import draw_ground, lay_photograph
from inspect_pipeline.simulation.options import SchemaKind, SimulationOptions, WeatherKind
from inspect_pipeline.simulation.plan import POSE_PERIOD_NS, START_NS, plan_flight
from inspect_pipeline.simulation.records import FrameTruth
from inspect_pipeline.simulation.render import Landscape, render
from inspect_pipeline.simulation.scene import plant_trees
from inspect_pipeline.simulation.truth import compass_deg, to_east_north, to_geodetic, truth_of

if TYPE_CHECKING:
    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.recording.writer import RecordingAuthor
    from inspect_pipeline.simulation.plan import FlightPlan
    from inspect_pipeline.simulation.records import FlightTruth
    from inspect_pipeline.simulation.scene import SimulatedCamera

    Author = RecordingAuthor | Ros2Author

__all__ = ["SimulationOptions", "simulate_flight"]


class _Topics(NamedTuple):
    image: str
    calibration: str
    location: str
    vehicle: str
    camera: str


_TOPICS = {
    SchemaKind.FOXGLOVE: _Topics(
        "/camera/image", "/camera/calibration", "/drone/location", "/drone/attitude", "/camera/attitude"
    ),
    SchemaKind.ROS2: _Topics(
        "/camera/image/compressed", "/camera/camera_info", "/drone/fix", "/drone/pose", "/camera/pose"
    ),
}
_PACKED_TOPIC = "/camera/image/compressed"  # of photographs, after `pack`
_VIEW_M = (-5.0, 75.0)  # extent of the trees behind and ahead of the flight
_ARM_BEYOND_M = 0.2
_SUNS = {
    WeatherKind.CLEAR: (-0.45, -0.5, 0.74),
    WeatherKind.HAZE: (-0.45, -0.5, 0.74),
    WeatherKind.LOW_SUN: (-0.8, -0.55, 0.25),
}
_VEILS = {WeatherKind.CLEAR: 0.0, WeatherKind.HAZE: 0.45, WeatherKind.LOW_SUN: 0.1}  # of the light
_JPEG_QUALITY = 92


def simulate_flight(target: Path, options: SimulationOptions) -> Path:
    """Write a recording, or a folder of photographs, to `target` and the truth beside it: return its path.

    Raises OutputError when the target or a truth beside it exists, or cannot be written; LSNetError for a
    photograph that cannot be read, or without Mitsuba where that is asked for.
    """
    truth_path = target.parent / f"{target.stem}.truth.json"
    for path in (target, truth_path):
        if path.exists():
            raise OutputError(path, "it exists already", "remove it or name another file")
    plan = plan_flight(options)
    truth = truth_of(plan)
    try:
        if options.schema == SchemaKind.PHOTOGRAPHS:
            _take_photographs(target, plan, truth)
        else:
            is_ros2 = options.schema == SchemaKind.ROS2
            with new_recording(target, "ros2" if is_ros2 else "") as author:
                _fly(Ros2Author(author) if is_ros2 else author, plan, truth)
        with appearing(truth_path) as part:
            part.write_text(json.dumps(_to_json(truth)) + "\n", encoding="utf-8")
    except FileExistsError as error:
        raise OutputError(target, "it exists already", "remove it or name another file") from error
    except OSError as error:
        raise OutputError(target, f"cannot be written ({error.strerror})", "name another file") from error
    return truth_path


def _take_photographs(target: Path, plan: FlightPlan, truth: FlightTruth) -> None:
    """Write a JPEG for each frame, with its pose and nominal lens, by the camera's clock. Raises OSError."""
    rng = np.random.default_rng(plan.options.seed)
    landscape = _make_landscape(rng, plan)
    with tempfile.TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as scratch:
        folder = Path(scratch) / "photographs"
        folder.mkdir()
        for frame in truth.frames:
            if frame.frame_idx is not None:
                camera = plan.camera(frame.log_time_ns - START_NS)
                image = render(landscape, camera, frame.quality, rng, plan.options.render)
                row = {name: getattr(frame, name) for name in FrameTruth.__dataclass_fields__}
                write_photograph(
                    folder / f"{frame.frame_idx + 1:04d}.jpg", image, row | {"log_time_ns": frame.stamp_ns}
                )
        folder.rename(target)


def _fly(author: Author, plan: FlightPlan, truth: FlightTruth) -> None:
    """Write all messages in the order of their times."""
    topics = _TOPICS[plan.options.schema]
    rng = np.random.default_rng(plan.options.seed)
    landscape = _make_landscape(rng, plan)
    fixes_ns = set(plan.position_times_ns())
    next_ns = 0
    for frame in truth.frames:
        time_ns = frame.log_time_ns - START_NS
        while next_ns <= time_ns:
            _write_attitudes(author, topics, plan, next_ns)
            if next_ns in fixes_ns:
                _write_location(author, topics.location, plan, next_ns)
            next_ns += POSE_PERIOD_NS
        if not frame.dropped:
            camera = plan.camera(time_ns)
            _write_calibration(author, topics.calibration, frame, camera)
            _write_image(
                author,
                topics.image,
                frame,
                render(landscape, camera, frame.quality, rng, plan.options.render),
            )


def _make_landscape(rng: np.random.Generator, plan: FlightPlan) -> Landscape:
    route = plan.line.route
    flown = route.along(np.array([plan.pose(shot.time_ns).position[:2] for shot in plan.shots()]))
    sun = np.array(_SUNS[plan.options.weather])
    sun /= np.linalg.norm(sun)
    return Landscape(
        ground=_make_ground(rng, plan.options.ground),
        trees=plant_trees(rng, flown.min() + _VIEW_M[0], flown.max() + _VIEW_M[1], sun, route),
        conductors=(*plan.line.foreign, *plan.line.conductors),
        structures=plan.line.structures,
        route=route,
        crossarm_half_m=plan.line.half_width_m + _ARM_BEYOND_M,
        sun=sun,
        towers=plan.options.towers,
        veil=_VEILS[plan.options.weather],
    )


def _make_ground(rng: np.random.Generator, photograph: Path | None) -> ImageArray:
    if photograph is None:
        return draw_ground(rng)
    from lsnet.images import load_rgb  # noqa: PLC0415 - loads much

    return lay_photograph(load_rgb(photograph))


def _to_json(truth: FlightTruth) -> dict[str, Any]:
    """Return the ground truth as JSON values, with pixels rounded to a hundredth."""

    def plain(value: object) -> object:
        if isinstance(value, Path):
            return value.name
        return np.round(value, 2).tolist() if isinstance(value, np.ndarray) else value

    fields = asdict(truth, dict_factory=lambda items: {name: plain(value) for name, value in items})
    is_packed = truth.options.schema == SchemaKind.PHOTOGRAPHS
    return {"image_topic": _PACKED_TOPIC if is_packed else _TOPICS[truth.options.schema].image, **fields}


def _write_image(
    author: Author, topic: str, frame: FrameTruth, image: np.ndarray[Any, np.dtype[np.uint8]]
) -> None:
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1].tobytes()
    author.write_image(topic, frame.log_time_ns, "camera", data, "jpeg", stamp_ns=frame.stamp_ns)


def _write_calibration(author: Author, topic: str, frame: FrameTruth, camera: SimulatedCamera) -> None:
    height, width = camera.image_size
    author.write_calibration(
        topic,
        frame.log_time_ns,
        "camera",
        image_size=camera.image_size,
        focal_px=(camera.focal_px, camera.focal_px),
        centre_px=(width / 2, height / 2),
    )


def _write_location(author: Author, topic: str, plan: FlightPlan, time_ns: int) -> None:
    latitude_deg, longitude_deg, altitude_m = to_geodetic(
        plan, np.array(plan.recorded_pose(time_ns).position)
    )
    author.write_location(
        topic,
        START_NS + time_ns,
        "drone",
        latitude_deg=latitude_deg,
        longitude_deg=longitude_deg,
        altitude_m=altitude_m,
    )


def _write_attitudes(author: Author, topics: _Topics, plan: FlightPlan, time_ns: int) -> None:
    pose = plan.recorded_pose(time_ns)
    x, y, z = pose.position
    place_m = (*to_east_north(plan, x, y), z - plan.takeoff_m)
    for topic, child, yaw_rad, down_rad, roll_rad in (
        (topics.vehicle, "base_link", pose.heading_rad, 0.0, 0.0),
        (topics.camera, "camera_link", pose.yaw_rad, pose.pitch_rad, pose.roll_rad),
    ):
        east_yaw_rad = np.deg2rad(90 - compass_deg(plan, yaw_rad))
        # Independent of the code that reads quaternions, which is tested against what is written here.
        qx, qy, qz, qw = Rotation.from_euler("ZYX", (east_yaw_rad, down_rad, roll_rad)).as_quat().tolist()
        rotation = Quaternion(qw, qx, qy, qz)
        author.write_attitude(topic, START_NS + time_ns, "map", child, rotation, translation_m=place_m)
