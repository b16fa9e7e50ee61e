"""The rows of an export, read from the index in batches; coordinates are removed or moved where asked.

The columns of a place are lat_deg and lon_deg, or the same behind from_ and to_ for the two ends of a line.
"""

from __future__ import annotations

import secrets
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import pyarrow as pa
import pyarrow.compute as pc

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence


RedactMode = Literal["drop", "fuzz"]
GeometryKind = Literal["Point", "LineString"]

GEOMETRIES: dict[str, GeometryKind] = {
    "frames": "Point",
    "anomalies": "Point",
    "signals": "Point",
    "spans": "LineString",
    "conductors": "LineString",
    "gaps": "LineString",
}
_NORTH_DEG, _EAST_DEG = (0.1, 0.3), (0.2, 20.0)  # how far coordinates are moved, at least and at most
_ENDS: dict[GeometryKind, tuple[str, ...]] = {"Point": ("",), "LineString": ("from_", "to_")}


@dataclass(frozen=True, slots=True)
class Redaction:
    """Removes coordinates and altitudes from rows, or moves all of an export by one offset.

    north_deg, east_deg: the offset; None removes.
    """

    north_deg: float | None = None
    east_deg: float | None = None

    @classmethod
    def of(cls, mode: RedactMode) -> Redaction:
        """Return one that drops coordinates, or that moves them by a random offset."""
        if mode == "drop":
            return cls()
        draw, sign = secrets.SystemRandom().uniform, secrets.SystemRandom().choice
        return cls(sign((-1, 1)) * draw(*_NORTH_DEG), sign((-1, 1)) * draw(*_EAST_DEG))

    @property
    def note(self) -> str:
        """What was done, for readers of the export."""
        if self.north_deg is None:
            return "coordinates and altitudes were removed"
        return "coordinates were moved by one random offset, altitudes were removed"

    def apply(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        """Return a batch without its coordinates, or with moved ones."""
        for i, name in enumerate(batch.schema.names):
            if name.endswith(("lat_deg", "lon_deg")) or name == "alt_m":
                batch = batch.set_column(i, batch.schema.field(i), self._move(name, batch.column(i)))
        return batch

    def _move(self, name: str, column: pa.Array) -> pa.Array:
        if self.north_deg is None or self.east_deg is None or name == "alt_m":
            return pa.nulls(len(column), column.type)
        if name.endswith("lat_deg"):
            return pc.add(column, self.north_deg)
        moved = pc.add(column, self.east_deg)
        turns = pc.floor(pc.divide(pc.add(moved, 180.0), 360.0))
        return pc.subtract(moved, pc.multiply(turns, 360.0))


@dataclass(slots=True, eq=False)
class Rows:
    """The rows of an export. n_rows and n_placed count what has been read so far; note goes into the file."""

    what: str
    reader: pa.RecordBatchReader
    redaction: Redaction | None = None
    n_rows: int = 0
    n_placed: int = 0

    @property
    def schema(self) -> pa.Schema:
        """The columns and their types."""
        return self.reader.schema

    @property
    def geometry(self) -> GeometryKind | None:
        """The kind of place that a row has."""
        return GEOMETRIES.get(self.what)

    @property
    def note(self) -> str | None:
        """What was done to the coordinates."""
        return self.redaction.note if self.redaction else None

    def batches(self) -> Iterator[pa.RecordBatch]:
        """Iterate over the rows, once."""
        for batch in self.reader:
            self.n_rows += batch.num_rows
            yield self.redaction.apply(batch) if self.redaction else batch

    def dicts(self) -> Iterator[dict[str, Any]]:
        """Iterate over the rows as dicts, once."""
        for batch in self.batches():
            yield from batch.to_pylist()

    def coordinates(self, row: Mapping[str, Any]) -> list[tuple[float, float]] | None:
        """Return the longitudes and latitudes of a row's place, None without one."""
        if self.geometry is None:
            return None
        found = [(row[f"{end}lon_deg"], row[f"{end}lat_deg"]) for end in _ENDS[self.geometry]]
        if any(None in place for place in found):
            return None
        self.n_placed += 1
        return found


def to_wkb(places: Sequence[tuple[float, float]] | None) -> bytes | None:
    """Return a point, or a line of several, as well-known binary."""
    if places is None:
        return None
    if len(places) == 1:
        return struct.pack("<BIdd", 1, 1, *places[0])
    return struct.pack("<BII", 1, 2, len(places)) + b"".join(struct.pack("<dd", *place) for place in places)
