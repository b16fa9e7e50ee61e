"""Verification: the index and the files of the flights hold what was written."""

from __future__ import annotations

from typing import TYPE_CHECKING

import duckdb

from inspect_pipeline.atomic import store_errors
from inspect_pipeline.index.publish import is_current, read_published
from inspect_pipeline.index.rows import compare_checksums, compare_rows, find_damaged
from inspect_pipeline.index.schema import CONFIG, DATABASE_ERRORS, REBUILD, first_line
from inspect_pipeline.store.store import as_store

if TYPE_CHECKING:
    from pathlib import Path

    from inspect_pipeline.store.flight_folder import DamagedFlight, StoredFlight
    from inspect_pipeline.store.store import Store


def verify(store: Store | Path | str) -> tuple[str, ...]:
    """Compare every value of the index with the flights, and every file of the flights with its checksum.

    Returns:
        A sentence for each difference.

    Raises:
        StoreError: Also while another program has the index open for writing.
        StoreVersionError: The index was written by a newer version.
    """
    store = as_store(store)
    with store.publish_lock():
        flights, damaged = store.scan()
        damaged += _check_files(store, flights)
        problems = [f"{folder}: {problem}" for folder, problem in damaged]
        known = read_published(store.index_path, is_lock_error=True)
        if known is None:
            return (*problems, f"{store.index_path}: missing or corrupt; {REBUILD}")
        wanted = {flight.record.flight_id: flight for flight in flights}
        problems += [f"{flight_id}: in the index only; {REBUILD}" for flight_id in known.keys() - wanted]
        folders = {one.folder for one in damaged}
        absent = [i for i, flight in wanted.items() if i not in known and flight.folder not in folders]
        problems += [f"{flight_id}: not in the index; {REBUILD}" for flight_id in absent]
        same = {i: f for i, f in wanted.items() if known.get(i) == f.result_sha256}
        problems += [f"{i}: older in the index; {REBUILD}" for i in (wanted.keys() & known) - same.keys()]
        intact = [flight for flight in same.values() if flight.folder not in folders]
        try:
            with duckdb.connect(store.index_path, read_only=True, config=CONFIG) as connection:
                problems += compare_rows(connection, intact)
                if not problems:
                    problems += _check_rest(connection, store, flights)
        except DATABASE_ERRORS as error:
            problems.append(f"{store.index_path}: {first_line(error)}; {REBUILD}")
        return tuple(problems)


def _check_files(store: Store, flights: list[StoredFlight]) -> list[DamagedFlight]:
    """Return the flights with a file whose checksum differs, annotated copies included."""
    with store_errors(store.root):
        return find_damaged(flights, lambda flight: flight.record.files)


def _check_rest(
    connection: duckdb.DuckDBPyConnection, store: Store, flights: list[StoredFlight]
) -> list[str]:
    """Check version, runs and user input of the index, then the checksums of its other tables."""
    if not is_current(connection, store, flights):
        return [f"{store.index_path}: other runs, spans or rules, or another version; {REBUILD}"]
    return [
        f"{store.index_path}: the rows of {table} are not those that were published; {REBUILD}"
        for table in compare_checksums(connection)
    ]
