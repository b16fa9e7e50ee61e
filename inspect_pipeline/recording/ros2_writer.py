"""Write new recordings like those of ROS 2 drivers: sensor_msgs and geometry_msgs in CDR."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from inspect_pipeline.messages.cdr import CdrWriter
from inspect_pipeline.recording.writer import MessageSchema

if TYPE_CHECKING:
    from inspect_pipeline.geometry.attitude import Quaternion
    from inspect_pipeline.recording.writer import RecordingAuthor

_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\n"
    "bool do_rectify\n",
    "sensor_msgs/NavSatStatus": "int8 status\nuint16 service\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
}
_IMAGE, _CAMERA_INFO, _FIX, _POSE = (
    "std_msgs/Header header\nstring format\nuint8[] data\n",
    "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\nfloat64[] d\n"
    "float64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 binning_y\n"
    "sensor_msgs/RegionOfInterest roi\n",
    "std_msgs/Header header\nsensor_msgs/NavSatStatus status\nfloat64 latitude\nfloat64 longitude\n"
    "float64 altitude\nfloat64[9] position_covariance\nuint8 position_covariance_type\n",
    "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
)


def _schema(name: str, definition: str) -> MessageSchema:
    """Return a definition followed by those of its parts, which is the form of ros2msg."""
    text, added = definition, set[str]()
    while missing := [part for part in _PARTS if part not in added and f"{part} " in text]:
        for part in missing:
            added.add(part)
            text += f"{'=' * 80}\nMSG: {part}\n{_PARTS[part]}"
    return MessageSchema(name, "ros2msg", text.encode(), "cdr")


_IMAGE_SCHEMA = _schema("sensor_msgs/msg/CompressedImage", _IMAGE)
_CAMERA_INFO_SCHEMA = _schema("sensor_msgs/msg/CameraInfo", _CAMERA_INFO)
_FIX_SCHEMA = _schema("sensor_msgs/msg/NavSatFix", _FIX)
_POSE_SCHEMA = _schema("geometry_msgs/msg/PoseStamped", _POSE)


class Ros2Author:
    """Appends messages to a new recording of profile "ros2", as `RecordingAuthor` does."""

    def __init__(self, author: RecordingAuthor) -> None:
        self._author = author

    def write_image(
        self,
        topic: str,
        time_ns: int,
        frame_id: str,
        data: bytes,
        image_format: str,
        *,
        stamp_ns: int | None = None,
    ) -> None:
        """Append an encoded image as sensor_msgs/CompressedImage."""
        out = CdrWriter()
        out.header(time_ns if stamp_ns is None else stamp_ns, frame_id)
        out.text(image_format)
        out.blob(data)
        self._author.write_encoded(topic, time_ns, _IMAGE_SCHEMA, out.finish())

    def write_calibration(
        self,
        topic: str,
        time_ns: int,
        frame_id: str,
        *,
        image_size: tuple[int, int],
        focal_px: tuple[float, float],
        centre_px: tuple[float, float],
    ) -> None:
        """Append a pinhole camera without distortion as sensor_msgs/CameraInfo."""
        (fx, fy), (cx, cy) = focal_px, np.subtract(centre_px, 0.5)  # from the centre of the first pixel
        out = CdrWriter()
        out.header(time_ns, frame_id)
        for size in image_size:
            out.number("I", size)
        out.text("plumb_bob")
        out.sequence(np.zeros((5, 1)), "<f8")
        for matrix in ((fx, 0, cx, 0, fy, cy, 0, 0, 1), np.eye(3), (fx, 0, cx, 0, 0, fy, cy, 0, 0, 0, 1, 0)):
            out.numbers(np.asarray(matrix, np.float64), "<f8")
        for code in "IIIIIIB":  # binning and region of interest: none
            out.number(code, 0)
        self._author.write_encoded(topic, time_ns, _CAMERA_INFO_SCHEMA, out.finish())

    def write_location(
        self,
        topic: str,
        time_ns: int,
        frame_id: str,
        *,
        latitude_deg: float,
        longitude_deg: float,
        altitude_m: float,
    ) -> None:
        """Append a position (WGS 84, metres above the ellipsoid) as sensor_msgs/NavSatFix."""
        out = CdrWriter()
        out.header(time_ns, frame_id)
        out.number("b", 0)  # a fix,
        out.number("H", 1)  # by GPS
        for value in (latitude_deg, longitude_deg, altitude_m):
            out.number("d", value)
        out.numbers(np.zeros(9), "<f8")
        out.number("B", 0)  # nothing is known of its covariance
        self._author.write_encoded(topic, time_ns, _FIX_SCHEMA, out.finish())

    def write_attitude(
        self,
        topic: str,
        time_ns: int,
        parent_frame_id: str,
        child_frame_id: str,  # noqa: ARG002 - a pose has none: the topic says whose it is
        rotation: Quaternion,
        *,
        translation_m: tuple[float, float, float],
    ) -> None:
        """Append a rotation and a place in a frame as geometry_msgs/PoseStamped."""
        out = CdrWriter()
        out.header(time_ns, parent_frame_id)
        for value in (*translation_m, rotation.x, rotation.y, rotation.z, rotation.w):
            out.number("d", value)
        self._author.write_encoded(topic, time_ns, _POSE_SCHEMA, out.finish())
