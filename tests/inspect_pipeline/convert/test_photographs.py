"""Photographs as drones and people leave them: XMP variants, time zones, several cameras, folders."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from typing import TYPE_CHECKING, Any
from zoneinfo import ZoneInfo

import pytest
from PIL import ExifTags, Image

from inspect_pipeline.config import PlacingOptions
from inspect_pipeline.convert.exif import read_tags
from inspect_pipeline.convert.pack import pack
from inspect_pipeline.convert.times import parse_zone
from inspect_pipeline.georeference.frames import Georeferencer
from inspect_pipeline.georeference.poses import read_poses
from inspect_pipeline.recording.frames import iter_frames
from inspect_pipeline.recording.reader import open_recording

if TYPE_CHECKING:
    from pathlib import Path

FIELDS = {
    "GimbalPitchDegree": "-90.00",
    "GimbalYawDegree": "+30.00",
    "GimbalRollDegree": "0",
    "RelativeAltitude": "+50.00",
}
NAMESPACES = "xmlns:rdf='http://www.w3.org/1999/02/22-rdf-syntax-ns#' xmlns:drone-dji='http://www.dji.com/drone-dji/1.0/'"


def as_attributes(fields: dict[str, str], quote: str = '"') -> bytes:
    return wrapped(
        "<rdf:Description " + " ".join(f"drone-dji:{k}={quote}{v}{quote}" for k, v in fields.items()) + "/>"
    )


def as_elements(fields: dict[str, str]) -> bytes:
    inside = "".join(f"<drone-dji:{k}>{v}</drone-dji:{k}>" for k, v in fields.items())
    return wrapped(f"<rdf:Description>{inside}</rdf:Description>")


def wrapped(body: str) -> bytes:
    return f"<x:xmpmeta xmlns:x='adobe:ns:meta/'><rdf:RDF {NAMESPACES}>{body}</rdf:RDF></x:xmpmeta>".encode()


def photograph(
    path: Path,
    clock: str = "2025:10:09 10:00:00",
    *,
    zone: str | None = None,
    subsec: str | None = None,
    xmp: bytes = b"",
    f35: int = 24,
    size: tuple[int, int] = (60, 40),
    latitude: float | None = 48.0,
    model: str = "M3T",
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    exif[ExifTags.Base.Model] = model
    camera: dict[int, Any] = exif.get_ifd(ExifTags.IFD.Exif)
    camera[ExifTags.Base.DateTimeOriginal] = clock
    camera[ExifTags.Base.FocalLengthIn35mmFilm] = f35
    if zone:
        camera[ExifTags.Base.OffsetTimeOriginal] = zone
    if subsec:
        camera[ExifTags.Base.SubsecTimeOriginal] = subsec
    if latitude is not None:
        gps = {"GPSLatitudeRef": "N", "GPSLatitude": (latitude, 0.0, 0.0)}
        gps |= {"GPSLongitudeRef": "e", "GPSLongitude": (11.0, 30.0, 0.0)}
        exif.get_ifd(ExifTags.IFD.GPSInfo).update({ExifTags.GPS[name]: gps[name] for name in gps})
    Image.new("RGB", size).save(path, exif=exif, xmp=xmp)


def times_of(path: Path) -> list[str]:
    return [
        datetime.fromtimestamp(frame.log_time_ns / 1e9, UTC).isoformat(timespec="milliseconds")[:-6]
        for frame in iter_frames(open_recording(path))
    ]


@pytest.mark.parametrize(
    "xmp",
    [
        as_attributes(FIELDS),
        as_attributes(FIELDS, "'"),
        as_elements(FIELDS),
        b"<?xpacket begin='\xef\xbb\xbf'?>\n" + as_elements(FIELDS) + b"<?xpacket end='w'?>\0\0",
    ],
)
def test_xmp_is_read_however_it_is_written(tmp_path: Path, xmp: bytes) -> None:
    photograph(tmp_path / "a.jpg", xmp=xmp)
    tags = read_tags(tmp_path / "a.jpg")
    assert (tags.gimbal, tags.height_m, tags.has_bad_xmp) == ((30.0, -90.0, 0.0), 50.0, False)


@pytest.mark.parametrize(
    "xmp",
    [
        b"<!DOCTYPE x [<!ENTITY a 'aaaaaaaaaa'><!ENTITY b '&a;&a;&a;&a;'>]><x>&b;</x>",
        as_attributes(FIELDS)[:-30],
        b"no XML",
        b"\xff\xfe\x00",
    ],
)
def test_xmp_with_entities_or_damage_is_left_out_with_a_warning(tmp_path: Path, xmp: bytes) -> None:
    photograph(tmp_path / "photos" / "a.jpg", xmp=xmp)
    result = pack(tmp_path / "photos", tmp_path / "a.mcap")
    assert result.counts == {"images": 1, "positions": 1, "attitudes": 0}
    assert result.warnings == (
        f"{tmp_path / 'photos' / 'a.jpg'}: its XMP is damaged, gimbal angles and height are missing",
    )


def test_a_position_that_only_xmp_has(tmp_path: Path) -> None:
    fields = {"GpsLatitude": "+48.1", "GpsLongitude": "+11.5", "AbsoluteAltitude": "+560.00"}
    photograph(tmp_path / "a.jpg", xmp=as_attributes(fields), latitude=None)
    assert read_tags(tmp_path / "a.jpg").position == (48.1, 11.5, 560.0)


def test_a_height_without_gimbal_angles_is_kept(tmp_path: Path) -> None:
    photograph(tmp_path / "photos" / "a.jpg", xmp=as_elements({"RelativeAltitude": "+37.5"}))
    pack(tmp_path / "photos", tmp_path / "a.mcap")
    recording = open_recording(tmp_path / "a.mcap")
    pose = read_poses(recording).at(recording.end_ns)
    assert (pose.height_m, pose.attitude_of) == (37.5, None)


def test_each_photograph_has_its_own_time_zone(tmp_path: Path) -> None:
    photos = tmp_path / "photos"
    photograph(photos / "a.jpg", "2025:10:09 10:00:10", zone="+00:00")
    photograph(photos / "b.jpg", "2025:10:09 12:00:12", zone="+02:00", subsec="25")
    photograph(photos / "c.jpg", "2025:10:09 10:00:14")  # without: as most
    photograph(photos / "d.jpg", "2025:10:09 10:00:16", zone="+00:00")
    pack(photos, tmp_path / "a.mcap")
    assert times_of(tmp_path / "a.mcap") == [
        "2025-10-09T10:00:10.000",
        "2025-10-09T10:00:12.250",
        "2025-10-09T10:00:14.000",
        "2025-10-09T10:00:16.000",
    ]


def test_a_time_zone_may_be_given_for_clocks_that_say_none(tmp_path: Path) -> None:
    """The summer time of Berlin ends between the two."""
    photograph(tmp_path / "photos" / "a.jpg", "2025:10:25 12:00:00")
    photograph(tmp_path / "photos" / "b.jpg", "2025:10:26 12:00:00")
    photograph(tmp_path / "photos" / "c.jpg", "2025:10:26 12:00:00", zone="+05:00")
    pack(tmp_path / "photos", tmp_path / "a.mcap", zone=ZoneInfo("Europe/Berlin"))
    assert times_of(tmp_path / "a.mcap") == [
        "2025-10-25T10:00:00.000",
        "2025-10-26T07:00:00.000",
        "2025-10-26T11:00:00.000",
    ]


def test_time_zones_are_names_or_offsets() -> None:
    assert parse_zone("+02:00") == timezone(timedelta(hours=2))
    assert parse_zone("Europe/Berlin").key == "Europe/Berlin"
    for text in ("Mars/Olympus", "+2", "../../etc/passwd", ""):
        with pytest.raises(ValueError, match=r"time"):
            parse_zone(text)


def test_cameras_of_one_folder_have_topics_and_lenses_of_their_own(tmp_path: Path) -> None:
    """A thermal, a wide and a zoom camera at the same moments, 50 m above ground, the zoom changing."""
    photos = tmp_path / "DCIM" / "100MEDIA"
    for i, zoom in enumerate((200, 100, 50, 24)):
        times = {"clock": f"2025:10:09 10:00:{10 + 2 * i}", "xmp": as_attributes(FIELDS)}
        photograph(photos / f"DJI_{i:04d}_T.JPG", f35=40, size=(160, 128), **times)
        photograph(photos / f"DJI_{i:04d}_W.JPG", f35=24, size=(400, 300), **times)
        photograph(photos / f"DJI_{i:04d}_Z.JPG", f35=zoom, size=(400, 300), **times)
    result = pack(tmp_path / "DCIM", tmp_path / "a.mcap")
    assert result.counts == {"images": 12, "cameras": 3, "positions": 12, "attitudes": 12}
    recording = open_recording(tmp_path / "a.mcap")
    places = Georeferencer.of(recording, PlacingOptions())
    gsd_m: dict[str, list[float]] = {}
    for frame in iter_frames(recording):
        gsd_m.setdefault(frame.topic, []).append(round(places.place(frame).gsd_m, 4))
    assert gsd_m == {
        "/camera_thermal/image/compressed": [0.2639] * 4,
        "/camera_wide/image/compressed": [0.1803] * 4,
        "/camera_zoom/image/compressed": [0.0216, 0.0433, 0.0865, 0.1803],
    }


def test_cameras_are_named_by_what_differs(tmp_path: Path) -> None:
    photograph(tmp_path / "photos" / "a.jpg", model="FC 6310")
    photograph(tmp_path / "photos" / "b.jpg", model="M3T", size=(60, 40))
    photograph(tmp_path / "photos" / "c.jpg", model="M3T", size=(40, 60))
    pack(tmp_path / "photos", tmp_path / "a.mcap")
    assert [camera.topic for camera in open_recording(tmp_path / "a.mcap").camera_channels] == [
        "/camera_fc_6310_60x40/image/compressed",
        "/camera_m3t_40x60/image/compressed",
        "/camera_m3t_60x40/image/compressed",
    ]


def test_folders_below_are_packed_too(tmp_path: Path) -> None:
    photograph(tmp_path / "DCIM" / "101MEDIA" / "DJI_0001.JPG", "2025:10:09 10:00:02")
    photograph(tmp_path / "DCIM" / "100MEDIA" / "DJI_0999.JPG", "2025:10:09 10:00:00")
    assert pack(tmp_path / "DCIM", tmp_path / "a.mcap").counts["images"] == 2
    assert times_of(tmp_path / "a.mcap") == ["2025-10-09T10:00:00.000", "2025-10-09T10:00:02.000"]
