"""Numbers of other topics at the times of frames, from messages that other libraries encoded."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from factories import ROS1, ROS2
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from mcap.writer import Writer
from mcap_protobuf.schema import build_file_descriptor_set

from inspect_pipeline.georeference.signals import read_signals
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

    from rosbags.typesys.store import Typestore

S = 1_000_000_000
PATHS = {"charge": "/battery.percentage", "cell": "/battery.cell_voltage[1]"}


def record(
    path: Path, topic: str, schema: tuple[str, str, bytes], encoding: str, data: dict[int, bytes]
) -> Any:
    """A recording with one topic and the messages of each second; opened."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(topic, encoding, writer.register_schema(*schema))
        for second, payload in data.items():
            writer.add_message(channel, second * S, payload, second * S)
        writer.finish()
    return open_recording(path)


def battery(store: Typestore, percentage: float) -> Any:
    """A sensor_msgs/BatteryState with strings, enumerations and sequences around its numbers."""
    kind = store.types["sensor_msgs/msg/BatteryState"]
    values: dict[str, Any] = dict.fromkeys(kind.__dataclass_fields__, 0)
    time = store.types["builtin_interfaces/msg/Time"](1, 2)
    header = store.types["std_msgs/msg/Header"]
    values["header"] = header(5, time, "a") if store is ROS1 else header(time, "a")
    floats = np.array([3.5, percentage / 10], np.float32)
    values |= {"percentage": percentage, "cell_voltage": floats, "location": "bay", "serial_number": "x7"}
    if "cell_temperature" in values:
        values["cell_temperature"] = floats
    return kind(**{name: value for name, value in values.items() if name != "__msgtype__"})


@pytest.mark.parametrize(("store", "encoding"), [(ROS1, "ros1"), (ROS2, "cdr")])
def test_a_message_of_ros_is_read_by_its_definition(tmp_path: Path, store: Typestore, encoding: str) -> None:
    name = "sensor_msgs/msg/BatteryState"
    definition, _ = store.generate_msgdef(name, ros_version=1 if store is ROS1 else 2)
    serialize = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    data = {second: bytes(serialize(battery(store, 90.0 - second), name)) for second in (10, 12)}
    schema = (name, f"ros{1 if store is ROS1 else 2}msg", definition.encode())
    signals = read_signals(record(tmp_path / "a.mcap", "/battery", schema, encoding, data), PATHS)
    assert signals.at(9 * S) == {"charge": None, "cell": None}
    assert signals.at(10 * S)["charge"] == 80
    assert signals.at(12 * S - 1)["charge"] == 80
    assert signals.at(13 * S) == {"charge": 78, "cell": pytest.approx(7.8)}
    assert signals.at(22 * S)["charge"] == 78
    assert signals.at(22 * S + 1)["charge"] is None  # more than ten seconds old
    assert not signals.warnings


def test_nested_protobuf_and_json(tmp_path: Path) -> None:
    message = FrameTransform()
    message.translation.y = 2.5
    schema = (
        "foxglove.FrameTransform",
        "protobuf",
        build_file_descriptor_set(FrameTransform).SerializeToString(),
    )
    recording = record(tmp_path / "p.mcap", "/tf", schema, "protobuf", {1: message.SerializeToString()})
    assert read_signals(recording, {"y": "/tf.translation.y"}).at(S) == {"y": 2.5}
    values = [
        {"wind": {"speed": [1, True, 3.5]}},
        {"wind": {"speed": None}},
        {"wind": {"speed": [1, 2, float("nan")]}},
    ]
    data = {second: json.dumps(value).encode() for second, value in enumerate(values, 1)}
    data[4] = b"no JSON"
    recording = record(tmp_path / "j.mcap", "/a.b", ("Wind", "jsonschema", b"{}"), "json", data)
    found = read_signals(recording, {"w": "/a.b.wind.speed[2]", "on": "/a.b.wind.speed[1]"})
    assert found.at(5 * S) == {"w": 3.5, "on": 2}


def test_what_is_missing_is_a_warning(tmp_path: Path) -> None:
    json_schema = ("Wind", "jsonschema", b"{}")
    recording = record(tmp_path / "j.mcap", "/wind", json_schema, "json", {1: b'{"speed": "fast"}'})
    found = read_signals(
        recording, {"a": "/wind.speed", "b": "/wind.gust[0].x", "c": "/rain.mm", "d": "/wind"}
    )
    assert set(found.at(S).values()) == {None}
    assert [warning.split(":")[0] for warning in found.warnings] == [f"signal {name}" for name in "abcd"]
    assert "no message of /wind has a number at .speed" in found.warnings[0]
    assert "no topic" in found.warnings[2]
    flat = record(tmp_path / "f.mcap", "/wind", ("Wind", "flatbuffer", b""), "flatbuffer", {1: b"1234"})
    assert "an encoding that is not read" in read_signals(flat, {"a": "/wind.speed"}).warnings[0]


def test_damaged_messages_and_definitions_are_passed_over(tmp_path: Path) -> None:
    endless = b"pkg/Endless[] inside\n====\nMSG: pkg/Endless\npkg/Endless[] inside\n"
    hostile = {1: b"\0\1\0\0" + b"\xff" * 8, 2: b"", 3: b"\0\1\0\0" + b"\1\0\0\0" * 5000}
    recording = record(tmp_path / "e.mcap", "/e", ("pkg/msg/Endless", "ros2msg", endless), "cdr", hostile)
    assert read_signals(recording, {"a": "/e.inside[0]"}).at(3 * S) == {"a": None}
    half = ("pkg/msg/Half", "ros2msg", b"float64 before\nother/Thing thing\nfloat64 after\n")
    recording = record(
        tmp_path / "h.mcap", "/h", half, "cdr", {1: b"\0\1\0\0" + np.array([4.0, 5.0]).tobytes()}
    )
    assert read_signals(recording, {"b": "/h.before", "c": "/h.after"}).at(S) == {"b": 4.0, "c": None}
