"""Readers of files that describe spans.

A span is the part of a line between two structures. Files list structures in their order along a line, or
have the lines themselves.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from itertools import count, groupby, pairwise, repeat
from typing import TYPE_CHECKING, Any

from pyproj import Geod

from inspect_pipeline.errors import SpansError
from inspect_pipeline.inspection.spans import Span, describe_error
from inspect_pipeline.store.records import parse_json

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

_GEOD = Geod(ellps="WGS84")
_SHORTEST_M, _LONGEST_M = 0.5, 5_000.0
_COLUMNS = {  # names that each column of a table may have, in lower case
    "structure": ("structure_id", "structure", "identifier", "id", "name"),
    "line": ("line_id", "line", "group identifier"),
    "lat": ("latitude", "lat", "lat_deg"),
    "lon": ("longitude", "lon", "lng", "lon_deg"),
    "height": ("height_m", "height"),
    "conductors": ("expected_conductors", "conductors"),
    "kind": ("assettype", "asset type"),
}
_NO_STRUCTURES = ("span", "line", "conductor", "segment")  # types of assets that are not structures


@dataclass(frozen=True, slots=True)
class _Structure:
    name: str | None
    line_id: str | None
    lat_deg: float
    lon_deg: float
    height_m: float | None
    conductors: int | None


def read_spans(path: Path, expected_conductors: int | None = None) -> list[Span]:
    """Read spans from a CSV of structures or assets, or from the lines of a GeoJSON.

    Args:
        path: the file.
        expected_conductors: the number for spans without one in the file.

    Raises:
        SpansError: the file has no spans, or something that cannot be one.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise SpansError(path, f"cannot be read as text ({why})", "check its name and format") from error
    start = text.lstrip()[:1]
    if start == "<":
        raise SpansError(path, "is XML, such as KML", f"convert it: ogr2ogr spans.geojson {path.name}")
    spans = list(_read_geojson(path, text) if start == "{" else _read_table(path, text))
    if not spans:
        raise SpansError(
            path, "has no spans", "give at least two structures of a line in order, or LineStrings"
        )
    names: set[str] = set()
    for span in spans:
        if span.span_id in names:
            raise SpansError(path, f"has span {span.span_id} twice", "give structures or lines unique names")
        names.add(span.span_id)
    if expected_conductors is None:
        return spans
    return [
        replace(span, expected_conductors=span.expected_conductors or expected_conductors) for span in spans
    ]


def _read_table(path: Path, text: str) -> Iterator[Span]:
    """Yield the spans between consecutive structures of each line of a CSV."""
    head = text.partition("\n")[0]
    delimiter = max(";\t,", key=head.count)
    try:
        rows = list(csv.DictReader(text.splitlines(), delimiter=delimiter))
    except csv.Error as error:
        raise SpansError(path, f"is not a valid CSV ({error})", "give structures or assets") from error
    head_names = {(name or "").strip().lower(): name for name in (rows[0] if rows else {})}
    columns = {
        what: next((head_names[n] for n in known if n in head_names), None)
        for what, known in _COLUMNS.items()
    }
    if columns["lat"] is None or columns["lon"] is None:
        raise SpansError(
            path, "has no columns latitude and longitude", "docs/inspection.md lists the columns"
        )
    named_rows = ({what: row.get(column) for what, column in columns.items() if column} for row in rows)
    structures = [
        _structure(path, f"row {number}", one)
        for number, one in enumerate(named_rows, 2)
        if (one.get("kind") or "").strip().lower() not in _NO_STRUCTURES
    ]
    by_line = sorted(structures, key=lambda one: one.line_id or "")  # stable
    for _, group in groupby(by_line, key=lambda structure: structure.line_id):
        for number, (first, second) in enumerate(pairwise(group), 1):
            numbered = f"{first.line_id or 'span'}/{number}"
            named = f"{first.name}-{second.name}" if first.name and second.name else numbered
            yield _span(path, first, second, named)


def _structure(path: Path, where: str, values: Mapping[str, object]) -> _Structure:
    """Return a structure from values named as in `_COLUMNS`. Raises SpansError."""
    try:
        lat_deg, lon_deg, height_m = (_number(values.get(name)) for name in ("lat", "lon", "height"))
        conductors = _count(values.get("conductors"))
    except ValueError as error:
        raise SpansError(path, f"{where}: {error}", "correct it") from error
    if lat_deg is None or lon_deg is None:
        raise SpansError(path, f"{where} has no position", "give latitude and longitude in degrees")
    if abs(lat_deg) > 90 or abs(lon_deg) > 180:
        problem = f"{where}: latitude {lat_deg:g}, longitude {lon_deg:g} is out of range"
        raise SpansError(path, problem, "give degrees (WGS 84), latitude and longitude not swapped")
    name, line_id = (str(values.get(what) or "").strip() or None for what in ("structure", "line"))
    return _Structure(name, line_id, lat_deg, lon_deg, height_m, conductors)


def _number(value: object) -> float | None:
    """Parse a finite number with a decimal point or comma, None when empty. Raises ValueError."""
    text = "" if value is None else str(value).strip()
    if not text:
        return None
    try:
        number = float(text.replace(",", "."))
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{text[:40]!r} is not a number")
    return number


def _count(value: object) -> int | None:
    """Parse a whole number, None when empty or 0. Raises ValueError."""
    number = _number(value) or 0.0
    if number < 0 or number != int(number):
        raise ValueError(f"{str(value)[:40]!r} is not a whole number")
    return int(number) or None


def _read_geojson(path: Path, text: str) -> Iterator[Span]:
    """Yield a span between each two consecutive vertices of the lines of a GeoJSON."""
    try:
        content = parse_json(text)
        features = content["features"] if content["type"] == "FeatureCollection" else [content]
        kinds = {(feature.get("geometry") or {}).get("type") for feature in features}
        if kinds and kinds <= {"Point", "MultiPoint"}:
            raise SpansError(
                path, "has points, not lines", "give structures as a CSV, in their order along a line"
            )
        for number, feature in enumerate(features, 1):
            yield from _read_feature(path, number, feature)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise SpansError(
            path, f"is not a GeoJSON of lines ({describe_error(error)})", "give LineStrings"
        ) from error


def _read_feature(path: Path, number: int, feature: Mapping[str, Any]) -> Iterator[Span]:
    geometry, properties = feature["geometry"], feature.get("properties") or {}
    line_id = properties.get("line_id") or properties.get("name") or feature.get("id") or str(number)
    values = {
        "line": line_id,
        "height": properties.get("height_m"),
        "conductors": properties.get("expected_conductors"),
    }
    where, numbers = f"feature {number}", count(1)
    asset_id, mrid = _asset_ids(properties)
    for vertices in _line_vertices(geometry):
        is_span = geometry["type"] == "LineString" and len(vertices) == 2
        ends = [_end_values(end, properties) for end in ("from", "to")] if is_span else repeat({})
        structures = [
            _structure(path, where, {**values, "lon": vertex[0], "lat": vertex[1], **end})
            for vertex, end in zip(vertices, ends, strict=False)
        ]
        for first, second in pairwise(structures):
            own = properties.get("span_id") if is_span else None
            span = _span(path, first, second, str(own or f"{line_id}/{next(numbers)}"))
            yield replace(span, asset_id=asset_id, mrid=mrid)


def _line_vertices(geometry: Mapping[str, Any]) -> Sequence[Any]:
    """Return the vertices of each line of a geometry, none for other geometries."""
    coordinates: Sequence[Any] = geometry["coordinates"]
    return {"LineString": [coordinates], "MultiLineString": coordinates}.get(geometry["type"], [])


def _asset_ids(properties: Mapping[str, Any]) -> tuple[str | None, str | None]:
    """Return the asset id and the mRID among properties, such as `asset_id`, `assetId` and `mRID`."""
    named = {name.lower().replace("_", ""): value for name, value in properties.items()}
    asset_id, mrid = (str(named.get(name) or "") or None for name in ("assetid", "mrid"))
    return asset_id, mrid


def _end_values(end: str, properties: Mapping[str, Any]) -> dict[str, object]:
    """Return the properties of one end of a span, named as in `_COLUMNS`."""
    named = {"structure": f"{end}_structure", "height": f"{end}_height_m"}
    return {what: properties[name] for what, name in named.items() if properties.get(name) is not None}


def _span(path: Path, first: _Structure, second: _Structure, span_id: str) -> Span:
    """Return the span between two structures. Raises SpansError when it is too short or too long."""
    places = first.lon_deg, first.lat_deg, second.lon_deg, second.lat_deg
    length_m = float(_GEOD.inv(*places)[2])
    if not _SHORTEST_M < length_m < _LONGEST_M:
        remedy = "give structures in their order along a line"
        raise SpansError(path, f"span {span_id} is {length_m:.0f} m long", remedy)
    return Span(
        span_id=span_id,
        line_id=first.line_id,
        from_structure=first.name,
        to_structure=second.name,
        from_lat_deg=first.lat_deg,
        from_lon_deg=first.lon_deg,
        from_height_m=first.height_m,
        to_lat_deg=second.lat_deg,
        to_lon_deg=second.lon_deg,
        to_height_m=second.height_m,
        length_m=round(length_m, 3),
        expected_conductors=first.conductors or second.conductors,
    )
