from __future__ import annotations

import struct
import zlib
from datetime import UTC, datetime, timedelta, timezone
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import typer
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from PIL import ExifTags, Image
from typer.testing import CliRunner

from inspect_pipeline.commands.pack import pack as pack_command
from inspect_pipeline.convert.pack import PackResult, pack
from inspect_pipeline.convert.video import _start_ns
from inspect_pipeline.errors import InspectError, RecordingError
from inspect_pipeline.georeference.calibration import LensReader
from inspect_pipeline.georeference.poses import read_poses
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

XMP = b"""<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:RelativeAltitude="+60.10"
 drone-dji:GimbalRollDegree="+0.00" drone-dji:GimbalYawDegree="-121.50" drone-dji:GimbalPitchDegree="-89.90"/>
</rdf:RDF></x:xmpmeta>"""
SRT = """1
00:00:00,000 --> 00:00:00,500
<font size="28">FrameCnt: 1, DiffTime: 33ms
2024-05-01 10:00:00.250
[iso: 100] [shutter: 1/1000.0] [latitude: 48.1] [longitude: 11.5] [rel_alt: 1.300 abs_alt: 500.125]
[ct: 5000] [gb_yaw: 30.5 gb_pitch: -45.0 gb_roll: 0.0] </font>

2
00:00:00,500 --> 00:00:01,000
<font size="28">FrameCnt: 15, DiffTime: 33ms
2024-05-01 10:00:00.750
[iso: 100] [latitude: 48.2] [longtitude: 11.6] [altitude: 501.0]</font>

3
00:00:01,000 --> 00:00:01,500
GPS(11.7,-48.3,502.5) F/2.8
"""


def photograph(path: Path, clock: str | None, *, xmp: bytes = b"", **gps: Any) -> Path:
    exif = Image.Exif()
    camera = exif.get_ifd(ExifTags.IFD.Exif)
    if clock:
        camera[ExifTags.Base.DateTimeOriginal] = clock
    camera[ExifTags.Base.FocalLengthIn35mmFilm] = 24
    exif.get_ifd(ExifTags.IFD.GPSInfo).update({ExifTags.GPS[name]: value for name, value in gps.items()})
    Image.new("RGB", (300, 200), "grey").save(path, exif=exif, xmp=xmp)
    return path


def where(latitude: tuple[float, float, float], altitude_m: float) -> dict[str, Any]:
    return {
        "GPSLatitudeRef": "S",
        "GPSLatitude": latitude,
        "GPSLongitudeRef": "E",
        "GPSLongitude": (11.0, 30.0, 36.0),
        "GPSAltitudeRef": b"\1",
        "GPSAltitude": altitude_m,
    }


def utc_ns(text: str) -> int:
    return round(datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp() * 1000) * 1_000_000


def decoded(path: Path) -> list[tuple[str, int, Any]]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [(c.topic, m.log_time, d) for _, c, m, d in reader.iter_decoded_messages()]


def test_photographs_become_a_recording(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    photograph(folder / "b.JPG", "2024:05:01 12:00:02", xmp=XMP, **where((48.0, 6.0, 9.0), 12.5))
    photograph(folder / "a.jpg", "2024:05:01 12:00:04", **where((48.0, 12.0, 0.0), 13.0))
    photograph(folder / "c.jpg", "2024:05:01 12:00:04")
    undated = photograph(folder / "d.jpg", None)
    (folder / "e.jpg").write_bytes(b"no image")
    cut = photograph(folder / "f.jpg", "2024:05:01 12:00:09").read_bytes()
    (folder / "f.jpg").write_bytes(cut[: cut.index(b"Exif") + 40])
    size = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)  # claimed by a head of a few bytes
    head = b"IHDR" + size
    (folder / "g.jpg").write_bytes(
        b"\x89PNG\r\n\x1a\n\0\0\0\r" + head + zlib.crc32(head).to_bytes(4) + b"\0\0\0\0IDAT\x35\xaf\x06\x1e"
    )
    (folder / "notes.txt").write_text("weather: fine")
    target = tmp_path / "a.mcap"

    result = pack(folder, target)
    assert result.counts == {"images": 3, "positions": 2, "attitudes": 1}
    reason = "does not say when it was taken, it is left out"
    assert result.warnings == (
        f"{undated} {reason}",
        f"{folder / 'e.jpg'} cannot be read, it is left out",
        f"{folder / 'f.jpg'} cannot be read, it is left out",
        f"{folder / 'g.jpg'} cannot be read, it is left out",
    )
    assert capfd.readouterr().err == ""
    recording = open_recording(target)
    frames = list(iter_frames(recording))
    start_ns = utc_ns("2024-05-01T12:00:02")
    offsets_us = [(frame.log_time_ns - start_ns) / 1e3 for frame in frames]
    assert offsets_us == [0, 2_000_000, 2_000_001]
    assert all(frame.stamp_ns == frame.log_time_ns for frame in frames)
    poses = [read_poses(recording).at(frame.log_time_ns) for frame in frames]
    assert poses[0] is not None
    assert poses[1] is not None
    position = (poses[0].latitude_deg, poses[0].longitude_deg, poses[0].altitude_m)
    assert position == pytest.approx((-48.1025, 11.51, -12.5))
    assert (poses[0].yaw_deg, poses[0].pitch_deg) == pytest.approx((-121.5, -89.9), abs=1e-3)
    assert (poses[0].attitude_of, poses[0].age_ms, poses[0].height_m) == ("camera", 0, 60.1)
    assert poses[1].latitude_deg == pytest.approx(-48.2)
    reader = LensReader(recording)
    read_poses(recording, reader)
    intrinsics = reader.lenses()[recording.camera_channels[0].channel_id].lenses[0]
    assert intrinsics.focal_px[0] == pytest.approx(24 / 36 * 300)  # the picture has the shape of the film
    stored = [d.data for topic, _, d in decoded(target) if topic == recording.camera_channels[0].topic]
    assert stored == [(folder / name).read_bytes() for name in ("b.JPG", "a.jpg", "c.jpg")]


def test_the_zone_of_the_clock_is_read_from_gps_or_exif(tmp_path: Path) -> None:
    gps = {"GPSDateStamp": "2024:05:01", "GPSTimeStamp": (6.0, 29.0, 58.0)}
    for name, fields in (("gps", gps), ("none", {})):
        (tmp_path / name).mkdir()
        photograph(tmp_path / name / "a.jpg", "2024:05:01 12:00:02", **fields)
        pack(tmp_path / name, tmp_path / f"{name}.mcap")
    assert open_recording(tmp_path / "gps.mcap").start_ns == utc_ns("2024-05-01T06:30:02")
    assert open_recording(tmp_path / "none.mcap").start_ns == utc_ns("2024-05-01T12:00:02")


@pytest.mark.parametrize(
    ("recorded", "wanted"),
    [("2024-05-01 12:00:00", "2024-05-01T12:00:00"), ("2024-05-01T12:00:00.5Z", "2024-05-01T12:00:00.500")],
)
def test_when_a_video_was_made(tmp_path: Path, recorded: str, wanted: str) -> None:
    assert _start_ns(tmp_path, [], {"creation_time": recorded}, UTC, None) == utc_ns(wanted)


@pytest.mark.parametrize("metadata", [{}, {"creation_time": "yesterday"}])
def test_a_video_that_does_not_say_when_it_was_made(tmp_path: Path, metadata: dict[str, str]) -> None:
    with pytest.raises(RecordingError, match="put its SRT file beside it"):
        _start_ns(tmp_path, [], metadata, UTC, None)


def test_a_clock_that_was_never_set(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    photograph(
        tmp_path / "photos" / "a.jpg",
        "0001:01:01 00:00:00",
        GPSDateStamp="0001:01:01",
        GPSTimeStamp=(0, 0, 0),
    )
    with Image.open(tmp_path / "photos" / "a.jpg") as image:
        exif = image.getexif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.OffsetTimeOriginal] = "+02:00"
    Image.new("RGB", (300, 200)).save(tmp_path / "photos" / "a.jpg", exif=exif)
    assert pack(tmp_path / "photos", tmp_path / "a.mcap").counts["images"] == 1


def make_video(path: Path, n_pictures: int = 30, **options: str) -> None:
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(10), options={"bf": "0", **options})
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 128, 96, "yuv420p", 10
        for i in range(n_pictures):
            frame = av.VideoFrame.from_ndarray(np.full((96, 128, 3), 10 + 8 * i, np.uint8), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


def test_a_video_and_its_subtitles_become_a_recording(tmp_path: Path) -> None:
    make_video(tmp_path / "DJI_1.MP4")
    (tmp_path / "DJI_1.SRT").write_text(SRT)
    target = tmp_path / "a.mcap"

    assert pack(tmp_path / "DJI_1.MP4", target) == PackResult({"images": 30, "positions": 3, "attitudes": 1})
    recording = open_recording(target)
    frames, track = list(iter_frames(recording)), read_poses(recording)
    start_ns = utc_ns("2024-05-01T10:00:00.250")
    assert [frame.log_time_ns - start_ns for frame in frames] == [i * 10**8 for i in range(30)]
    assert [round((float(frame.image.mean()) - 10) / 8) for frame in frames] == list(range(30))
    first, second, third = (track.at(start_ns + offset_ms * 10**6) for offset_ms in (0, 600, 1000))
    assert first is not None
    assert second is not None
    assert third is not None
    assert (first.latitude_deg, first.longitude_deg, first.altitude_m) == (48.1, 11.5, 500.125)
    assert (first.yaw_deg, first.pitch_deg, first.roll_deg) == pytest.approx((30.5, -45, 0), abs=1e-9)
    assert first.height_m == 1.3
    assert (second.latitude_deg, second.longitude_deg, second.altitude_m) == (48.2, 11.6, 501.0)
    assert (third.latitude_deg, third.longitude_deg, third.altitude_m) == (-48.3, 11.7, 502.5)


def test_what_cannot_be_packed_is_one_line(tmp_path: Path) -> None:
    for name in ("empty", "raw", "clockless"):
        (tmp_path / name).mkdir()
    (tmp_path / "raw" / "a.DNG").touch()
    photograph(tmp_path / "clockless" / "a.jpg", None)
    (tmp_path / "text.mp4").write_text("no video")
    make_video(tmp_path / "undated.mp4")
    make_video(tmp_path / "b.mp4")
    (tmp_path / "b.srt").write_text(SRT)
    (tmp_path / "there.mcap").write_text("")
    for source, target, message in (
        ("absent", "a.mcap", "there is no such file or folder"),
        ("empty", "a.mcap", "no MCAP file and no JPEG; name another folder"),
        ("raw", "a.mcap", r"it has pictures \(.dng\) but no JPEG; convert them"),
        ("clockless", "a.mcap", "its JPEG does not say when it was taken; set"),
        ("text.mp4", "a.mcap", "not a video"),
        ("undated.mp4", "a.mcap", "does not say when it was taken"),
        ("b.mp4", "there.mcap", "exists already"),
        ("b.mp4", "absent/a.mcap", "cannot be made"),
    ):
        with pytest.raises(InspectError, match=message):
            pack(tmp_path / source, tmp_path / target)
        assert not (tmp_path / "a.mcap").exists()


def test_the_command(tmp_path: Path) -> None:
    photograph(tmp_path / "a.jpg", "2024:05:01 12:00:02", xmp=XMP)
    photograph(tmp_path / "b.jpg", None)
    app = typer.Typer()
    app.command()(pack_command)
    result = CliRunner().invoke(app, [str(tmp_path), str(tmp_path / "a.mcap")])
    assert result.exit_code == 0
    assert result.stdout == f"{tmp_path / 'a.mcap'}: 1 image, 0 positions, 1 attitude\n"
    assert "b.jpg does not say when it was taken" in result.stderr


@pytest.mark.parametrize(
    ("name", "count", "start", "latitude_deg"),
    [
        ("caliterra", 75, "2014-10-19T18:20:51", 30.17096),
        ("brighton", 18, "2016-06-23T16:31:59", 46.84270),
    ],
)
def test_real_photographs(
    data_dir: Path, tmp_path: Path, name: str, count: int, start: str, latitude_deg: float
) -> None:
    result = pack(data_dir / "flights" / name, tmp_path / "a.mcap")
    recording = open_recording(tmp_path / "a.mcap")

    assert result == PackResult({"images": count, "positions": count, "attitudes": 0})
    assert recording.start_ns == utc_ns(start)
    latitudes_deg = read_poses(recording).positions.values[:, 0]
    assert np.abs(latitudes_deg - latitude_deg).max() < 0.01
    assert all(frame.image is not None for frame in iter_frames(recording, every=30))


def test_photographs_are_marked_as_stills_and_videos_are_not(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    photograph(tmp_path / "photos" / "a.jpg", "2024:05:01 12:00:02")
    make_video(tmp_path / "a.mp4")
    (tmp_path / "a.srt").write_text(SRT)
    for source, is_stills in (("photos", True), ("a.mp4", False)):
        pack(tmp_path / source, tmp_path / f"{source}.mcap")
        (camera,) = open_recording(tmp_path / f"{source}.mcap").camera_channels
        assert camera.is_stills == is_stills


def test_a_video_with_b_frames_is_packed_in_the_order_it_is_shown(tmp_path: Path) -> None:
    make_video(tmp_path / "b.mp4", bf="3", b_adapt="0")
    start = datetime(2025, 10, 9, 8, 0, tzinfo=UTC)
    result = pack(tmp_path / "b.mp4", tmp_path / "b.mcap", start=start)
    assert result.counts["images"] == 30
    assert "B-frames" in result.warnings[0]
    frames = list(iter_frames(open_recording(tmp_path / "b.mcap")))
    start_ns = utc_ns("2025-10-09T08:00:00")
    assert [frame.log_time_ns - start_ns for frame in frames] == [i * 10**8 for i in range(30)]
    assert [round((float(frame.image.mean()) - 10) / 8) for frame in frames] == list(range(30))


def test_the_start_of_a_video_may_be_given_and_its_clock_have_a_zone(tmp_path: Path) -> None:
    make_video(tmp_path / "a.mp4", 3)
    berlin = timezone(timedelta(hours=2))
    for name, start in (
        ("naive", datetime(2025, 10, 9, 8, 0)),
        ("utc", datetime(2025, 10, 9, 6, tzinfo=UTC)),
    ):
        pack(tmp_path / "a.mp4", tmp_path / f"{name}.mcap", zone=berlin, start=start)
        assert open_recording(tmp_path / f"{name}.mcap").start_ns == utc_ns("2025-10-09T06:00:00")
    (tmp_path / "a.srt").write_text(SRT)
    pack(tmp_path / "a.mp4", tmp_path / "srt.mcap", zone=berlin)
    assert open_recording(tmp_path / "srt.mcap").start_ns == utc_ns("2024-05-01T08:00:00.250")
