"""Spans from CSV and GeoJSON files written by hand, valid and invalid."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from inspect_pipeline.errors import SpansError
from inspect_pipeline.inspection.span_files import read_spans
from inspect_pipeline.inspection.spans import Span, describe_extent, import_spans, load_spans
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path

TOWERS = """structure_id,line_id,latitude,longitude,height_m,expected_conductors
T1,L12,52.0,5.0,20,4
T2,L12,52.001,5.0,22,4
X1,L7,53.0,6.0,,
T3,L12,52.002,5.0,,4
X2,L7,53.0,6.001,,
"""
# Decimal commas, assets that are no structures, a mark of the byte order, as asset systems export them.
ASSETS = """\ufeffidentifier;name;group identifier;group type;latitude;longitude;assettype;sourcesystem;height
1001;Mast 1;22kV-A;Line;59,9139;10,7522;Tower;SAP;18,5
1002;Mast 2;22kV-A;Line;59,9148;10,7522;Tower;SAP;19,0
1003;Span 1-2;22kV-A;Line;59,9143;10,7522;Span;SAP;
"""


def read(folder: Path, text: str, name: str = "towers.csv", conductors: int | None = None) -> list[Span]:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return read_spans(path, conductors)


def test_structures_follow_each_other_within_their_line(tmp_path: Path) -> None:
    spans = read(tmp_path, TOWERS)
    assert [(one.span_id, one.line_id) for one in spans] == [
        ("T1-T2", "L12"),
        ("T2-T3", "L12"),
        ("X1-X2", "L7"),
    ]
    first, second, third = spans
    assert first.length_m == pytest.approx(111.27, abs=0.02)  # a thousandth of a degree of latitude at 52
    assert third.length_m == pytest.approx(67.14, abs=0.02)  # the same of longitude at 53: times its cosine
    assert (first.from_height_m, first.to_height_m, second.to_height_m) == (20, 22, None)
    assert (first.expected_conductors, third.expected_conductors) == (4, None)
    assert [one.expected_conductors for one in read(tmp_path, TOWERS, conductors=3)] == [4, 4, 3]


def test_assets_as_exported_with_decimal_commas(tmp_path: Path) -> None:
    (span,) = read(tmp_path, ASSETS, "assets.csv")
    assert (span.span_id, span.line_id, span.from_lat_deg) == ("1001-1002", "22kV-A", 59.9139)
    assert (span.from_height_m, span.to_height_m) == (18.5, 19.0)


def test_lines_of_a_geojson(tmp_path: Path) -> None:
    properties = {"name": "North", "expected_conductors": 6}
    line = {"type": "LineString", "coordinates": [[5.0, 52.0], [5.0, 52.001], [5.0, 52.002]]}
    content = {
        "type": "FeatureCollection",
        "features": [{"type": "Feature", "properties": properties, "geometry": line}],
    }
    spans = read(tmp_path, json.dumps(content), "lines.geojson")
    assert [(one.span_id, one.line_id, one.expected_conductors) for one in spans] == [
        ("North/1", "North", 6),
        ("North/2", "North", 6),
    ]
    assert (spans[1].from_lat_deg, spans[1].from_lon_deg) == (52.001, 5.0)


def feature(coordinates: list[Any], kind: str = "LineString", **properties: object) -> str:
    geometry = {"type": kind, "coordinates": coordinates}
    return json.dumps({"type": "Feature", "properties": properties, "geometry": geometry})


def test_numbers_of_a_geojson_may_be_strings(tmp_path: Path) -> None:
    text = feature([["5.0", "52.0"], [5.0, 52.001]], height_m="20,5", to_height_m=0, expected_conductors="3")
    (span,) = read(tmp_path, text, "a.geojson")
    assert (span.from_lat_deg, span.from_height_m, span.to_height_m, span.expected_conductors) == (
        52,
        20.5,
        0,
        3,
    )


def test_asset_ids_of_a_geojson_are_kept(tmp_path: Path) -> None:
    text = feature([[5.0, 52.0], [5.0, 52.001]], mRID="_4f1c", assetId=1207)
    (span,) = read(tmp_path, text, "a.geojson")
    assert (span.asset_id, span.mrid) == ("1207", "_4f1c")


def test_lines_of_one_feature_are_not_connected(tmp_path: Path) -> None:
    lines = [[[5.0, 52.0], [5.0, 52.001], [5.0, 52.002]], [[5.0, 52.003], [5.0, 52.004]]]
    spans = read(tmp_path, feature(lines, "MultiLineString", name="N", span_id="x"), "a.geojson")
    assert [(one.span_id, one.from_lat_deg) for one in spans] == [
        ("N/1", 52),
        ("N/2", 52.001),
        ("N/3", 52.003),
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no columns latitude and longitude"),
        ("a,b\n1,2\n", "no columns latitude and longitude"),
        ("id,latitude,longitude\nT1,52,5\n", "has no spans"),
        ("id,latitude,longitude\nT1,52,5\nT2,abc,5\n", "row 3: 'abc' is not a number"),
        ("id,latitude,longitude\nT1,52,5\nT2,,5\n", "row 3 has no position"),
        ("id,latitude,longitude\nT1,52,5\nT2,152,5\n", "row 3: latitude 152, longitude 5 is out of range"),
        ("id,latitude,longitude\nT1,52,5\nT2,53,5\n", "in their order"),
        ("id,latitude,longitude\nT1,52,5\nT2,52,5\n", "0 m long"),
        ("id,latitude,longitude\nA,52,5\nB,52.001,5\nA,52.002,5\nB,52.003,5\n", "has span A-B twice"),
        ("id,lat,lon,height\nT1,52,5,nan\nT2,52.001,5,9\n", "row 2: 'nan' is not a number"),
        ("id,lat,lon,conductors\nT1,52,5,3\nT2,52.001,5,inf\n", "row 3: 'inf' is not a number"),
        ("id,lat,lon,conductors\nT1,52,5,3\nT2,52.001,5,2.7\n", "row 3: '2.7' is not a whole number"),
        ("id,lat,lon,conductors\nT1,52,5,-3\nT2,52.001,5,\n", "row 2: '-3' is not a whole number"),
        ("id,lat,lon\nT1,52," + 150_000 * "9", "is not a valid CSV"),
        (feature([[5, 52], [5, 52.001]], height_m="20 m"), "feature 1: '20 m' is not a number"),
        (feature([[500_000, 5_760_000], [500_100, 5_760_000]]), "feature 1: latitude .* is out of range"),
        ("{", "is not a GeoJSON"),
        ('{"type": "FeatureCollection"}', "is not a GeoJSON"),
        ('{"type": "FeatureCollection", "features": [{"geometry": null}]}', "is not a GeoJSON"),
        (
            '{"type": "Feature", "geometry": {"type": "Point", "coordinates": [5, 52]}}',
            "points, not lines; give structures as a CSV",
        ),
        ('<?xml version="1.0"?><kml/>', "such as KML; convert it: ogr2ogr spans.geojson towers.csv"),
    ],
)
def test_invalid_files_raise_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(SpansError, match=words) as caught:
        read(tmp_path, text)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(SpansError, match="cannot be read"):
        read_spans(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SpansError, match="cannot be read"):
        read_spans(tmp_path / "binary.csv")


def test_an_import_replaces_its_lines_and_keeps_the_others(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    spans = read(tmp_path, TOWERS)
    assert import_spans(store, spans) == 3
    assert load_spans(store) == spans
    moved = read(tmp_path, "id,line,lat,lon\nT1,L12,52.0,5.0\nT9,L12,52.0005,5.0\n")
    assert import_spans(store, moved) == 2
    assert [one.span_id for one in load_spans(store)] == ["X1-X2", "T1-T9"]


def test_spans_geojson_of_the_store_can_be_imported(tmp_path: Path) -> None:
    store = Store(tmp_path / "store")
    spans = read(tmp_path, TOWERS)
    import_spans(store, spans)
    assert read_spans(store.root / "spans.geojson") == spans
    for damaged in ("{}", (store.root / "spans.geojson").read_text().replace("22.0", '"22 m"')):
        (store.root / "spans.geojson").write_text(damaged)
        with pytest.raises(SpansError, match="import the spans again"):
            load_spans(store)


def test_extent_is_described(tmp_path: Path) -> None:
    text = describe_extent(read(tmp_path, TOWERS))
    assert text == "0.29 km, latitude 52.00000 to 53.00000, longitude 5.00000 to 6.00100"
