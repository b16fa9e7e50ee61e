"""Spans of the grid, kept in spans.geojson of the store.

spans = read_spans(Path("towers.csv"))      # see span_files
import_spans(store, spans)
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from inspect_pipeline.atomic import store_errors, write_whole
from inspect_pipeline.errors import SpansError
from inspect_pipeline.store.records import parse_json

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from inspect_pipeline.store.store import Store

_FILE = "spans.geojson"
_ENDS = ("from_lat_deg", "from_lon_deg", "to_lat_deg", "to_lon_deg")
_TEXTS = frozenset({"span_id", "line_id", "from_structure", "to_structure", "asset_id", "mrid"})


@dataclass(frozen=True, slots=True)
class Span:
    """A row of the table spans, None for unknown values. Heights are those of conductors above the ground.

    asset_id and mrid are the ids by which the owner's systems know it.
    """

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
    asset_id: str | None = None
    mrid: str | None = None


def import_spans(store: Store, spans: Sequence[Span]) -> int:
    """Save spans in a store, replacing those of the same lines, and return how many it has then.

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
    """Return the spans of a store. Raises SpansError when the file is damaged."""
    path = store.root / _FILE
    if not path.exists():
        return []
    try:
        features = parse_json(path.read_bytes())["features"]
        return [
            _checked(Span(**{**feature["properties"], **_end_positions(feature)})) for feature in features
        ]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise SpansError(path, f"is damaged ({describe_error(error)})", "import the spans again") from error


def _checked(span: Span) -> Span:
    """Return the same span. Raises TypeError for a text in place of a number, and the reverse."""
    for name, value in asdict(span).items():
        if value is not None and not isinstance(value, str if name in _TEXTS else int | float):
            raise TypeError(f"{name} of span {span.span_id} is {value!r}")
    return span


def _end_positions(feature: Mapping[str, Any]) -> dict[str, float]:
    (from_lon, from_lat), (to_lon, to_lat) = feature["geometry"]["coordinates"]
    return dict(zip(_ENDS, (from_lat, from_lon, to_lat, to_lon), strict=True))


def _to_geojson(spans: Iterable[Span]) -> str:
    features = []
    for span in spans:
        properties = {name: value for name, value in asdict(span).items() if name not in _ENDS}
        ends = [[span.from_lon_deg, span.from_lat_deg], [span.to_lon_deg, span.to_lat_deg]]
        line = {"type": "LineString", "coordinates": ends}
        features.append({"type": "Feature", "properties": properties, "geometry": line})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def describe_error(error: Exception) -> str:
    """Return the first line of an error, with the name of a missing key spelled out."""
    return f"{error} is missing" if isinstance(error, KeyError) else str(error).partition("\n")[0]


def describe_extent(spans: Sequence[Span]) -> str:
    """Return the length and the bounds of spans in words."""
    lats = [lat for span in spans for lat in (span.from_lat_deg, span.to_lat_deg)]
    lons = [lon for span in spans for lon in (span.from_lon_deg, span.to_lon_deg)]
    length_km = sum(span.length_m for span in spans) / 1000
    return (
        f"{length_km:.2f} km, latitude {min(lats):.5f} to {max(lats):.5f},"
        f" longitude {min(lons):.5f} to {max(lons):.5f}"
    )
