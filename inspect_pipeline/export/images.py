"""Frames as a folder of photographs, with a table of them, for image-based systems and for training.

images.csv            a row for each image: time, place, attitude, and of evidence the anomalies it shows
annotations.json      with COCO labels; NAME.json beside each image with those of labelme
oriented_imagery.csv  the table of ArcGIS
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from inspect_pipeline.atomic import appearing
from inspect_pipeline.errors import InspectError, OutputError
from inspect_pipeline.export.labels import COCO_FILE, image_name, to_coco, to_labelme, write_labels
from inspect_pipeline.export.oriented_imagery import (
    ORIENTED_IMAGERY_FIELDS,
    ORIENTED_IMAGERY_FILE,
    to_oriented_image,
)
from inspect_pipeline.export.rows import Redaction, Rows
from inspect_pipeline.export.text import write_cells
from inspect_pipeline.images.photograph import write_photograph
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.store.images import iter_images, open_images

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from inspect_pipeline.arrays import ImageArray
    from inspect_pipeline.store.store import Store

    Row = Mapping[str, Any]
    Key = tuple[str, int, int]

IMAGE_FORMATS = ("jpeg", "coco", "labelme", "esri-oriented")
IMAGES_FILE = "images.csv"


class ExportedImages(NamedTuple):
    """What was exported: the number of images, of those that were wanted, and a sentence for each failure."""

    n_images: int
    n_wanted: int
    failures: tuple[str, ...]


def export_images(
    store: Store,
    flight_ids: Sequence[str],
    what: str,
    folder: Path,
    *,
    form: str,
    redaction: Redaction | None = None,
    on_progress: Callable[[int, int], object] = lambda _done, _total: None,
) -> ExportedImages:
    """Write frames into a folder: all, or those that show anomalies which nobody has dismissed.

    A flight whose images are gone or damaged is a failure; the others are written.

    Args:
        store: the store.
        flight_ids: the flights.
        what: "frames" or "evidence".
        folder: where the images and tables go; made if missing, files of the same names are replaced.
        form: one of IMAGE_FORMATS; all have the images and their table.
        redaction: what is done to coordinates.
        on_progress: called with the number of images done, and that of all.

    Raises:
        OutputError, StoreError
    """
    names, rows, lines = _read_rows(
        store, flight_ids, what, redaction, with_lines=form in {"coco", "labelme"}
    )
    written: dict[str, Row] = {}
    failures: list[str] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for row, image in _read_images(store, rows, failures):
            name = image_name(*_key(row))
            write_photograph(folder / name, image, row)
            written[name] = row
            on_progress(len(written), len(rows))
        table = [{"file": name, **row} for name, row in written.items()]
        _write_table(folder / IMAGES_FILE, ["file", *names], table)
        _write_labels(folder, written, lines, form)
    except OSError as error:
        raise OutputError(folder, f"cannot be written ({error.strerror})", "name another folder") from error
    return ExportedImages(len(written), len(rows), tuple(failures))


def _read_rows(
    store: Store, flight_ids: Sequence[str], what: str, redaction: Redaction | None, *, with_lines: bool
) -> tuple[list[str], list[Row], Mapping[Key, list[Row]]]:
    """Return the columns of the frames, the frames with a size, and their lines, if these are asked for."""
    with open_index(store) as index:
        table = Rows(what, index.read_export(what, flight_ids), redaction)
        rows: list[Row] = [row for row in table.dicts() if row["width"] is not None]
        if not with_lines:
            return table.schema.names, rows, {}
        lines = Rows("lines", index.read_export("lines", flight_ids))
        return table.schema.names, rows, _lines_of(lines, {_key(row) for row in rows})


def _key(row: Row) -> Key:
    return row["flight_id"], row["channel_id"], row["frame_idx"]


def _lines_of(rows: Rows, wanted: set[Key]) -> dict[Key, list[Row]]:
    """Return the lines of some frames."""
    found: dict[Key, list[Row]] = {}
    for row in rows.dicts():
        if _key(row) in wanted:
            found.setdefault(_key(row), []).append(row)
    return found


def _read_images(store: Store, rows: Sequence[Row], failures: list[str]) -> Iterator[tuple[Row, ImageArray]]:
    """Yield the rows with their images; flights that cannot be read are added to `failures`."""
    for flight_id in dict.fromkeys(row["flight_id"] for row in rows):
        own = {(row["topic"], row["frame_idx"]): row for row in rows if row["flight_id"] == flight_id}
        stored = store.find_flight(flight_id)
        if stored is None:
            failures.append(f"flight {flight_id[:16]} is in the index but not in the store; rebuild it")
            continue
        wanted = {key: row["log_time_ns"] for key, row in own.items()}
        try:
            for topic, frame_idx, image in iter_images(open_images(stored.record, stored.folder), wanted):
                yield own.pop((topic, frame_idx)), image
        except InspectError as error:
            failures.append(str(error))
        else:
            if own:
                failures.append(f"flight {flight_id[:16]}: {len(own)} of its frames have no image any more")


def _write_labels(
    folder: Path, written: Mapping[str, Row], lines: Mapping[Key, list[Row]], form: str
) -> None:
    """Write what the format adds to the images."""
    if form == "esri-oriented":
        placed = [to_oriented_image(folder / name, row) for name, row in written.items()]
        _write_table(folder / ORIENTED_IMAGERY_FILE, ORIENTED_IMAGERY_FIELDS, [row for row in placed if row])
    if form == "coco":
        labelled = ((name, row, lines.get(_key(row), [])) for name, row in written.items())
        write_labels(folder / COCO_FILE, to_coco(labelled))
    if form == "labelme":
        for name, row in written.items():
            labels = to_labelme(name, row, lines.get(_key(row), []))
            write_labels((folder / name).with_suffix(".json"), labels)


def _write_table(path: Path, names: Sequence[str], rows: Iterable[Row]) -> None:
    """Write rows as CSV; lists in them as texts with semicolons between."""
    with appearing(path) as part, part.open("w", encoding="utf-8", newline="") as file:
        write_cells(names, ([_to_text(row[name]) for name in names] for row in rows), file)


def _to_text(value: Any) -> Any:
    return "; ".join(map(str, value)) if isinstance(value, list) else value
