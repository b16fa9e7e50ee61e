"""The spans of a simulated line as a file that `spans import` reads."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import OutputError

if TYPE_CHECKING:
    from pathlib import Path

_LINE_ID = "simulated"


def write_spans(target: Path, truth_path: Path) -> None:
    """Write the spans that the truth of a flight has as GeoJSON. Raises OutputError."""
    truth = json.loads(truth_path.read_text(encoding="utf-8"))
    places = {one["structure_id"]: [one["lon_deg"], one["lat_deg"]] for one in truth["structures"]}
    content = {
        "type": "FeatureCollection",
        "features": [_to_feature(span, places) for span in truth["spans"]],
    }
    try:
        with appearing(target) as part:
            part.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(target, f"cannot be written ({error.strerror})", "name another file") from error


def _to_feature(span: dict[str, Any], places: dict[str, list[float]]) -> dict[str, Any]:
    first, second = span["structure_ids"]
    properties = {
        "span_id": span["span_id"],
        "line_id": _LINE_ID,
        "from_structure": first,
        "to_structure": second,
        "expected_conductors": span["expected_conductors"],
    }
    geometry = {"type": "LineString", "coordinates": [places[first], places[second]]}
    return {"type": "Feature", "properties": properties, "geometry": geometry}
