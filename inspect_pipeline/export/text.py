"""Exports as text: CSV for spreadsheets, GeoJSON and KML for maps."""

from __future__ import annotations

import csv
import html
import json
import math
from datetime import date, datetime
from typing import TYPE_CHECKING, Any, TextIO
from xml.sax.saxutils import escape, quoteattr

from inspect_pipeline.errors import printable

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from inspect_pipeline.export.rows import Rows

    Row = Mapping[str, Any]

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
# Colours of KML are alpha, blue, green, red.
_STYLES = {"good": "ff4f9e2e", "part": "ffd67e1c", "bad": "ff3131e0", "open": "ff008cf0", "grey": "ff968e86"}


def plain(value: Any) -> Any:
    """Return a value as JSON has it: times as ISO 8601 in UTC, NaN as null."""
    if isinstance(value, datetime):
        return f"{value.replace(tzinfo=None).isoformat()}Z"
    if isinstance(value, date):
        return value.isoformat()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _to_json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, default=plain)


def write_csv(rows: Rows, file: TextIO) -> None:
    """Write CSV with a header.

    Text that a spreadsheet would take for a formula begins with an apostrophe, since ids and file names may
    come from anywhere.
    """
    write_cells(rows.schema.names, (row.values() for row in rows.dicts()), file)


def write_cells(names: Iterable[str], rows: Iterable[Iterable[Any]], file: TextIO) -> None:
    """Write CSV of any rows, as `write_csv` does."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([_to_cell(value) for value in row])


def _to_cell(value: Any) -> Any:
    value = plain(value)
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, dict)):
        return _to_json(value)
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def write_geojson(rows: Rows, file: TextIO) -> None:
    """Write a FeatureCollection, one feature a line; rows without a place have a null geometry."""
    head = {"type": "FeatureCollection", "name": rows.what, **({"redaction": rows.note} if rows.note else {})}
    file.write(_to_json(head)[:-1] + ', "features": [')
    for i, row in enumerate(rows.dicts()):
        places = rows.coordinates(row)
        geometry = places and {
            "type": rows.geometry,
            "coordinates": places[0] if len(places) == 1 else places,
        }
        feature = {
            "type": "Feature",
            "geometry": geometry,
            "properties": {name: plain(value) for name, value in row.items()},
        }
        file.write(("," if i else "") + "\n" + _to_json(feature))
    file.write("\n]}\n")


def write_kml(rows: Rows, file: TextIO) -> None:
    """Write KML. Heights count from the ground, where they are known; without, places lie on it."""
    file.write(
        '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2">\n<Document>\n'
    )
    file.write(f"<name>{rows.what}</name>\n")
    if rows.note:
        file.write(f"<description>{rows.note}</description>\n")
    for name, value in _STYLES.items():
        colour = f"<color>{value}</color>"
        icon, line = f"<IconStyle>{colour}</IconStyle>", f"<LineStyle>{colour}<width>3</width></LineStyle>"
        file.write(f'<Style id="{name}">{icon}{line}</Style>\n')
    for row in rows.dicts():
        file.writelines(_placemark(rows, row))
    file.write("</Document>\n</kml>\n")


def _placemark(rows: Rows, row: Row) -> Iterator[str]:
    yield f"<Placemark>\n<name>{_inert(_title(rows.what, row))}</name>\n"
    if begin := row.get("log_time_utc"):
        yield f"<TimeStamp><when>{plain(begin)}</when></TimeStamp>\n"
    elif begin := row.get("start_utc"):
        yield f"<TimeSpan><begin>{plain(begin)}</begin><end>{plain(row['end_utc'])}</end></TimeSpan>\n"
    yield f"<styleUrl>#{_style(row)}</styleUrl>\n<ExtendedData>\n"
    for name, value in row.items():
        if value is not None:
            yield f"<Data name={quoteattr(name)}><value>{_inert(_to_text(value))}</value></Data>\n"
    yield "</ExtendedData>\n"
    yield _kml_geometry(rows, row)
    yield "</Placemark>\n"


def _to_text(value: Any) -> str:
    value = plain(value)
    return value if isinstance(value, str) else _to_json(value)


def _inert(text: str) -> str:
    """Escape text for XML; and first for HTML, since Google Earth shows values as such."""
    text = printable(text)
    return escape(html.escape(text, quote=False) if "<" in text else text)


def _title(what: str, row: Row) -> str:
    if what == "frames":
        return f"frame {row['frame_idx']}"
    if what == "signals":
        return f"{row['name']} {row['value']}"
    if what == "conductors":
        return f"{row['span_id']} {row['conductor']}"
    return str(row["span_id"] if what == "spans" else row["kind"])


def _style(row: Row) -> str:
    """Return the style of an anomaly by its review, of a span by its coverage, of a frame by its lines."""
    if "verdict" in row:
        return {"confirmed": "bad", "dismissed": "grey"}.get(row["verdict"], "open")
    if "share" in row:
        share = row["share"]
        return "grey" if share is None else "good" if share >= 0.95 else "part" if share else "bad"
    if "n_lines" in row:
        return "grey" if row["status"] != "ok" else "good" if row["n_lines"] else "open"
    return "open"


def _kml_geometry(rows: Rows, row: Row) -> str:
    places = rows.coordinates(row)
    if places is None:
        return ""
    names = ("height_m",) if len(places) == 1 else ("from_height_m", "to_height_m")
    heights = [row.get(name) for name in names]
    is_known = None not in heights
    mode = "relativeToGround" if is_known else "clampToGround"
    texts = [
        f"{longitude!r},{latitude!r},{height!r}" if is_known else f"{longitude!r},{latitude!r}"
        for (longitude, latitude), height in zip(places, heights, strict=True)
    ]
    name = rows.geometry
    tessellate = "<tessellate>1</tessellate>" if name == "LineString" and not is_known else ""
    return (
        f"<{name}>{tessellate}<altitudeMode>{mode}</altitudeMode>"
        f"<coordinates>{' '.join(texts)}</coordinates></{name}>\n"
    )
