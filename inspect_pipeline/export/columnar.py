"""Exports in columns: Parquet, GeoParquet and GeoPackage."""

from __future__ import annotations

import json
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pyarrow as pa
import pyarrow.parquet as pq

from inspect_pipeline.errors import MissingExtraError
from inspect_pipeline.export.rows import to_wkb
from inspect_pipeline.export.text import plain

if TYPE_CHECKING:
    from collections.abc import Iterator

    from inspect_pipeline.export.rows import Rows

_GEOMETRY = "geometry"


def write_parquet(rows: Rows, path: Path) -> None:
    """Write Parquet with the columns as they are."""
    _write(rows.schema, rows.batches(), path, _metadata(rows))


def write_geoparquet(rows: Rows, path: Path) -> None:
    """Write GeoParquet 1.1: the columns, and the places as WKB in longitude and latitude (OGC:CRS84)."""
    column = {"encoding": "WKB", "geometry_types": [rows.geometry]}
    geo = {"version": "1.1.0", "primary_column": _GEOMETRY, "columns": {_GEOMETRY: column}}
    schema = rows.schema.append(pa.field(_GEOMETRY, pa.binary()))
    _write(schema, _with_geometry(rows), path, {"geo": json.dumps(geo), **_metadata(rows)})


def write_geopackage(rows: Rows, path: Path) -> None:
    """Write a GeoPackage with one layer. Raises MissingExtraError without pyogrio."""
    try:
        import pyogrio  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise MissingExtraError("a GeoPackage", "geo") from error
    fields = [*rows.schema, pa.field(_GEOMETRY, pa.binary())]
    schema = pa.schema([_field_of_layer(field) for field in fields])
    batches = (_to_layer(batch, schema) for batch in _with_geometry(rows))
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:  # GDAL wants the suffix
        file = Path(folder) / "export.gpkg"
        with warnings.catch_warnings(action="ignore"):
            pyogrio.write_arrow(
                pa.RecordBatchReader.from_batches(schema, batches),
                file,
                layer=rows.what,
                driver="GPKG",
                geometry_name=_GEOMETRY,
                geometry_type=rows.geometry,
                crs="EPSG:4326",
                layer_metadata=_metadata(rows) or None,
            )
        file.replace(path)


def _metadata(rows: Rows) -> dict[str, str]:
    return {"redaction": rows.note} if rows.note else {}


def _write(
    schema: pa.Schema, batches: Iterator[pa.RecordBatch], path: Path, metadata: dict[str, str]
) -> None:
    schema = schema.with_metadata(metadata)
    with path.open("wb") as file, pq.ParquetWriter(file, schema, compression="zstd") as writer:
        for batch in batches:
            writer.write_batch(batch.replace_schema_metadata(metadata))


def _with_geometry(rows: Rows) -> Iterator[pa.RecordBatch]:
    """Iterate over the rows with their places as the last column."""
    for batch in rows.batches():
        shapes = [to_wkb(rows.coordinates(row)) for row in batch.to_pylist()]
        columns = [*batch.columns, pa.array(shapes, pa.binary())]
        yield pa.RecordBatch.from_arrays(columns, [*batch.schema.names, _GEOMETRY])


def _field_of_layer(field: pa.Field) -> pa.Field:
    """Return the type that a layer has for a column: times in UTC, lists as JSON."""
    if pa.types.is_timestamp(field.type):
        return pa.field(field.name, pa.timestamp("ms", "UTC"))
    return pa.field(field.name, pa.string()) if pa.types.is_nested(field.type) else field


def _to_layer(batch: pa.RecordBatch, schema: pa.Schema) -> pa.RecordBatch:
    return pa.RecordBatch.from_arrays(
        [_to_layer_column(column, field) for column, field in zip(batch.columns, schema, strict=True)],
        schema=schema,
    )


def _to_layer_column(column: pa.Array, field: pa.Field) -> pa.Array:
    if pa.types.is_nested(column.type):
        texts: list[Any] = [
            None if one is None else json.dumps(one, default=plain) for one in column.to_pylist()
        ]
        return pa.array(texts, pa.string())
    return column.cast(field.type, safe=False)
