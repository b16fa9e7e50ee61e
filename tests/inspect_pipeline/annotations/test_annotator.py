from __future__ import annotations

import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import factories
import numpy as np
import pytest
from factories import make_recording, shots
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.PointsAnnotation_pb2 import PointsAnnotation
from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from inspect_pipeline.annotations.annotator import FrameAnnotator
from inspect_pipeline.annotations.protobuf import (
    detections_schema,
    encode_detections,
    encode_image_annotations,
    image_annotations_schema,
)
from inspect_pipeline.recording.append import annotated_copy
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording
from inspect_pipeline.recording.types import Frame
from lsnet.segments import Detections, Lines, Segments

SCHEMAS = Path(__file__).parents[3] / "schemas"
STAMP_NS = 1_700_000_000_123_456_789
SIZE = (720, 1280)


def frame(error: str | None = None) -> Frame:
    image = None if error else np.zeros((*SIZE, 3), np.uint8)
    return Frame(1, "/cam", 300, STAMP_NS + 5, STAMP_NS + 6, STAMP_NS, "left", image, error)


def some_detections(n_segments: int, n_lines: int = 0) -> Detections:
    random = np.random.default_rng(n_segments)
    endpoints = random.uniform(-1, 1280, (n_segments, 4)).astype(np.float32)
    segments = Segments(endpoints, random.random(n_segments, np.float32), SIZE)
    points = tuple(random.uniform(0, 700, (2 + i, 2)).astype(np.float32) for i in range(n_lines))
    return Detections(segments, Lines(points, random.random(n_lines, np.float32), SIZE))


def message_class(schema: bytes, name: str):
    """The message class as any reader of the file would build it, from the schema in the file."""
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(schema).file:
        pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(name))


def test_lines_are_strips() -> None:
    detections = some_detections(9, n_lines=3)
    message = ImageAnnotations.FromString(encode_image_annotations(frame(), detections))
    assert [drawn.type for drawn in message.points] == [PointsAnnotation.LINE_STRIP] * 3
    for drawn, points in zip(message.points, detections.lines.points, strict=True):
        np.testing.assert_array_equal([(p.x, p.y) for p in drawn.points], points)
        assert drawn.timestamp.ToNanoseconds() == message.timestamp.ToNanoseconds() == STAMP_NS
        assert drawn.outline_color.a == 1


@pytest.mark.parametrize(("width", "thickness_px"), [(320, 2), (1000, 2), (2000, 4), (5472, 5472 / 500)])
def test_lines_are_as_thick_as_the_image_needs(width: int, thickness_px: float) -> None:
    size = (100, width)
    lines = Lines((np.zeros((2, 2), np.float32),), np.ones(1, np.float32), size)
    detections = Detections(Segments(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), size), lines)
    (drawn,) = ImageAnnotations.FromString(encode_image_annotations(frame(), detections)).points
    assert drawn.thickness == thickness_px


def test_colours_are_spread_from_the_least_score_to_1_and_are_not_those_of_foliage() -> None:
    scores = np.array([0.5, 0.6, 0.75, 0.9, 1.0], np.float32)
    lines = Lines(tuple(np.zeros((2, 2), np.float32) for _ in scores), scores, SIZE)
    detections = Detections(Segments(np.zeros((0, 4), np.float32), np.zeros(0, np.float32), SIZE), lines)
    message = ImageAnnotations.FromString(encode_image_annotations(frame(), detections, 0.5))
    colours = np.array([(c.r, c.g, c.b) for c in (drawn.outline_color for drawn in message.points)])
    assert ((colours >= 0) & (colours <= 1)).all()
    steps = np.linalg.norm(np.diff(colours, axis=0), axis=1)
    whole = np.linalg.norm(colours[-1] - colours[0])
    np.testing.assert_allclose(steps / whole, np.diff(scores) / 0.5, atol=0.02)
    assert whole > 0.5  # easy to distinguish
    assert (colours[:, 1] < colours[:, 2]).all()  # neither green nor yellow nor brown


@pytest.mark.parametrize("detections", [None, Detections.empty(SIZE), some_detections(9)])
def test_a_frame_without_lines_still_has_a_stamped_annotation(detections: Detections | None) -> None:
    bad = frame(error="the image is empty") if detections is None else frame()
    message = ImageAnnotations.FromString(encode_image_annotations(bad, detections))
    (drawn,) = message.points
    assert len(drawn.points) == 0
    assert message.timestamp.ToNanoseconds() == drawn.timestamp.ToNanoseconds() == STAMP_NS


@given(st.integers(0, 300), st.integers(0, 4), st.integers(0, 2**62))
def test_detections_come_back_without_loss(n_segments: int, n_lines: int, stamp_ns: int) -> None:
    detections = some_detections(n_segments, n_lines)
    given_frame = Frame(1, "/cam", 300, 1, 2, stamp_ns, "links ä", np.zeros((*SIZE, 3), np.uint8))
    decode = message_class(detections_schema(), "lsnet.Detections")
    message = decode.FromString(encode_detections(given_frame, detections))
    assert message.timestamp.ToNanoseconds() == stamp_ns
    assert (message.frame_id, message.frame_idx, message.error) == ("links ä", 300, "")
    assert (message.height, message.width) == SIZE
    endpoints = np.array([(s.x1, s.y1, s.x2, s.y2) for s in message.segments], np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(endpoints, detections.segments.endpoints)
    np.testing.assert_array_equal(
        np.array([s.score for s in message.segments], np.float32), detections.segments.scores
    )
    assert len(message.lines) == n_lines
    for line, points, score in zip(
        message.lines, detections.lines.points, detections.lines.scores, strict=True
    ):
        np.testing.assert_array_equal(np.array([(p.x, p.y) for p in line.points], np.float32), points)
        assert np.float32(line.score) == score


def test_a_bad_image_has_its_reason() -> None:
    message = message_class(detections_schema(), "lsnet.Detections").FromString(
        encode_detections(frame(error="the image is empty"), None)
    )
    assert message.error == "the image is empty"
    assert (message.height, message.width, len(message.segments)) == (0, 0, 0)


def test_the_image_annotations_schema_stands_alone() -> None:
    decode = message_class(image_annotations_schema(), "foxglove.ImageAnnotations")
    message = decode.FromString(encode_image_annotations(frame(), some_detections(3, n_lines=2)))
    assert [len(drawn.points) for drawn in message.points] == [2, 3]


def test_the_compiled_schema_agrees_with_the_proto_file() -> None:
    text = re.sub(r"//.*", "", (SCHEMAS / "lsnet_detections.proto").read_text())
    written = {
        (message, name, int(number)): (label or "", kind)
        for message, body in re.findall(r"message (\w+) \{(.*?)\}", text, re.DOTALL)
        for label, kind, name, number in re.findall(r"(repeated )?([\w.]+) (\w+) = (\d+);", body)
    }
    kinds = {
        FieldDescriptor.TYPE_FLOAT: "float",
        FieldDescriptor.TYPE_STRING: "string",
        FieldDescriptor.TYPE_UINT32: "uint32",
        FieldDescriptor.TYPE_UINT64: "uint64",
    }
    compiled = FileDescriptorSet.FromString((SCHEMAS / "lsnet_detections.binpb").read_bytes())
    (file,) = (file for file in compiled.file if file.package == "lsnet")
    found = {
        (message.name, field.name, field.number): (
            "repeated " if field.label == FieldDescriptor.LABEL_REPEATED else "",
            kinds.get(field.type) or field.type_name.removeprefix(".lsnet.").removeprefix("."),
        )
        for message in file.message_type
        for field in message.field
    }
    assert found == written


def test_the_compiled_schema_is_what_protoc_makes(tmp_path: Path) -> None:
    if find_spec("grpc_tools"):
        protoc = [sys.executable, "-m", "grpc_tools.protoc"]
    elif shutil.which("protoc"):
        protoc = ["protoc"]
    else:
        pytest.skip("neither grpcio-tools nor protoc is installed")
    target = tmp_path / "compiled.binpb"
    options = ["--include_imports", f"--descriptor_set_out={target}", f"-I{SCHEMAS}"]
    subprocess.run([*protoc, *options, "lsnet_detections.proto"], check=True)
    assert target.read_bytes() == (SCHEMAS / "lsnet_detections.binpb").read_bytes()


def test_frames_are_annotated_at_their_own_times(tmp_path: Path) -> None:
    to_write = [shot for i in range(6) for shot in (shots(6)[i], shots(6, "/right/image")[i])]
    source = make_recording(tmp_path / "a.mcap", to_write, n_gps_per_shot=0)
    recording = open_recording(source)
    with annotated_copy(recording, tmp_path / "b.mcap") as out:
        annotator = FrameAnnotator(out)
        for each in iter_frames(recording):
            annotator.write(each, some_detections(each.frame_idx))
    with (tmp_path / "b.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = list(reader.iter_decoded_messages())
    for topic in (factories.CAMERA, "/right/image"):
        images, drawn, found = (
            [m for m in decoded if m.channel.topic == topic + suffix]
            for suffix in ("", "/lsnet/annotations", "/lsnet/detections")
        )
        assert len(images) == len(drawn) == len(found) == 6
        for image, annotation, detection in zip(images, drawn, found, strict=True):
            stamp = image.decoded_message.timestamp
            assert annotation.message.log_time == detection.message.log_time == image.message.log_time
            assert annotation.message.publish_time == image.message.publish_time
            assert annotation.decoded_message.timestamp.ToNanoseconds() == stamp.ToNanoseconds()
            assert annotation.schema.name == "foxglove.ImageAnnotations"
            assert detection.decoded_message.frame_id == image.decoded_message.frame_id
        assert [len(m.decoded_message.segments) for m in found] == list(range(6))
