"""What tests compare of two stores, and what must hold of any store at any moment."""

from __future__ import annotations

import hashlib
import os
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import duckdb
from flights import versions, versions_in_index

if TYPE_CHECKING:
    from collections.abc import Sequence

    from inspect_pipeline.store.store import Store

TABLES = ("models", "runs", "flights", "channels", "frames", "segments", "lines")
_DERIVED = ("coverage", "coverage_bins", "coverage_gaps", "conductor_counts", "anomalies", "inputs")
_VIEWS = ("flight_summary", "bad_frames", "frame_dropouts", "detection_gaps", "span_last_seen")
# What differs between two runs over the same recordings, by nature, or is about runs.
_NOT_COMPARED = {
    "checksums": None,
    "flights": "EXCLUDE (run_id, ingested_at, result_sha256)",
    "frames": "EXCLUDE (infer_ms)",
    "runs": None,
    "schema_version": None,
}


def ask(store: Store, sql: str) -> list[tuple[Any, ...]]:
    """The answer of the index."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return connection.execute(sql).fetchall()


def answers(store: Store) -> dict[str, list[tuple[Any, ...]]]:
    """Everything that is said of flights in the tables and views, in an order that does not depend on it."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        return {
            name: sorted(connection.execute(f"FROM {name}").fetchall(), key=repr)
            for name in (*TABLES, *_DERIVED, *_VIEWS)
        }


def contents(store: Store) -> dict[str, list[tuple[Any, ...]]]:
    """The rows of all tables of the index, in an order that does not depend on it."""
    with duckdb.connect(store.index_path, read_only=True) as connection:
        tables = "SELECT table_name FROM duckdb_tables() WHERE NOT internal ORDER BY ALL"
        selections = {name: _NOT_COMPARED.get(name, "") for (name,) in connection.execute(tables).fetchall()}
        return {
            name: connection.execute(f"SELECT * {how} FROM {name} ORDER BY ALL").fetchall()
            for name, how in selections.items()
            if how is not None
        }


def file_names(store: Store) -> set[str]:
    """The files of a store but those named after runs."""
    found = {path.relative_to(store.root).as_posix() for path in store.root.rglob("*") if path.is_file()}
    return {name for name in found if not name.startswith("runs/")}


def disk_state(store: Store) -> str:
    """A hash of all that a crash at this moment would leave: the names and the bytes of a store."""
    digest = hashlib.blake2b()
    for path in sorted(store.root.rglob("*")):
        digest.update(os.fsencode(path))
        if path == store.index_path:  # large, and replaced rather than written
            found = path.stat()
            digest.update(f"{found.st_ino} {found.st_size} {found.st_mtime_ns}".encode())
        elif path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def where_states_change(states: Sequence[str]) -> list[int]:
    """The first and the last place of every run of equal states."""
    last = [i for i, (one, following) in enumerate(pairwise(states)) if one != following]
    return sorted({0, len(states) - 1, *last, *(i + 1 for i in last)})


def check_visible(store: Store) -> None:
    """Whatever can be seen is whole, and there once; no recording is blamed."""
    if (store.root / "flights").exists():
        versions(store)
    if store.index_path.exists():
        versions_in_index(store)
        with duckdb.connect(store.index_path, read_only=True) as connection:
            twice = "SELECT 1 FROM frames GROUP BY flight_id, channel_id, frame_idx HAVING count(*) > 1"
            assert connection.execute(twice).fetchall() == []
    assert not list((store.root / "quarantine").glob("*.json"))
