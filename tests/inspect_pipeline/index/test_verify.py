"""Verification finds whatever differs between the index and the flights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import duckdb
import pytest

from inspect_pipeline.index import publish as index
from inspect_pipeline.index.verify import verify

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("DELETE FROM flights WHERE source_uri LIKE '%/a.mcap'", "not in the index"),
        ("UPDATE flights SET flight_id = 'f' || flight_id", "in the index"),
        ("UPDATE flights SET result_sha256 = 'x' WHERE source_uri LIKE '%/a.mcap'", "older in the index"),
        ("DELETE FROM frames WHERE frame_idx = 2", "frames in the index differ"),
        ("INSERT INTO segments BY NAME SELECT * FROM segments LIMIT 1", "segments in the index differ"),
        ("UPDATE lines SET score = 0.7 WHERE frame_idx = 3", "lines in the index differ"),
    ],
)
def test_verify_finds_any_difference(store: Store, change: str, words: str) -> None:
    with duckdb.connect(store.index_path) as connection:
        connection.execute(change)
    problems = verify(store)
    assert problems
    assert all(words in problem for problem in problems)


def test_verify_compares_what_is_derived(store: Store) -> None:
    with duckdb.connect(store.index_path) as connection:
        connection.execute("UPDATE coverage SET covered = covered + 1")
    (problem,) = verify(store)
    assert "the rows of coverage are not those that were published" in problem
    index.rebuild(store)
    assert verify(store) == ()
