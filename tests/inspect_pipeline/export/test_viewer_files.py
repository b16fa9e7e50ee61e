"""review.mcap and layout.json, as the plain reader and the rules of viewers see them."""

from __future__ import annotations

import html
import json
import shutil
from typing import TYPE_CHECKING, Any

import flights
import jsonschema
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from inspect_pipeline import publishing
from inspect_pipeline.export.layout import make_layout
from inspect_pipeline.export.review import RED, to_feature
from inspect_pipeline.index.reading import select
from inspect_pipeline.store.feedback import add_review
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

MONDAY = flights.flight_id_of("monday")
# What Lichtblick reads of a layout file: panels by "Type!id", and a tree of two children each.
LAYOUT_SCHEMA = {
    "type": "object",
    "required": ["configById", "globalVariables", "userNodes", "playbackConfig", "layout"],
    "additionalProperties": False,
    "properties": {
        **{name: {"type": "object"} for name in ("globalVariables", "userNodes", "playbackConfig")},
        "configById": {"type": "object", "propertyNames": {"pattern": r"^(Image|Plot|map|RosOut)!\w+$"}},
        "layout": {"$ref": "#/$defs/node"},
    },
    "$defs": {
        "node": {
            "anyOf": [
                {"type": "string", "pattern": r"^\w+!\w+$"},
                {
                    "type": "object",
                    "required": ["direction", "splitPercentage", "first", "second"],
                    "properties": {
                        "direction": {"enum": ["row", "column"]},
                        "splitPercentage": {"type": "number", "minimum": 5, "maximum": 95},
                        "first": {"$ref": "#/$defs/node"},
                        "second": {"$ref": "#/$defs/node"},
                    },
                },
            ]
        }
    },
}


def read(path: Path) -> list[tuple[str, int, Any]]:
    """(topic, log time, message) of a recording in the order of its reader."""
    found = []
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            decoded: Any
            if schema.encoding == "protobuf":
                decoded = DecoderFactory().decoder_for("protobuf", schema)(message.data)
            else:
                decoded = json.loads(message.data)
                jsonschema.validate(decoded, json.loads(schema.data))
            found.append((channel.topic, message.log_time, decoded))
    return found


@pytest.fixture(scope="module")
def review(store: Store) -> list[tuple[str, int, Any]]:
    return read(store.flight_dir(MONDAY) / "review.mcap")


def of(review: list[tuple[str, int, Any]], topic: str) -> list[tuple[int, Any]]:
    return [
        (time_ns, json.loads(message.geojson) if hasattr(message, "geojson") else message)
        for its_topic, time_ns, message in review
        if its_topic == topic
    ]


def test_there_is_a_number_for_every_frame(store: Store, review: list[tuple[str, int, Any]]) -> None:
    frames = select(
        store, "SELECT frame_idx, log_time_ns, n_lines FROM frames WHERE flight_id = ? ORDER BY 1", [MONDAY]
    )
    found = of(review, "/camera/lsnet/numbers")
    numbers = [(n["frame_idx"], time_ns, n["n_lines"]) for time_ns, n in found]
    assert numbers == [tuple(frame.values()) for frame in frames]
    assert [n["signals"] for _, n in found] == [{"battery": 90.0 - n["frame_idx"]} for _, n in found]


def test_the_track_is_the_path_at_its_times(store: Store, review: list[tuple[str, int, Any]]) -> None:
    frames = select(
        store,
        "SELECT lon_deg, lat_deg, log_time_ns FROM frames WHERE flight_id = ? ORDER BY frame_idx",
        [MONDAY],
    )
    pieces = of(review, "/camera/lsnet/track")
    places = {(f["lon_deg"], f["lat_deg"]): f["log_time_ns"] for f in frames}
    for time_ns, piece in pieces:
        assert places[tuple(piece["geometry"]["coordinates"][0])] == time_ns
    joined = [tuple(p) for _, piece in pieces for p in piece["geometry"]["coordinates"][:-1]]
    assert joined == [(f["lon_deg"], f["lat_deg"]) for f in frames][: len(joined)]
    assert len(joined) == len(frames) - 1
    assert len({piece["properties"]["style"]["color"] for _, piece in pieces}) > 1  # of blurred frames too


def test_anomalies_are_in_the_log_and_on_the_map(store: Store, review: list[tuple[str, int, Any]]) -> None:
    rows = select(store, "SELECT * FROM reviewed_anomalies WHERE flight_id = ? ORDER BY start_ns", [MONDAY])
    log = of(review, "/lsnet/review/log")
    assert sorted((time_ns, line.name) for time_ns, line in log) == sorted(
        (r["start_ns"], r["kind"]) for r in rows
    )
    levels = {line.name: line.level for _, line in log if line.message.startswith("dismissed")}
    assert set(levels) == {"blurred_frames"}
    placed = of(review, "/lsnet/review/anomalies")
    expected = sorted((r["start_ns"], r["lon_deg"], r["lat_deg"]) for r in rows if r["lat_deg"] is not None)
    rings = [(time_ns, np.array(f["geometry"]["coordinates"][0][:-1])) for time_ns, f in placed]
    found = sorted((time_ns, *ring.mean(axis=0)) for time_ns, ring in rings)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)
    assert len(of(review, "/lsnet/review/spans")) == len(select(store, "FROM spans"))


def test_messages_are_in_order_and_the_same_again(store: Store, tmp_path: Path) -> None:
    copy = Store(shutil.copytree(store.root, tmp_path / "copy"))
    path = copy.flight_dir(MONDAY) / "review.mcap"
    before = path.read_bytes()
    times_ns = [time_ns for _, time_ns, _ in read(path)]
    assert times_ns == sorted(times_ns)
    path.rename(path.with_name(".review.mcap.1.part"))  # as if killed
    (copy.root / "derived.json").unlink()
    publishing.publish(copy)
    assert path.read_bytes() == before
    assert not list(path.parent.glob(".*"))


def test_a_review_is_shown_at_once_and_other_flights_stay(store: Store, tmp_path: Path) -> None:
    copy = Store(shutil.copytree(store.root, tmp_path / "copy"))
    own, other = (
        copy.flight_dir(flights.flight_id_of(name)) / "review.mcap" for name in ("monday", "tuesday")
    )
    inodes = own.stat().st_ino, other.stat().st_ino
    publishing.publish(copy)
    assert (own.stat().st_ino, other.stat().st_ino) == inodes
    open_one = "SELECT * FROM reviewed_anomalies WHERE flight_id = ? AND verdict = 'open' LIMIT 1"
    (anomaly,) = select(copy, open_one, [MONDAY])
    add_review(copy, anomaly, "confirmed", "")
    publishing.publish(copy)
    lines = [message for _, message in of(read(own), "/lsnet/review/log")]
    assert any(line.message.startswith("confirmed") for line in lines)
    assert other.stat().st_ino == inodes[1]


def test_the_layout_of_a_flight_shows_its_topics(store: Store, review: list[tuple[str, int, Any]]) -> None:
    layout = json.loads((store.flight_dir(MONDAY) / "layout.json").read_text())
    jsonschema.validate(layout, LAYOUT_SCHEMA)
    assert leaves(layout["layout"]) == set(layout["configById"])
    (image,) = (c for name, c in layout["configById"].items() if name.startswith("Image"))
    assert image["imageMode"]["annotations"] == {"/camera/lsnet/annotations": {"visible": True}}
    assert image["imageMode"]["synchronize"] is True
    topics = {topic for topic, *_ in review}
    (plot,) = (c for name, c in layout["configById"].items() if name.startswith("Plot"))
    assert {path["value"].split(".")[0] for path in plot["paths"]} <= topics
    assert layout["configById"]["RosOut!lsnet"]["topicToRender"] in topics


@pytest.mark.parametrize("n_cameras", [0, 1, 2, 3, 9])
@pytest.mark.parametrize("centre", [(47.0, 8.5), None])
def test_layouts_of_any_number_of_cameras(n_cameras: int, centre: tuple[float, float] | None) -> None:
    layout = make_layout([f"/camera{i}" for i in range(n_cameras)], ["battery"], centre)
    jsonschema.validate(layout, LAYOUT_SCHEMA)
    assert leaves(layout["layout"]) == set(layout["configById"])
    assert ("map!lsnet" in layout["configById"]) == bool(centre)


def test_names_are_text_in_the_tooltips_of_maps() -> None:
    """Leaflet takes them for HTML."""
    point = {"type": "Point", "coordinates": [8.5, 47.0]}
    name = to_feature(point, "span <img src=x onerror=alert(1)> & more", RED)["properties"]["name"]
    assert "<" not in name
    assert html.unescape(name) == "span <img src=x onerror=alert(1)> & more"


def leaves(node: Any) -> set[str]:
    return {node} if isinstance(node, str) else leaves(node["first"]) | leaves(node["second"])


def test_annotations_are_matched_to_their_images(flown: Store) -> None:
    """By the rule of Lichtblick: stamps equal in ns, and an annotation for frames without lines too."""
    (stored,), _ = flown.scan()
    messages = read(stored.folder / "annotated.mcap")
    images = [m.timestamp.ToNanoseconds() for topic, _, m in messages if topic == "/camera/image"]
    annotations = [m for topic, _, m in messages if topic == "/camera/image/lsnet/annotations"]
    assert len(images) == 10
    for stamp_ns, annotation in zip(images, annotations, strict=True):
        assert annotation.points
        assert {points.timestamp.ToNanoseconds() for points in annotation.points} == {stamp_ns}
    shown = [sum(bool(points.points) for points in annotation.points) for annotation in annotations]
    rows = select(flown, "SELECT n_lines FROM frames ORDER BY frame_idx")
    assert shown == [row["n_lines"] for row in rows]
    assert set(shown) == {0, 2}
    layout = json.loads((stored.folder / "layout.json").read_text())
    assert list(layout["configById"]["Image!lsnet0"]["imageMode"]["annotations"]) == [
        "/camera/image/lsnet/annotations"
    ]
