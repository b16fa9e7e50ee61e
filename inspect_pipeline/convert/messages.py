"""The topics of packed recordings, and how poses are written to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from inspect_pipeline.geometry.attitude import Quaternion, to_enu

if TYPE_CHECKING:
    from collections.abc import Mapping

    from inspect_pipeline.geometry.attitude import Position, YawPitchRoll
    from inspect_pipeline.recording.writer import RecordingAuthor

CAMERA_FRAME, _GPS_FRAME, _WORLD_FRAME = "camera", "gps", "map"
_FIX_TOPIC, _ATTITUDE_TOPIC, _HEIGHT_TOPIC = "/gps/fix", "/camera/attitude", "/gps/height"
_NO_TURN = Quaternion(1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PackResult:
    """What a recording was made of: how many of each thing, and a warning for each thing left out."""

    counts: Mapping[str, int]
    warnings: tuple[str, ...] = ()


def write_pose(
    author: RecordingAuthor,
    time_ns: int,
    position: Position | None,
    gimbal: YawPitchRoll | None,
    height_m: float | None,
) -> None:
    """Append what is known of a pose; height_m is above take-off, the origin of the frame `map`."""
    if position:
        author.write_location(
            _FIX_TOPIC,
            time_ns,
            _GPS_FRAME,
            latitude_deg=position.latitude_deg,
            longitude_deg=position.longitude_deg,
            altitude_m=position.altitude_m,
        )
    place_m = (0.0, 0.0, height_m or 0.0)
    if height_m is not None:
        author.write_attitude(
            _HEIGHT_TOPIC, time_ns, _WORLD_FRAME, _GPS_FRAME, _NO_TURN, translation_m=place_m
        )
    if gimbal:
        author.write_attitude(
            _ATTITUDE_TOPIC, time_ns, _WORLD_FRAME, CAMERA_FRAME, to_enu(gimbal), translation_m=place_m
        )


def write_lens(
    author: RecordingAuthor, topic: str, time_ns: int, image_size: tuple[int, int], focal_px: float
) -> None:
    """Append a nominal lens of images (height, width), with its centre in the middle."""
    height, width = image_size
    author.write_calibration(
        topic,
        time_ns,
        CAMERA_FRAME,
        image_size=image_size,
        focal_px=(focal_px, focal_px),
        centre_px=(width / 2, height / 2),
        is_nominal=True,
    )
