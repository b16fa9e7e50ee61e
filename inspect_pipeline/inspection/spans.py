"""The spans of the grid: read from what people have, kept in spans.geojson of the store.

    spans = read_spans(Path("towers.csv"))
    import_spans(store, spans)

A span is what hangs between two structures. Files name structures in their order along a line, or draw lines.
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import asdict, dataclass, replace
from itertools import count, groupby, pairwise, repeat
from typing import TYPE_CHECKING, Any

from pyproj import Geod

from inspect_pipeline.atomic import store_errors, write_whole
from inspect_pipeline.errors import SpansError
from inspect_pipeline.store.records import parse_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.store.store import Store

_GEOD = Geod(ellps="WGS84")
_FILE = "spans.geojson"
_SHORTEST_M, _LONGEST_M = 0.5, 5_000.0
_COLUMNS = {  # of tables of structures: the names that each may have, small letters, without a unit
    "structure": ("structure_id", "structure", "identifier", "id", "name"),
    "line": ("line_id", "line", "group identifier"),
    "lat": ("latitude", "lat", "lat_deg"),
    "lon": ("longitude", "lon", "lng", "lon_deg"),
    "height": ("height_m", "height"),
    "conductors": ("expected_conductors", "conductors"),
    "kind": ("assettype", "asset type"),
}
_PLACES = ("from_lat_deg", "from_lon_deg", "to_lat_deg", "to_lon_deg")
_TEXTS = frozenset({"span_id", "line_id", "from_structure", "to_structure"})
_NO_STRUCTURES = ("span", "line", "conductor", "segment")  # assets of these types stand nowhere


@dataclass(frozen=True, slots=True)
class Span:
    """A row of the table spans; None for what is not known. Heights: of conductors over the ground."""

    span_id: str
    line_id: str | None
    from_structure: str | None
    to_structure: str | None
    from_lat_deg: float
    from_lon_deg: float
    from_height_m: float | None
    to_lat_deg: float
    to_lon_deg: float
    to_height_m: float | None
    length_m: float
    expected_conductors: int | None


@dataclass(frozen=True, slots=True)
class _Structure:
    name: str | None
    line_id: str | None
    lat_deg: float
    lon_deg: float
    height_m: float | None
    conductors: int | None


def read_spans(path: Path, expected_conductors: int | None = None) -> list[Span]:
    """The spans of a CSV of structures or assets, or of the lines of a GeoJSON.

    expected_conductors stands where the file has none. Raises SpansError for a file that has no spans, or
    what cannot be one.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise SpansError(path, f"cannot be read ({why})", "check the name, and that it is text") from error
    is_json = text.lstrip().startswith("{")
    spans = list(_of_geojson(path, text) if is_json else _of_table(path, text))
    if not spans:
        raise SpansError(path, "has no spans", "give structures in order, or lines")
    seen: set[str] = set()
    for span in spans:
        if span.span_id in seen:
            raise SpansError(path, f"span {span.span_id} is there twice", "name structures or lines apart")
        seen.add(span.span_id)
    if expected_conductors is None:
        return spans
    return [
        replace(span, expected_conductors=span.expected_conductors or expected_conductors) for span in spans
    ]


def _of_table(path: Path, text: str) -> Iterator[Span]:
    """The spans between the structures of a CSV, which follow each other within a line."""
    head = text.partition("\n")[0]
    delimiter = max(";\t,", key=head.count)
    try:
        rows = list(csv.DictReader(text.splitlines(), delimiter=delimiter))
    except csv.Error as error:
        raise SpansError(path, f"is no CSV ({error})", "give structures or assets") from error
    head_names = {(name or "").strip().lower(): name for name in (rows[0] if rows else {})}
    columns = {
        what: next((head_names[n] for n in known if n in head_names), None)
        for what, known in _COLUMNS.items()
    }
    if columns["lat"] is None or columns["lon"] is None:
        raise SpansError(path, "has no columns latitude and longitude", "see docs/inspection.md for columns")
    told = ({what: row.get(column) for what, column in columns.items() if column} for row in rows)
    structures = [
        _structure(path, f"row {number}", one)
        for number, one in enumerate(told, 2)
        if (one.get("kind") or "").strip().lower() not in _NO_STRUCTURES
    ]
    by_line = sorted(structures, key=lambda one: one.line_id or "")  # stable: the order within a line stays
    for _, group in groupby(by_line, key=lambda structure: structure.line_id):
        for number, (first, second) in enumerate(pairwise(group), 1):
            numbered = f"{first.line_id or 'span'}/{number}"
            named = f"{first.name}-{second.name}" if first.name and second.name else numbered
            yield _span(path, first, second, named)


def _structure(path: Path, where: str, told: Mapping[str, object]) -> _Structure:
    """The structure of what is told under the names of `_COLUMNS`; raises SpansError."""
    try:
        lat_deg, lon_deg, height_m = (_number(told.get(name)) for name in ("lat", "lon", "height"))
        conductors = _count(told.get("conductors"))
    except ValueError as error:
        raise SpansError(path, f"{where} has what is no number ({error})", "mend it") from error
    if lat_deg is None or lon_deg is None or abs(lat_deg) > 90 or abs(lon_deg) > 180:
        raise SpansError(path, f"{where} has no position", "give latitude and longitude in degrees")
    name, line_id = (str(told.get(what) or "").strip() or None for what in ("structure", "line"))
    return _Structure(name, line_id, lat_deg, lon_deg, height_m, conductors)


def _number(value: object) -> float | None:
    """A finite number, in a text with a decimal point or comma; None for nothing. Raises ValueError."""
    text = "" if value is None else str(value).strip()
    if not text:
        return None
    number = float(text.replace(",", "."))
    if not math.isfinite(number):
        raise ValueError(text)
    return number


def _count(value: object) -> int | None:
    """A whole number; None for nothing and for 0. Raises ValueError."""
    number = _number(value) or 0.0
    if number < 0 or number != int(number):
        raise ValueError(value)
    return int(number) or None


def _of_geojson(path: Path, text: str) -> Iterator[Span]:
    """The spans of the lines of a GeoJSON: one between each two vertices."""
    try:
        content = parse_json(text)
        features = content["features"] if content["type"] == "FeatureCollection" else [content]
        for number, feature in enumerate(features, 1):
            yield from _of_feature(path, number, feature)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise SpansError(path, f"is no GeoJSON of lines ({error})", "give LineStrings") from error


def _of_feature(path: Path, number: int, feature: Mapping[str, Any]) -> Iterator[Span]:
    geometry, properties = feature["geometry"], feature.get("properties") or {}
    line_id = properties.get("line_id") or properties.get("name") or feature.get("id") or str(number)
    told = {
        "line": line_id,
        "height": properties.get("height_m"),
        "conductors": properties.get("expected_conductors"),
    }
    where, numbers = f"feature {number}", count(1)
    for vertices in _lines_of(geometry):
        is_span = geometry["type"] == "LineString" and len(vertices) == 2
        ends = [_of_end(end, properties) for end in ("from", "to")] if is_span else repeat({})
        structures = [
            _structure(path, where, {**told, "lon": vertex[0], "lat": vertex[1], **end})
            for vertex, end in zip(vertices, ends, strict=False)
        ]
        for first, second in pairwise(structures):
            own = properties.get("span_id") if is_span else None
            yield _span(path, first, second, str(own or f"{line_id}/{next(numbers)}"))


def _lines_of(geometry: Mapping[str, Any]) -> Sequence[Any]:
    """The vertices of each line of a geometry, none of one without lines."""
    coordinates: Sequence[Any] = geometry["coordinates"]
    return {"LineString": [coordinates], "MultiLineString": coordinates}.get(geometry["type"], [])


def _of_end(end: str, properties: Mapping[str, Any]) -> dict[str, object]:
    """What a feature of one span says of its `end`, under the names of `_COLUMNS`."""
    named = {"structure": f"{end}_structure", "height": f"{end}_height_m"}
    return {what: properties[name] for what, name in named.items() if properties.get(name) is not None}


def _span(path: Path, first: _Structure, second: _Structure, span_id: str) -> Span:
    """The span between two structures; raises SpansError when it cannot be one."""
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


def import_spans(store: Store, spans: Sequence[Span]) -> int:
    """Keep spans in the store, in place of those of the same lines, and return how many it has then.

    Raises StoreError, SpansError.
    """
    lines = {span.line_id for span in spans}
    names = {span.span_id for span in spans}
    kept = [one for one in load_spans(store) if one.line_id not in lines and one.span_id not in names]
    path = store.root / _FILE
    with store_errors(path):
        store.root.mkdir(parents=True, exist_ok=True)
        write_whole(path, _to_geojson([*kept, *spans]))
    return len(kept) + len(spans)


def load_spans(store: Store) -> list[Span]:
    """The spans of a store; raises SpansError when the file is damaged."""
    path = store.root / _FILE
    if not path.exists():
        return []
    try:
        features = parse_json(path.read_bytes())["features"]
        return [_checked(Span(**{**feature["properties"], **_ends(feature)})) for feature in features]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise SpansError(path, f"is damaged ({error})", "import the spans again") from error


def _checked(span: Span) -> Span:
    """The same span; raises TypeError for a number that is a text and the reverse."""
    for name, value in asdict(span).items():
        if value is not None and not isinstance(value, str if name in _TEXTS else int | float):
            raise TypeError(f"{name} of span {span.span_id} is {value!r}")
    return span


def _ends(feature: Mapping[str, Any]) -> dict[str, float]:
    (from_lon, from_lat), (to_lon, to_lat) = feature["geometry"]["coordinates"]
    return dict(zip(_PLACES, (from_lat, from_lon, to_lat, to_lon), strict=True))


def _to_geojson(spans: Iterable[Span]) -> str:
    features = []
    for span in spans:
        told = {name: value for name, value in asdict(span).items() if name not in _PLACES}
        ends = [[span.from_lon_deg, span.from_lat_deg], [span.to_lon_deg, span.to_lat_deg]]
        line = {"type": "LineString", "coordinates": ends}
        features.append({"type": "Feature", "properties": told, "geometry": line})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"
