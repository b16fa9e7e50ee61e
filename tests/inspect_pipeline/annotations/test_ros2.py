"""Annotations as ROS 2 messages, taken apart by rosbags with the definitions that stand in the file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from factories import CAMERA, STAMP_LAG_NS, START_NS, make_recording, make_recording_with_rosbags, shots
from fakes import FakeDetector
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from inspect_pipeline.annotations.annotator import FrameAnnotator, message_format
from inspect_pipeline.annotations.ros2 import ROS2, encode_detections, encode_image_annotations
from inspect_pipeline.config import ProcessOptions, start_run
from inspect_pipeline.pipeline import process
from inspect_pipeline.recording.append import annotated_copy, sidecar
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.types import Frame
from inspect_pipeline.store.store import Store
from lsnet.segments import Detections, Lines, Segments

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.config import SchemaName
    from inspect_pipeline.store.records import ProcessResult

SIZE = (720, 1280)
STAMP_NS = 1_700_000_000_123_456_789


def store_of(name: str, definition: str) -> Any:
    """A type store that knows a message and those it is made of, by the text in the file."""
    store = get_typestore(Stores.EMPTY)
    first, *others = re.split(r"^=+\nMSG: (.*)\n", definition, flags=re.MULTILINE)
    types = get_types_from_msg(first, name)
    for other, text in zip(others[::2], others[1::2], strict=True):
        package, _, kind = other.partition("/")
        types |= get_types_from_msg(text, f"{package}/msg/{kind}")
    store.register(types)
    return store


ANNOTATIONS, DETECTIONS = (store_of(schema.name, schema.data().decode()) for schema in ROS2)


def frame(stamp_ns: int = STAMP_NS, frame_id: str = "left", error: str | None = None) -> Frame:
    image = None if error else np.zeros((*SIZE, 3), np.uint8)
    return Frame(1, "/cam", 300, stamp_ns + 5, stamp_ns + 6, stamp_ns, frame_id, image, error)


def some_detections(n_segments: int, n_lines: int = 0) -> Detections:
    random = np.random.default_rng(n_segments)
    endpoints = random.uniform(-1, 1280, (n_segments, 4)).astype(np.float32)
    segments = Segments(endpoints, random.random(n_segments, np.float32), SIZE)
    points = tuple(random.uniform(0, 700, (2 + i, 2)).astype(np.float32) for i in range(n_lines))
    return Detections(segments, Lines(points, random.random(n_lines, np.float32), SIZE))


def ns(time: Any) -> int:
    return time.sec * 10**9 + time.nanosec


@given(st.integers(0, 30), st.integers(0, 4), st.integers(0, 2**31 * 10**9 - 1), st.text(max_size=9))
@settings(max_examples=60)
def test_detections_come_back_without_loss(
    n_segments: int, n_lines: int, stamp_ns: int, frame_id: str
) -> None:
    detections = some_detections(n_segments, n_lines)
    data = encode_detections(frame(stamp_ns, frame_id), detections)
    message = DETECTIONS.deserialize_cdr(data, "lsnet_msgs/msg/Detections")
    assert (ns(message.timestamp), message.frame_id, message.frame_idx) == (stamp_ns, frame_id, 300)
    assert (message.height, message.width, message.error) == (*SIZE, "")
    endpoints = np.array([(s.x1, s.y1, s.x2, s.y2) for s in message.segments], np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(endpoints, detections.segments.endpoints)
    scores = np.array([s.score for s in message.segments], np.float32)
    np.testing.assert_array_equal(scores, detections.segments.scores)
    for line, points, score in zip(
        message.lines, detections.lines.points, detections.lines.scores, strict=True
    ):
        np.testing.assert_array_equal(np.array([(p.x, p.y) for p in line.points], np.float32), points)
        assert np.float32(line.score) == score
    again = DETECTIONS.serialize_cdr(message, "lsnet_msgs/msg/Detections")
    assert bytes(again).rstrip(b"\0") == data.rstrip(b"\0")  # to the byte, but for the padding at the end


def test_a_bad_image_has_its_reason() -> None:
    data = encode_detections(frame(error="the image is empty"), None)
    message = DETECTIONS.deserialize_cdr(data, "lsnet_msgs/msg/Detections")
    assert (message.error, len(message.segments), message.width) == ("the image is empty", 0, 0)


@pytest.mark.parametrize("n_lines", [0, 3])
@pytest.mark.parametrize("n_segments", [0, 1, 200])
def test_image_annotations_equal_those_in_protobuf(n_segments: int, n_lines: int) -> None:
    """The same picture as in foxglove.ImageAnnotations, which is tested by itself."""
    from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations  # noqa: PLC0415

    from inspect_pipeline.annotations import protobuf as annotations_protobuf  # noqa: PLC0415

    detections = some_detections(n_segments, n_lines)
    data = encode_image_annotations(frame(), detections)
    message = ANNOTATIONS.deserialize_cdr(data, "foxglove_msgs/msg/ImageAnnotations")
    expected = ImageAnnotations.FromString(annotations_protobuf.encode_image_annotations(frame(), detections))
    assert (len(message.circles), len(message.texts)) == (0, 0)
    assert len(message.points) == len(expected.points) == (n_lines or 1)
    for drawn, other in zip(message.points, expected.points, strict=True):
        assert ns(drawn.timestamp) == STAMP_NS
        assert (drawn.type, drawn.thickness) == (other.type, other.thickness)
        assert [(p.x, p.y) for p in drawn.points] == [(p.x, p.y) for p in other.points]
        assert rgba(drawn.outline_color) == rgba(other.outline_color)
        assert len(drawn.outline_colors) == len(other.outline_colors) == 0
        assert rgba(drawn.fill_color) == rgba(other.fill_color)


def rgba(colour: Any) -> tuple[float, float, float, float]:
    return colour.r, colour.g, colour.b, colour.a


def test_a_stamp_after_2038_is_its_last_second() -> None:
    data = encode_detections(frame(2**62), some_detections(1))
    assert DETECTIONS.deserialize_cdr(data, "lsnet_msgs/msg/Detections").timestamp.sec == 2**31 - 1


@pytest.mark.parametrize("write", [annotated_copy, sidecar])
def test_an_annotated_bag_has_only_cdr_messages(tmp_path: Path, write: Any) -> None:
    """All its messages are CDR: players refuse bags of several encodings."""
    recording = open_recording(make_recording_with_rosbags(tmp_path / "bag", shots(4)))
    target = tmp_path / "annotated.mcap"
    with write(recording, target) as out:
        annotator = FrameAnnotator(out, "ros2msg")
        for each in iter_frames(recording):
            annotator.write(each, some_detections(each.frame_idx))
    with target.open("rb") as file:
        channels = list(make_reader(file).get_summary().channels.values())
        file.seek(0)
        found = [
            (channel, store_of(schema.name, schema.data.decode()), schema.name, message)
            for schema, channel, message in make_reader(file).iter_messages()
            if channel.topic.startswith(f"{CAMERA}/lsnet/")
        ]
    assert {(c.message_encoding, "offered_qos_profiles" in c.metadata) for c in channels} == {("cdr", True)}
    assert len(found) == 8
    for channel, store, name, message in found:
        decoded = store.deserialize_cdr(message.data, name)
        stamped = decoded.points[0] if channel.topic.endswith("annotations") else decoded
        assert ns(stamped.timestamp) == message.log_time - STAMP_LAG_NS


@pytest.mark.parametrize(
    ("schema", "profile", "expected"),
    [
        ("auto", "ros2", "ros2msg"),
        ("auto", "", "protobuf"),
        ("auto", "ros1", "protobuf"),
        ("protobuf", "ros2", "protobuf"),
        ("ros2msg", "", "ros2msg"),
    ],
)
def test_the_format_of_annotations_is_that_of_the_recording(
    schema: SchemaName, profile: str, expected: str
) -> None:
    assert message_format(schema, profile) == expected


def test_rosbags_opens_an_annotated_bag(tmp_path: Path) -> None:
    """It refuses bags with protobuf beside CDR."""
    bag = make_recording_with_rosbags(tmp_path / "bag", shots(4))
    result = run(bag, tmp_path)
    assert result.warnings == ()
    with AnyReader([result.annotated]) as reader:
        topics = [connection.topic for connection, _, _ in reader.messages()]
    assert sorted(set(topics)) == [CAMERA, f"{CAMERA}/lsnet/annotations", f"{CAMERA}/lsnet/detections"]
    assert len(topics) == 12


def test_ros2_messages_in_another_recording_are_warned_of(tmp_path: Path) -> None:
    path = make_recording(tmp_path / "a.mcap", shots(2))
    (warning,) = run(path, tmp_path, schema="ros2msg").warnings
    assert "players of ROS 2 bags do not open its annotated copy either: it has profile 'test'" in warning
    assert run(path, tmp_path, schema="ros2msg", write="sidecar", force=True).warnings == ()
    assert run(path, tmp_path, force=True).warnings == ()


def run(path: Path, folder: Path, **options: Any) -> ProcessResult:
    detector, asked = FakeDetector(), ProcessOptions(**options)
    return process(path, Store(folder / "store"), detector, asked, start_run(detector, asked))


def test_the_annotator_writes_protobuf_by_default(tmp_path: Path) -> None:
    recording = open_recording(make_recording(tmp_path / "a.mcap", shots(1)))
    with annotated_copy(recording, tmp_path / "b.mcap") as out:
        FrameAnnotator(out).write(next(iter_frames(recording)), some_detections(1))
    added = [c for c in open_recording(tmp_path / "b.mcap").channels if "/lsnet/" in c.topic]
    assert [c.message_encoding for c in added] == ["protobuf"] * 2
    assert open_recording(tmp_path / "b.mcap").start_ns == START_NS
