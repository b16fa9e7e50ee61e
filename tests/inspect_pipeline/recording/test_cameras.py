"""Which channels are cameras: judged by more than one first message, at the price of one pass."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from factories import CAMERA, START_NS, STEP_NS, Encoding, Shot, make_recording, ros2_cdr, shots

from inspect_pipeline.recording import cameras as recording_cameras
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path


def as_it_is(first: bytes) -> Encoding:
    """Images of sensor_msgs in CDR, but for the first message, which is `first`."""
    payloads = iter([first])

    def encode(stamp_ns: int, frame_id: str, image: bytes) -> bytes:
        return next(payloads, None) if stamp_ns < START_NS - STEP_NS else ros2_cdr(stamp_ns, frame_id, image)

    return Encoding("sensor_msgs/msg/CompressedImage", "ros2msg", b"", "cdr", encode)


def h264(count: int) -> list[bytes]:
    av = pytest.importorskip("av")
    codec = av.CodecContext.create("libx264", "w")
    codec.width, codec.height, codec.pix_fmt = 64, 48, "yuv420p"
    codec.framerate, codec.options = 10, {"bf": "0", "tune": "zerolatency", "repeat-headers": "1"}
    images = (np.full((48, 64, 3), 8 * i, np.uint8) for i in range(count))
    packets = [p for image in images for p in codec.encode(av.VideoFrame.from_ndarray(image, "rgb24"))]
    return [bytes(packet) for packet in [*packets, *codec.encode(None)]]


@pytest.mark.parametrize(
    "first",
    [
        b"",
        ros2_cdr(START_NS, "cam", b"\0\0\0\1\x67")[:30],
        ros2_cdr(START_NS, "cam", b""),
        ros2_cdr(START_NS, "cam", b"\xff\xd8\xff no picture"),
    ],
    ids=["empty", "cut", "empty image", "picture"],
)
def test_an_odd_first_message_does_not_cost_the_video(tmp_path: Path, first: bytes) -> None:
    before = Shot(0, CAMERA, START_NS - 10 * STEP_NS)
    video = [Shot(i, CAMERA, START_NS + i * STEP_NS, data) for i, data in enumerate(h264(10))]
    path = make_recording(tmp_path / "a.mcap", [before, *video], encoding=as_it_is(first))
    recording = open_recording(path)
    assert recording.video_channel_ids == {recording.camera_channels[0].channel_id}
    images = [frame.image is not None for frame in iter_frames(recording)]
    assert images == [False, *[True] * 10]


def test_a_video_that_begins_late_is_read_from_its_first_key_frame_on(tmp_path: Path) -> None:
    stills = shots(40)
    start_ns = START_NS + 40 * STEP_NS
    video = [Shot(i, CAMERA, start_ns + i * STEP_NS, data) for i, data in enumerate(h264(10))]
    recording = open_recording(make_recording(tmp_path / "a.mcap", [*stills, *video]))
    assert not recording.video_channel_ids  # no chunk of the first messages has any
    assert all(frame.image is not None for frame in iter_frames(recording))


def test_depth_in_compressed_images_is_not_a_camera(tmp_path: Path) -> None:
    def encode(stamp_ns: int, frame_id: str, image: bytes) -> bytes:
        whole = ros2_cdr(stamp_ns, frame_id, image)  # "rgb8; jpeg compressed bgr8"
        return whole.replace(b"rgb8; jpeg compressed bgr8", b"16UC1; png compressed bgr8")

    depth = Encoding("sensor_msgs/msg/CompressedImage", "ros2msg", b"", "cdr", encode)
    to_write = [shot for topic in ("/camera/depth/image/compressed", "/thermal") for shot in shots(3, topic)]
    recording = open_recording(make_recording(tmp_path / "a.mcap", to_write, encoding=depth))
    assert recording.refusals == {"/camera/depth/image/compressed": "it holds distances"}
    assert [camera.topic for camera in recording.camera_channels] == ["/thermal"]


def test_chunks_are_read_once_for_all_channels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    to_write = [Shot(0, f"/c{i}/image", START_NS + i, b"") for i in range(300)]
    path = make_recording(tmp_path / "a.mcap", to_write, n_gps_per_shot=0)
    read_extent, n_read = recording_cameras.read_extent, 0

    def count(*args) -> bytes:
        nonlocal n_read
        n_read += 1
        return read_extent(*args)

    monkeypatch.setattr(recording_cameras, "read_extent", count)
    recording = open_recording(path)
    assert len(recording.camera_channels) == 300
    assert n_read == len(recording.parts[0].layout.extents) > 2
