"""Frames as photographs and labels, and snippets, of a processed recording; read back by other programs."""

from __future__ import annotations

import csv
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from factories import START_NS, encoded_picture
from fakes import FakeDetector
from mcap.reader import make_reader
from PIL import ExifTags, Image
from pycocotools.coco import COCO

from inspect_pipeline.config import ProcessOptions
from inspect_pipeline.convert.exif import read_tags
from inspect_pipeline.errors import MissingExtraError
from inspect_pipeline.export.images import export_images
from inspect_pipeline.export.rerun import export_rrd
from inspect_pipeline.export.rows import Redaction
from inspect_pipeline.export.snippet import export_snippet
from inspect_pipeline.index.reading import select
from inspect_pipeline.pipeline import process
from inspect_pipeline.publishing import publish
from inspect_pipeline.recording.writer import new_recording
from inspect_pipeline.store.store import Store
from lsnet.training.labels import load_labels

if TYPE_CHECKING:
    from pathlib import Path

S = 1_000_000_000


def flight_ids(store: Store) -> list[str]:
    return [row["flight_id"] for row in select(store, "SELECT flight_id FROM flights")]


def frames_of(store: Store, folder: Path) -> list[tuple[dict[str, Any], Path]]:
    """The rows of the exported frames, each with its image."""
    rows = select(store, "FROM frames ORDER BY frame_idx")
    named = (
        (row, folder / f"{row['flight_id'][:16]}_{row['channel_id']}_{row['frame_idx']:06d}.jpg")
        for row in rows
    )
    return [(row, path) for row, path in named if path.exists()]


def test_photographs_carry_place_time_and_attitude(flown: Store, tmp_path: Path) -> None:
    found = export_images(flown, flight_ids(flown), "evidence", tmp_path, form="jpeg")
    shown = frames_of(flown, tmp_path)
    assert len(shown) == found.n_images == found.n_wanted > 0
    for row, path in shown:
        with Image.open(path) as image:
            image.load()
            assert image.size == (160, 120)
            exif = image.getexif()
            gps, camera = exif.get_ifd(ExifTags.IFD.GPSInfo), exif.get_ifd(ExifTags.IFD.Exif)
            assert b"GimbalPitchDegree" in image.info["xmp"]
        for letters, axis in (("NS", "lat"), ("EW", "lon")):
            name = {"lat": "GPSLatitude", "lon": "GPSLongitude"}[axis]
            degrees, minutes, seconds = map(float, gps[ExifTags.GPS[name]])
            sign = 1 if gps[ExifTags.GPS[f"{name}Ref"]] == letters[0] else -1
            assert sign * (degrees + minutes / 60 + seconds / 3600) == pytest.approx(
                row[f"{axis}_deg"], abs=1e-7
            )
        assert float(gps[ExifTags.GPS.GPSAltitude]) == pytest.approx(row["alt_m"], abs=1e-3)
        moment = row["log_time_utc"]
        assert camera[ExifTags.Base.DateTimeOriginal] == f"{moment:%Y:%m:%d %H:%M:%S}"
        assert camera[ExifTags.Base.OffsetTimeOriginal] == "+00:00"
        assert camera[ExifTags.Base.SubsecTimeOriginal] == f"{moment:%f}"


def test_they_are_read_as_those_of_a_drone(flown: Store, tmp_path: Path) -> None:
    export_images(flown, flight_ids(flown), "evidence", tmp_path, form="jpeg")
    for row, path in frames_of(flown, tmp_path):
        tags = read_tags(path)
        assert tags is not None
        assert tags.position is not None
        assert tags.gimbal is not None
        turns = [row[f"cam_{turn}_deg"] for turn in ("yaw", "pitch", "roll")]
        assert list(tags.gimbal) == pytest.approx(turns, abs=1e-5)
        assert tags.height_m == pytest.approx(row["height_m"], abs=1e-3)
        assert tags.focal_px == pytest.approx(row["focal_px"], rel=0.05)  # whole millimetres of 35 mm film


def test_the_tables_beside_the_images(flown: Store, tmp_path: Path) -> None:
    found = export_images(flown, flight_ids(flown), "evidence", tmp_path, form="esri-oriented")
    with (tmp_path / "images.csv").open() as file:
        images = list(csv.DictReader(file))
    with (tmp_path / "oriented_imagery.csv").open() as file:
        oriented = list(csv.DictReader(file))
    assert len(images) == len(oriented) == found.n_images
    (anomaly,) = select(flown, "SELECT * FROM anomalies WHERE kind = 'dark_frames'")
    assert all(anomaly["anomaly_id"] in row["anomaly_ids"] for row in images)
    for row, pose, (frame, path) in zip(images, oriented, frames_of(flown, tmp_path), strict=True):
        assert row["file"] == path.name
        assert pose["ImagePath"] == str(path)
        assert float(pose["X"]) == pytest.approx(frame["lon_deg"], abs=1e-9)
        assert float(pose["CameraPitch"]) == pytest.approx(frame["cam_pitch_deg"] + 90)
        assert 0 <= float(pose["CameraHeading"]) < 360


@pytest.mark.parametrize(("what", "form"), [("frames", "coco"), ("evidence", "labelme")])
def test_labels_are_the_lines(flown: Store, tmp_path: Path, what: str, form: str) -> None:
    export_images(flown, flight_ids(flown), what, tmp_path, form=form)
    wanted = {path.name: row for row, path in frames_of(flown, tmp_path)}
    assert what == "evidence" or len(wanted) == 10
    of_frame = "FROM lines WHERE frame_idx = ? ORDER BY line_idx"
    lines = {name: select(flown, of_frame, [row["frame_idx"]]) for name, row in wanted.items()}
    labelled = load_labels(tmp_path)
    assert [image.path.name for image in labelled] == sorted(wanted)
    for image in labelled:
        expected = [[(p["x"], p["y"]) for p in line["points"]] for line in lines[image.path.name]]
        assert len(image.lines) == len(expected)
        assert all(np.allclose(a, b, atol=1e-4) for a, b in zip(image.lines, expected, strict=True))
    if form == "coco":
        coco = COCO(tmp_path / "annotations.json")
        assert len(coco.getImgIds()) == len(wanted)
        assert len(coco.getAnnIds()) == sum(map(len, lines.values())) > 0
        assert coco.annToMask(coco.loadAnns(coco.getAnnIds())[0]).shape == (120, 160)


def test_redacted_photographs_do_not_say_where(flown: Store, tmp_path: Path) -> None:
    export_images(flown, flight_ids(flown), "evidence", tmp_path, form="jpeg", redaction=Redaction.of("drop"))
    for _, path in frames_of(flown, tmp_path):
        with Image.open(path) as image:
            assert not image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
            assert b"AbsoluteAltitude" not in image.info["xmp"]


def test_images_that_are_gone_are_failures(flown: Store, tmp_path: Path) -> None:
    store = Store(shutil.copytree(flown.root, tmp_path / "store"))
    (stored,), _ = store.scan()
    store.remove_annotated_copy(stored)
    publish(store)
    (flown.root.parent / "a.mcap").rename(tmp_path / "moved.mcap")
    try:
        found = export_images(store, flight_ids(store), "evidence", tmp_path / "out", form="jpeg")
    finally:
        (tmp_path / "moved.mcap").rename(flown.root.parent / "a.mcap")
    assert (found.n_images, len(found.failures)) == (0, 1)
    assert found.n_wanted > 0


def test_a_snippet_has_every_topic_around_the_anomaly(flown: Store, tmp_path: Path) -> None:
    (anomaly,) = select(flown, "SELECT * FROM anomalies WHERE kind = 'dark_frames'")
    anomaly |= {"start_ns": anomaly["start_ns"] + 7 * S, "end_ns": anomaly["start_ns"] + 7 * S}
    n_messages = export_snippet(flown, anomaly, tmp_path / "snippet.mcap")
    whole = flown.flight_dir(anomaly["flight_id"]) / "annotated.mcap"
    first, last = anomaly["start_ns"] - 5 * S, anomaly["end_ns"] + 5 * S
    with whole.open("rb") as file:
        reader = make_reader(file)
        expected = [
            (channel.topic, schema.name, message.log_time, message.data)
            for schema, channel, message in reader.iter_messages()
            if first <= message.log_time <= last
        ]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        schemas = {schema.name: schema.data for schema in reader.get_summary().schemas.values()}
    with (tmp_path / "snippet.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [(c.topic, s.name, m.log_time, m.data) for s, c, m in reader.iter_messages()]
        assert {record.name: record.metadata for record in reader.iter_metadata()} == metadata
        assert {s.name: s.data for s in reader.get_summary().schemas.values()} == schemas
    assert n_messages == len(found)
    assert [message for message in found if message in expected] == sorted(found, key=lambda m: m[2])
    assert sorted(found) == sorted(expected)
    assert {topic for topic, *_ in found} >= {
        "/camera/image",
        "/camera/image/lsnet/annotations",
        "/drone/location",
    }


def test_a_snippet_of_a_sidecar_has_the_recording_and_silent_channels(tmp_path: Path) -> None:
    """The calibration came once, long before the anomaly."""
    with new_recording(tmp_path / "a.mcap") as author:
        lens = {"image_size": (12, 16), "focal_px": (20.0, 20.0), "centre_px": (8.0, 6.0)}
        author.write_calibration("/lens", START_NS, "cam", **lens)
        for second in range(30):
            author.write_image("/camera", START_NS + second * S, "cam", encoded_picture(second), "png")
    store = Store(tmp_path / "store")
    result = process(tmp_path / "a.mcap", store, FakeDetector(), ProcessOptions(write="sidecar"))
    anomaly = {"flight_id": result.flight_id, "start_ns": START_NS + 20 * S, "end_ns": START_NS + 21 * S}
    export_snippet(store, anomaly, tmp_path / "snippet.mcap")
    with (tmp_path / "snippet.mcap").open("rb") as file:
        times = [(c.topic, (m.log_time - START_NS) / S) for _, c, m in make_reader(file).iter_messages()]
    topics = ("/camera", "/camera/lsnet/annotations", "/camera/lsnet/detections")
    assert sorted(times) == sorted([("/lens", 15.0), *((t, float(s)) for t in topics for s in range(15, 27))])


def test_rerun_reads_what_was_exported(flown: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "rerun", None)
        with pytest.raises(MissingExtraError, match="lsnet-pipe\\[rerun\\]"):
            export_rrd(flown, flight_ids(flown)[0], tmp_path / "a.rrd")
    pytest.importorskip("rerun", reason="rerun-sdk, 170 MB, is not installed")
    assert export_rrd(flown, flight_ids(flown)[0], tmp_path / "a.rrd") == 10
    command = [sys.executable, "-m", "rerun", "rrd", "print", tmp_path / "a.rrd"]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    for entity in ("/camera/image", "/camera/image/lines", "/map/track", "/anomalies", "/numbers"):
        assert entity in printed
