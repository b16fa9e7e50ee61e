from __future__ import annotations

import time
from fractions import Fraction
from typing import TYPE_CHECKING

import factories
import numpy as np
import pytest
from factories import CAMERA, START_NS, STEP_NS, Shot, make_recording
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from hypothesis import given
from hypothesis import strategies as st

from inspect_pipeline.images.codec import key_of, to_annex_b
from inspect_pipeline.images.h264 import GapFinder
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

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


def encode(codec: str, n_pictures: int = N_PICTURES, stamps: list[int] | None = None) -> list[bytes]:
    """A packet per picture, a key frame every `KEY_EVERY`; `stamps` is filled with the number of each."""
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
    if stamps is not None:
        stamps += [packet.pts for packet in packets]
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
    name = {"h265": "hevc"}.get(codec, codec)
    keys = [i for i, data in enumerate(encode(codec)) if key_of(data, name) != "none"]
    assert keys == list(range(0, N_PICTURES, KEY_EVERY))


B_FRAMES = {
    "h264": ("h264", "libx264", {"preset": "medium", "bf": "3"}),
    "h264 open": ("h264", "libx264", {"preset": "medium", "bf": "3", "x264-params": "open-gop=1"}),
    "h265": ("h265", "libx265", {"x265-params": "bframes=3:repeat-headers=1:open-gop=0:log-level=none"}),
    "h265 open": ("h265", "libx265", {"x265-params": "bframes=3:repeat-headers=1:open-gop=1:log-level=none"}),
}


def encode_out_of_order(name: str, monkeypatch: pytest.MonkeyPatch) -> tuple[list[bytes], list[int]]:
    """Packets in the order in which they are decoded, and which picture is in each, by their own stamps."""
    codec, encoder, options = B_FRAMES[name]
    stamps: list[int] = []
    monkeypatch.setitem(ENCODERS, codec, (encoder, options))
    packets = encode(codec, 27, stamps)
    assert stamps != sorted(stamps)
    return packets, stamps


@pytest.mark.parametrize("name", B_FRAMES)
@pytest.mark.parametrize("every", [1, 5, 11])
def test_b_frames_are_the_pictures_of_their_messages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, every: int
) -> None:
    """Which picture a packet holds is what the encoder says; that it looks so is seen."""
    packets, pictures = encode_out_of_order(name, monkeypatch)
    path = record(tmp_path / "a.mcap", dict(enumerate(packets)), protobuf(B_FRAMES[name][0]))
    frames = list(iter_frames(open_recording(path), every=every))
    found = [(frame.frame_idx, looks_like(frame.image)) for frame in frames]
    assert found == [(i, picture) for i, picture in enumerate(pictures) if i % every == 0]


def test_b_frames_do_not_hold_up_other_cameras_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The video ends while its last pictures are in the decoder; what waits behind them is bounded."""
    monkeypatch.setattr("inspect_pipeline.recording.frames._MAX_WAITING_BYTES", 3000)
    packets, _ = encode_out_of_order("h264", monkeypatch)
    how = protobuf("h264")
    to_write = [Shot(i, CAMERA, START_NS + i, data) for i, data in enumerate(packets[:9])]
    to_write += [Shot(i, "/b/image", START_NS + 100 + i, data=None) for i in range(20)]
    recording = open_recording(make_recording(tmp_path / "a.mcap", to_write, encoding=how))
    frames = list(iter_frames(recording))
    assert [frame.topic for frame in frames] == [CAMERA] * 9 + ["/b/image"] * 20
    assert [frame.error for frame in frames].count("the picture of the video cannot be decoded") <= 3


@pytest.mark.parametrize("codec", ["h264", "h265"])
@pytest.mark.parametrize("encoding", ["video", "ros2"])
def test_streams_with_lengths_instead_of_start_codes(tmp_path: Path, codec: str, encoding: str) -> None:
    """As in MP4."""
    packets = encode(codec)
    prefixed = [with_lengths(data) for data in packets]
    assert all(not data.startswith(b"\0\0\0\1") for data in prefixed)
    for data, short in zip(packets, prefixed, strict=True):
        assert to_annex_b(data) == data
        assert units(to_annex_b(short)) == units(data)

    def as_ros2(stamp_ns: int, frame_id: str, data: bytes) -> bytes:
        message = factories.ros2_cdr(stamp_ns, frame_id, data)
        return message.replace(b"rgb8; jpeg compressed bgr8", codec.encode().ljust(26, b" "))

    how = protobuf(codec)
    if encoding == "ros2":
        how = factories.ENCODINGS["ros2"]
        how = factories.Encoding(how.schema_name, how.schema_encoding, b"", how.message_encoding, as_ros2)
    recording = open_recording(record(tmp_path / "a.mcap", dict(enumerate(prefixed)), how))
    assert [looks_like(frame.image) for frame in iter_frames(recording)] == list(range(N_PICTURES))


def units(data: bytes) -> list[bytes]:
    """The units of a packet of Annex B."""
    return [unit.rstrip(b"\0") for unit in data.split(b"\0\0\1") if unit.strip(b"\0")]


def with_lengths(data: bytes) -> bytes:
    return b"".join(len(unit).to_bytes(4, "big") + unit for unit in units(data))


def test_a_length_that_looks_like_a_start_code() -> None:
    unit = b"\x65" + bytes(range(1, 255)) + b"\x77" * 60
    data = len(unit).to_bytes(4, "big") + unit
    assert data.startswith(b"\0\0\1")
    assert to_annex_b(data) == b"\0\0\0\1" + unit
    short_codes = b"\0\0\1\x67" + unit
    assert to_annex_b(short_codes) == short_codes


def test_an_av1_packet_of_erased_memory_is_looked_at_quickly() -> None:
    """Every byte says that the size continues; eight may."""
    before_s = time.process_time()
    assert key_of(b"\x12\x00" + b"\xff" * 100_000, "av1") == "none"
    assert time.process_time() - before_s < 1.0


@pytest.mark.parametrize("options", [{}, {"profile": "baseline"}, {"profile": "high", "cqm": "jvt"}])
def test_what_stands_on_a_lost_picture_of_h264_is_bad(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: dict[str, str]
) -> None:
    """FFmpeg would give the picture before it, or a smeared one, as if nothing were wrong."""
    name, always = ENCODERS["h264"]
    monkeypatch.setitem(ENCODERS, "h264", (name, always | options))
    whole = dict(enumerate(encode("h264")))
    for lost in range(N_PICTURES):
        packets = {i: data for i, data in whole.items() if i != lost}
        recording = open_recording(record(tmp_path / f"{lost}.mcap", packets, protobuf("h264")))
        frames = list(iter_frames(recording))
        shown = {i: frame for i, frame in zip(packets, frames, strict=True) if frame.image is not None}
        assert all(looks_like(frame.image) == i for i, frame in shown.items())
        assert shown.keys() == whole.keys() - set(range(lost, (lost // KEY_EVERY + 1) * KEY_EVERY))


@given(st.binary(max_size=300), st.sampled_from([b"\x67", b"\x41", b"\x65"]), st.binary(max_size=40))
def test_damaged_heads_of_h264_say_nothing(before: bytes, head: bytes, data: bytes) -> None:
    """Whatever they hold: no exception, no time, no memory."""
    finder = GapFinder()
    finder.is_after_gap(b"\0\0\1\x67\x42\xc0\x1e\xd9" + before)
    assert finder.is_after_gap(b"\0\0\1" + head + data) in {True, False}


def test_video_that_claims_absurd_size_is_not_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("inspect_pipeline.images.video._MAX_PIXELS", 128 * 96 - 1)
    path = record(tmp_path / "a.mcap", dict(enumerate(encode("h264", 3))), protobuf("h264"))
    assert [frame.error for frame in iter_frames(open_recording(path))] == [
        "the picture of the video cannot be decoded"
    ] * 3


def test_a_picture_in_a_video_channel(tmp_path: Path) -> None:
    """The first bytes outrank the schema."""
    packets = dict(enumerate(encode("h264", 4)))
    packets[2] = factories.encoded_picture(7)
    frames = list(iter_frames(open_recording(record(tmp_path / "a.mcap", packets, protobuf("h264")))))
    assert factories.number_of(frames[2].image) == 7
    assert looks_like(frames[1].image) == 1


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


def test_a_codec_that_is_not_there_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = record(tmp_path / "a.mcap", dict(enumerate(encode("h264", 2))), protobuf("h264"))
    monkeypatch.setattr("inspect_pipeline.images.video.codec_of", lambda *_: "h264_of_nobody")
    monkeypatch.setattr("inspect_pipeline.images.video.key_of", lambda *_: "closed")
    errors = [frame.error for frame in iter_frames(open_recording(path))]
    assert errors == ["PyAV has no decoder h264_of_nobody; install av from PyPI, which has it"] * 2


def test_video_without_pyav_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("inspect_pipeline.images.decode.can_decode", lambda: False)
    recording = open_recording(
        record(tmp_path / "a.mcap", dict(enumerate(encode("h264", 2))), protobuf("h264"))
    )
    assert recording.refusals == {CAMERA: "it holds video, which needs the extra 'video'"}
