"""Publish a store: its index, then the files in the folders of flights that are made from the index.

Derived files show the rows, rules and reviews of today. They are made again for flights of which any of these
has changed; derived.json has a digest of what each flight's files were made of.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING

from inspect_pipeline.atomic import store_errors, write_whole
from inspect_pipeline.index import publish as index_publish
from inspect_pipeline.index.inspected import input_digests
from inspect_pipeline.index.reading import open_index
from inspect_pipeline.store.feedback import load_reviews
from inspect_pipeline.store.records import parse_json
from inspect_pipeline.store.store import as_store

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from inspect_pipeline.index.publish import IndexChange
    from inspect_pipeline.index.reading import IndexReader
    from inspect_pipeline.store.store import Store

    # Makes files of the flight of this id in its folder. Raises OSError.
    Maker = Callable[[IndexReader, Store, str], None]

_DIGESTS = "derived.json"


def publish(store: Store | Path | str) -> IndexChange:
    """Bring the index and the derived files of flights up to date; what is up to date stays.

    Raises StoreError, StoreVersionError.
    """
    store = as_store(store)
    change = index_publish.publish(store)
    _make_derived_files(store)
    return change


def rebuild(store: Store | Path | str) -> IndexChange:
    """Rebuild the index and the derived files of all flights; raises StoreError."""
    store = as_store(store)
    change = index_publish.rebuild(store)
    with store_errors(store.root):
        (store.root / _DIGESTS).unlink(missing_ok=True)
    _make_derived_files(store)
    return change


def _make_derived_files(store: Store) -> None:
    with store.publish_lock(), open_index(store) as index:
        known, wanted = _load_digests(store), _digests(index, store)
        stale = [flight_id for flight_id, digest in wanted.items() if known.get(flight_id) != digest]
        if not stale and known.keys() == wanted.keys():
            return
        with store_errors(store.root):
            for flight_id in stale:
                _make_files_of(index, store, flight_id)
            write_whole(store.root / _DIGESTS, json.dumps(wanted, indent=1) + "\n")


def _make_files_of(index: IndexReader, store: Store, flight_id: str) -> None:
    folder = store.flight_dir(flight_id)
    if not folder.exists():  # removed since it was published
        return
    for leftover in folder.glob(".*"):  # of a publish that was killed
        leftover.unlink()
    for make in _makers():
        make(index, store, flight_id)


def _makers() -> tuple[Maker, ...]:
    """Import what makes derived files, which takes long and is seldom needed."""
    from inspect_pipeline.export.viewer_files import write_viewer_files  # noqa: PLC0415
    from inspect_pipeline.report.thumbnails import make_pictures  # noqa: PLC0415

    return write_viewer_files, make_pictures


def _load_digests(store: Store) -> dict[str, str]:
    try:
        found = parse_json((store.root / _DIGESTS).read_bytes())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _digests(index: IndexReader, store: Store) -> dict[str, str]:
    """Return a digest of what the derived files of each flight in the index are made of."""
    inputs = input_digests(store)
    common = [inputs[name] for name in ("program", "rules", "spans.geojson")]
    reviews: dict[str, list[str]] = {}
    for one in load_reviews(store):
        reviews.setdefault(one.flight_id, []).append(repr(one))
    digests = {}
    for flight in index.select("SELECT flight_id, result_sha256 FROM flights ORDER BY flight_id"):
        flight_id = flight["flight_id"]
        parts = [*common, flight["result_sha256"], *sorted(reviews.get(flight_id, []))]
        digests[flight_id] = hashlib.sha256("\n".join(parts).encode()).hexdigest()
    return digests
