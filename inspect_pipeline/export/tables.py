"""Export the rows of flights as a file: `export_rows`. What goes into which format is in FORMATS."""

from __future__ import annotations

from typing import TYPE_CHECKING, TextIO

from inspect_pipeline.atomic import appearing, fsync_path
from inspect_pipeline.errors import OutputError
from inspect_pipeline.export.columnar import write_geopackage, write_geoparquet, write_parquet
from inspect_pipeline.export.rows import GEOMETRIES, Redaction, Rows
from inspect_pipeline.export.text import write_csv, write_geojson, write_kml
from inspect_pipeline.index.reading import open_index

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from inspect_pipeline.store.store import Store

_TEXT: dict[str, Callable[[Rows, TextIO], None]] = {
    "geojson": write_geojson,
    "kml": write_kml,
    "csv": write_csv,
}
_COLUMNAR: dict[str, Callable[[Rows, Path], None]] = {
    "gpkg": write_geopackage,
    "parquet": write_parquet,
    "geoparquet": write_geoparquet,
}
MAP_FORMATS = ("geojson", "gpkg", "kml", "geoparquet")
TABLE_FORMATS = {
    what: (*(MAP_FORMATS if what in GEOMETRIES else ()), "csv", "parquet")
    for what in ("frames", "lines", "spans", "conductors", "gaps", "anomalies", "signals")
}


def export_rows(
    store: Store,
    flight_ids: Sequence[str],
    what: str,
    output: Path,
    *,
    form: str,
    redaction: Redaction | None = None,
) -> Rows:
    """Write the rows of flights to a file, whole or not at all, and return how many there were.

    Args:
        store: the store.
        flight_ids: the flights.
        what: the rows, a key of TABLE_FORMATS.
        output: the file; a pipe or device is written to.
        form: one of the formats there.
        redaction: what is done to coordinates.

    Raises:
        MissingExtraError, OutputError, StoreError
    """
    with open_index(store) as index:
        rows = Rows(what, index.read_export(what, flight_ids), redaction)
        try:
            with appearing(output) as path:
                if form in _TEXT:
                    with path.open("w", encoding="utf-8", newline="") as file:
                        _TEXT[form](rows, file)
                else:
                    _COLUMNAR[form](rows, path)
                fsync_path(path)
        except OSError as error:
            raise OutputError(output, f"cannot be written ({error.strerror})", "name another file") from error
        return rows
