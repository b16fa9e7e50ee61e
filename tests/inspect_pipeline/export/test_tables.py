"""Exports of rows, read back by other programs: the same rows, at the same places."""

from __future__ import annotations

import csv
import io
import json
import sys
from typing import TYPE_CHECKING

import defusedxml.ElementTree
import flights
import geopandas
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pytest
from pyproj import Geod

from inspect_pipeline.errors import MissingExtraError, OutputError
from inspect_pipeline.export.rows import Redaction, Rows
from inspect_pipeline.export.tables import TABLE_FORMATS, export_rows
from inspect_pipeline.export.text import write_csv, write_geojson, write_kml
from inspect_pipeline.index.reading import select

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.store import Store

IDS = [flights.flight_id_of(name) for name in ("monday", "tuesday", "broken")]
# Every format with points and with lines; all else in a format of each kind.
PAIRS = [
    (what, form)
    for what, forms in TABLE_FORMATS.items()
    for form in forms
    if what in {"frames", "spans"} or form in {"geojson", "csv"}
]
SUFFIXES = {"geojson": ".geojson", "gpkg": ".gpkg", "kml": ".kml", "csv": ".csv"}
ENDS = dict.fromkeys(("spans", "conductors", "gaps"), ("from_", "to_"))
COUNTS = {
    "frames": "SELECT count(*) AS n FROM frames",
    "lines": "SELECT count(*) AS n FROM lines",
    "gaps": "SELECT count(*) AS n FROM coverage_gaps",
    "anomalies": "SELECT count(*) AS n FROM anomalies",
    "signals": "SELECT count(*) AS n FROM signals",
    "conductors": "SELECT count(*) AS n FROM conductors",
    "spans": "SELECT (SELECT count(*) FROM span_coverage) + count(*) AS n FROM spans"
    " WHERE span_id NOT IN (SELECT span_id FROM span_coverage)",
}


def read_back(path: Path, form: str) -> pd.DataFrame:
    if form == "csv":
        return pd.read_csv(path)
    if form == "parquet":
        return pq.read_table(path).to_pandas()
    if form == "geoparquet":
        return geopandas.read_parquet(path)
    return pyogrio.read_dataframe(path)


@pytest.mark.parametrize(("what", "form"), PAIRS)
def test_an_export_is_read_back_equal(store: Store, tmp_path: Path, what: str, form: str) -> None:
    path = tmp_path / f"rows{SUFFIXES.get(form, '.parquet')}"
    rows = export_rows(store, IDS, what, path, form=form)
    found = read_back(path, form)
    assert len(found) == rows.n_rows == select(store, COUNTS[what])[0]["n"] > 0
    if form in {"csv", "parquet"} or what == "lines":
        return
    expected = [row for row in read_rows(store, what) if None not in row]
    shapes = [shape for shape in found.geometry if shape is not None and not shape.is_empty]
    places = [np.ravel([point[:2] for point in shape.coords]) for shape in shapes]
    assert len(places) == rows.n_placed == len(expected) > 0
    np.testing.assert_allclose(sorted(map(tuple, places)), sorted(expected), rtol=0, atol=1e-7)


def read_rows(store: Store, what: str) -> list[tuple[float, ...]]:
    """Longitude and latitude of the ends of each row, as the tables of the index have them."""
    if what == "conductors":
        rows = select(store, "FROM conductors JOIN spans USING (span_id)")
        return [beside(row) for row in rows]
    names = ", ".join(f"{end}lon_deg, {end}lat_deg" for end in ENDS.get(what, ("",)))
    sources = {
        "frames": "frames",
        "anomalies": "anomalies",
        "signals": "signals JOIN frames USING (flight_id, channel_id, frame_idx)",
        "spans": "spans LEFT JOIN span_coverage USING (span_id)",
        "gaps": "(SELECT a.lat_deg AS from_lat_deg, a.lon_deg AS from_lon_deg, b.lat_deg AS to_lat_deg,"
        " b.lon_deg AS to_lon_deg FROM coverage_gaps g, frames a, frames b"
        " WHERE a.flight_id = g.flight_id AND b.flight_id = g.flight_id"
        " AND a.frame_idx = g.first_frame_idx AND b.frame_idx = g.last_frame_idx)",
    }
    return [tuple(row.values()) for row in select(store, f"SELECT {names} FROM {sources[what]}")]


def beside(row: dict[str, float]) -> tuple[float, ...]:
    """The ends of a span moved to the left of it, by geodesics."""
    ends = [(row[f"{end}_lon_deg"], row[f"{end}_lat_deg"]) for end in ("from", "to")]
    geod = Geod(ellps="WGS84")
    azimuth_deg, _, _ = geod.inv(*ends[0], *ends[1])
    return tuple(v for end in ends for v in geod.fwd(*end, azimuth_deg - 90, row["across_m"])[:2])


def test_values_are_the_same_in_csv_and_geojson(store: Store, tmp_path: Path) -> None:
    for form in ("csv", "geojson"):
        export_rows(store, IDS[:1], "frames", tmp_path / f"a.{form}", form=form)
    features = json.loads((tmp_path / "a.geojson").read_text())["features"]
    with (tmp_path / "a.csv").open() as file:
        cells = list(csv.DictReader(file))
    for feature, row in zip(features, cells, strict=True):
        values = feature["properties"]
        assert float(row["sharpness"]) == pytest.approx(values["sharpness"])
        assert row["log_time_utc"] == values["log_time_utc"]
        assert values["log_time_utc"].endswith("Z")
        assert pd.Timestamp(row["log_time_utc"]).value == int(row["log_time_ns"])


def test_fuzzed_places_keep_their_shape(store: Store, tmp_path: Path) -> None:
    redaction = Redaction.of("fuzz")
    export_rows(store, IDS[:1], "frames", tmp_path / "a.csv", form="csv")
    export_rows(store, IDS[:1], "frames", tmp_path / "b.csv", form="csv", redaction=redaction)
    before, after = (pd.read_csv(tmp_path / name) for name in ("a.csv", "b.csv"))
    for name in ("lat_deg", "lon_deg"):
        offsets = (after[name] - before[name]).dropna()
        assert offsets.max() - offsets.min() < 1e-9
        assert offsets.abs().min() > 0.09
    assert after["alt_m"].isna().all()
    assert before["alt_m"].notna().all()
    again = Redaction.of("fuzz")
    assert (again.north_deg, again.east_deg) != (redaction.north_deg, redaction.east_deg)


@pytest.mark.parametrize("form", ["geojson", "kml", "gpkg", "geoparquet", "csv"])
def test_dropped_places_are_nowhere(store: Store, tmp_path: Path, form: str) -> None:
    path = tmp_path / f"a{SUFFIXES.get(form, '.parquet')}"
    rows = export_rows(store, IDS[:1], "spans", path, form=form, redaction=Redaction.of("drop"))
    assert (rows.n_rows > 0, rows.n_placed) == (True, 0)
    content = path.read_bytes()
    for longitude, latitude, *_ in read_rows(store, "spans"):
        assert repr(longitude)[:9].encode() not in content
        assert np.float64(latitude).tobytes() not in content
    if form in {"geojson", "kml"}:
        assert b"coordinates and altitudes were removed" in content


def test_moved_longitudes_stay_in_the_world() -> None:
    batch = pa.record_batch({"lon_deg": [179.0, -179.0, 0.0, None], "lat_deg": [0.0, 1.0, 2.0, None]})
    east = Redaction(0.25, 15.0).apply(batch).to_pydict()
    assert east["lon_deg"] == pytest.approx([-166.0, -164.0, 15.0, None])
    west = Redaction(0.25, -15.0).apply(batch).to_pydict()
    assert west["lon_deg"] == pytest.approx([164.0, 166.0, -15.0, None])
    assert west["lat_deg"] == pytest.approx([0.25, 1.25, 2.25, None])


def hostile_rows(what: str = "anomalies") -> Rows:
    names = [
        "=1+1",
        "<script>alert(1)</script>",
        "]]></value>",
        "\x1b[2J&",
        'a"b',
        "+1",
        "-2",
        "@x",
        "é, \n;",
    ]
    table = pa.table(
        {
            "kind": names,
            "reason": names[::-1],
            "verdict": ["open"] * len(names),
            "lat_deg": [47.0] * len(names),
            "lon_deg": [-7.5] * len(names),
        }
    )
    return Rows(what, table.to_reader())


def test_hostile_names_are_no_formulas_in_csv() -> None:
    file = io.StringIO()
    write_csv(hostile_rows(), file)
    rows = list(csv.DictReader(io.StringIO(file.getvalue())))
    assert not any(row["kind"].startswith(("=", "+", "-", "@")) for row in rows)
    assert rows[0]["kind"] == "'=1+1"
    assert {row["lon_deg"] for row in rows} == {"-7.5"}  # a number stays one
    assert rows[-1]["kind"] == "é, \n;"


def test_hostile_names_are_text_in_kml_and_geojson(tmp_path: Path) -> None:
    file = io.StringIO()
    write_kml(hostile_rows(), file)
    root = defusedxml.ElementTree.fromstring(file.getvalue())
    space = "{http://www.opengis.net/kml/2.2}"
    marks = root.findall(f".//{space}Placemark")
    assert len(marks) == 9
    assert {element.tag.removeprefix(space) for mark in marks for element in mark} == {
        "name",
        "styleUrl",
        "ExtendedData",
        "Point",
    }
    assert marks[1].find(f"{space}name").text == "&lt;script&gt;alert(1)&lt;/script&gt;"  # HTML of a balloon
    assert "\x1b" not in file.getvalue()
    path = tmp_path / "a.geojson"
    with path.open("w") as text:
        write_geojson(hostile_rows(), text)
    assert list(pyogrio.read_dataframe(path)["kind"]) == [row["kind"] for row in hostile_rows().dicts()]


def test_kml_is_never_under_the_ground(store: Store, tmp_path: Path) -> None:
    """Heights count from the ground where they are known; all else lies on it."""
    space = "{http://www.opengis.net/kml/2.2}"
    modes = {}
    for what in ("frames", "spans", "gaps", "anomalies"):
        export_rows(store, IDS, what, tmp_path / "a.kml", form="kml")
        root = defusedxml.ElementTree.parse(tmp_path / "a.kml").getroot()
        modes[what] = {element.text for element in root.iter(f"{space}altitudeMode")}
        if what == "frames":
            heights = [float(e.text.split(",")[2]) for e in root.iter(f"{space}coordinates")]
            assert min(heights) > 5
    assert modes == {
        "frames": {"relativeToGround"},
        "spans": {"relativeToGround"},
        "gaps": {"clampToGround"},
        "anomalies": {"clampToGround"},
    }


@pytest.mark.parametrize("form", TABLE_FORMATS["frames"])
def test_a_file_that_cannot_be_written_is_one_line(store: Store, tmp_path: Path, form: str) -> None:
    path = tmp_path / "none" / "a"
    with pytest.raises(OutputError) as error:
        export_rows(store, IDS, "frames", path, form=form)
    assert select(store, "SELECT 1 AS one") == [{"one": 1}]  # while the error keeps the rows
    assert str(error.value) == f"{path}: cannot be written (No such file or directory); name another file"


def test_a_missing_extra_is_named(store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'lsnet-pipe\[geo\]'"):
        export_rows(store, IDS, "frames", tmp_path / "a.gpkg", form="gpkg")
    assert not list(tmp_path.iterdir())
