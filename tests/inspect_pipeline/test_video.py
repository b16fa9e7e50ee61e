from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import factories
import numpy as np
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo

from inspect_pipeline.recording import open_recording
from inspect_pipeline.recording_frames import iter_frames
from inspect_pipeline.video import is_key_frame

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

av = pytest.importorskip("av")

N_PICTURES, KEY_EVERY = 24, 8
ENCODERS = {
    "h264": ("libx264", {"bf": "0", "tune": "zerolatency", "preset": "ultrafast"}),
    "h265": ("libx265", {"x265-params": "bframes=0:repeat-headers=1:log-level=none", "preset": "ultrafast"}),
    "vp9": ("libvpx-vp9", {"deadline": "realtime", "lag-in-frames": "0", "auto-alt-ref": "0"}),
    "av1": ("libsvtav1", {"preset": "12", "svtav1-params": "pred-struct=1:lp=1"}),
}


def grey_of(number: int) -> int:
    """Each picture is of one brightness, far enough from the next to survive coding."""
    return 30 + 8 * number


def encode(codec: str, n_pictures: int = N_PICTURES) -> list[bytes]:
    """A packet per picture, a key frame every `KEY_EVERY`."""
    name, options = ENCODERS[codec]
    encoder = av.CodecContext.create(name, "w")
    encoder.width, encoder.height, encoder.pix_fmt = 128, 96, "yuv420p"
    encoder.time_base, encoder.framerate, encoder.gop_size = Fraction(1, 10), Fraction(10), KEY_EVERY
    encoder.options = options
    packets = []
    for i in range(n_pictures):
        frame = av.VideoFrame.from_ndarray(np.full((96, 128, 3), grey_of(i), np.uint8), format="rgb24")
        frame.pts = i
        packets += encoder.encode(frame.reformat(format="yuv420p"))
    packets += encoder.encode(None)
    return [bytes(packet) for packet in packets]


def protobuf(codec: str) -> factories.Encoding:
    def message(stamp_ns: int, frame_id: str, data: bytes) -> bytes:
        video = CompressedVideo(frame_id=frame_id, data=data, format=codec)
        video.timestamp.FromNanoseconds(stamp_ns)
        return video.SerializeToString()

    return factories.Encoding("foxglove.CompressedVideo", "protobuf", b"", "protobuf", message)


def record(path: Path, packets: dict[int, bytes], encoding: factories.Encoding | str) -> Path:
    """A recording of packets by their number."""
    to_write = [Shot(i, CAMERA, START_NS + i * STEP_NS, data) for i, data in packets.items()]
    return make_recording(path, to_write, encoding=encoding)


def looks_like(image: NDArray[np.uint8] | None) -> int:
    assert image is not None
    assert image.shape == (96, 128, 3)
    return round((float(image.mean()) - 30) / 8)


@pytest.mark.parametrize("codec", ENCODERS)
def test_every_picture_of_a_video_is_decoded(tmp_path: Path, codec: str) -> None:
    packets = encode(codec)
    assert len(packets) == N_PICTURES
    recording = open_recording(record(tmp_path / "a.mcap", dict(enumerate(packets)), protobuf(codec)))

    frames = list(iter_frames(recording))
    assert [looks_like(frame.image) for frame in frames] == list(range(N_PICTURES))
    assert frames[3].stamp_ns == START_NS + 3 * STEP_NS - factories.STAMP_LAG_NS


@pytest.mark.parametrize("codec", ENCODERS)
def test_pictures_stand_on_those_before_them(tmp_path: Path, codec: str) -> None:
    recording = open_recording(record(tmp_path / "a.mcap", dict(enumerate(encode(codec))), protobuf(codec)))

    frames = list(iter_frames(recording, every=5))
    assert [(frame.frame_idx, looks_like(frame.image)) for frame in frames] == [
        (i, i) for i in range(0, 24, 5)
    ]
    frames = list(iter_frames(recording, start_ns=START_NS + 14 * STEP_NS, end_ns=START_NS + 18 * STEP_NS))
    assert [(frame.frame_idx, looks_like(frame.image)) for frame in frames] == [(i, i) for i in range(14, 18)]


@pytest.mark.parametrize("codec", ENCODERS)
def test_key_frames_are_known(codec: str) -> None:
    name = {"h265": "hevc", "av1": "libdav1d"}.get(codec, codec)
    keys = [i for i, data in enumerate(encode(codec)) if is_key_frame(data, name)]
    assert keys == list(range(0, N_PICTURES, KEY_EVERY))


@pytest.mark.parametrize("encoding", ["json", "flatbuffer", "foxglove ros2", "ros2"])
def test_video_is_read_in_every_encoding(tmp_path: Path, encoding: str) -> None:
    how = factories.ENCODINGS[encoding]
    schema = how.schema_name.replace("foxglove.CompressedImage", "foxglove.CompressedVideo")
    schema = schema.replace("foxglove_msgs/msg/CompressedImage", "foxglove_msgs/msg/CompressedVideo")
    video = factories.Encoding(schema, how.schema_encoding, b"", how.message_encoding, how.encode)
    recording = open_recording(record(tmp_path / "a.mcap", dict(enumerate(encode("h264", 9))), video))
    assert [looks_like(frame.image) for frame in iter_frames(recording)] == list(range(9))


@pytest.mark.parametrize("codec", ENCODERS)
def test_a_video_begins_at_a_key_frame_and_survives_lost_packets(tmp_path: Path, codec: str) -> None:
    packets = dict(enumerate(encode(codec)))
    for lost in (0, 1, 10):
        del packets[lost]
    packets[17] = b"\0\0\0\1\x01" + bytes(40)  # damaged
    recording = open_recording(record(tmp_path / "a.mcap", packets, protobuf(codec)))

    frames = list(iter_frames(recording))
    assert [frame.error for frame in frames[:6]] == ["the video has had no key frame yet"] * 6
    assert looks_like(frames[6].image) == 8
    assert looks_like(frames[7].image) == 9
    assert len(frames) == N_PICTURES - 3
    assert looks_like(frames[13].image) == 16  # a key frame mends what was lost


def test_video_without_pyav_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("inspect_pipeline.images.can_decode", lambda: False)
    recording = open_recording(
        record(tmp_path / "a.mcap", dict(enumerate(encode("h264", 2))), protobuf("h264"))
    )
    assert recording.refusals == {CAMERA: "it holds video, which needs the extra 'video'"}
