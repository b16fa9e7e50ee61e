"""Queries only read, within their limits, and say in one line what is wrong."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import duckdb
import pytest
from inline_queries import answer_here

from inspect_pipeline.errors import QueryError
from inspect_pipeline.index import query_child
from inspect_pipeline.index.query import QueryLimits, run_query
from inspect_pipeline.index.query import query as query_rows

if TYPE_CHECKING:
    from inspect_pipeline.store.store import Store

WRITING = [
    "COPY frames TO '/tmp/lsnet-pipe-test.csv'",
    "EXPLAIN COPY frames TO '/tmp/lsnet-pipe-test.csv'",
    "EXPLAIN ANALYZE COPY frames TO '/tmp/lsnet-pipe-test.csv'",
    "/**/ EXPLAIN ANALYZE COPY frames TO '/tmp/lsnet-pipe-test.csv'",
    "EXPLAIN/**/ANALYZE COPY frames TO '/tmp/lsnet-pipe-test.csv'",
    "EXPORT DATABASE '/tmp/lsnet-pipe-test'",
    "ATTACH '/tmp/lsnet-pipe-test.duckdb'",
    "WITH t AS (DELETE FROM frames RETURNING *) SELECT * FROM t",
    "FROM query('DROP TABLE frames')",
    "DROP TABLE frames",
    "PRAGMA table_info('frames')",
    "SET memory_limit = '10GB'",
]


REFUSED = [
    "",
    "-- nothing",
    "DROP TABLE frames",
    "CREATE TABLE t AS SELECT 1",
    "CREATE TEMP TABLE t AS SELECT 1",
    "INSERT INTO models SELECT * FROM models",
    "UPDATE frames SET status = 'ok'",
    "DELETE FROM frames",
    "SELECT 1; DROP TABLE frames",
    "SELECT 1; SELECT 2",
    "SET memory_limit = '10GB'",
    "RESET memory_limit",
    "INSTALL httpfs",
    "LOAD httpfs",
    "CALL duckdb_settings()",
    "CHECKPOINT",
    "VACUUM",
    "BEGIN",
    "PREPARE p AS SELECT 1",
    "CREATE SECRET (TYPE s3)",
]


@pytest.mark.parametrize("sql", REFUSED)
def test_statements_are_judged_before_they_run(sql: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(kind: str, message: str) -> None:
        raise AssertionError(f"{kind}: {message}")

    monkeypatch.setattr(query_child, "fail", fail)
    with pytest.raises(AssertionError, match=r"query: one SELECT, WITH, .* is allowed, not "):
        query_child.check_statement(sql)


OUT_OF_REACH = [
    "SELECT * FROM read_text('/etc/hostname')",
    "SELECT * FROM read_csv('/etc/hostname')",
    "SELECT * FROM '/etc/hostname.csv'",
    "SELECT * FROM glob('/etc/*')",
    "SELECT * FROM read_json('https://example.com/x.json')",
    "SELECT * FROM duckdb_secrets()",
    "SELECT getenv('HOME')",
    "SELECT * FROM job",
]


REFUSALS = [(sql, True) for sql in WRITING] + [(sql, False) for sql in (WRITING[0], *OUT_OF_REACH)]


def test_refused_statements(queried: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By what the statements are and by how the index is opened, without the limits of the child."""
    answer_here(monkeypatch)
    before = queried.index_path.read_bytes()
    for sql, allow_files in REFUSALS:
        with pytest.raises((QueryError, duckdb.Error)):
            run_query(queried.index_path, sql, output=tmp_path / "rows", allow_files=allow_files)
    assert not list(tmp_path.iterdir())
    assert not list(Path("/tmp").glob("lsnet-pipe-test*"))  # noqa: S108
    assert queried.index_path.read_bytes() == before


@pytest.mark.parametrize(("sql", "allow_files"), [REFUSALS[0], REFUSALS[3], REFUSALS[-5]])
def test_refusals_of_the_child_are_one_line(ask_child: Any, sql: str, allow_files: bool) -> None:
    with pytest.raises(QueryError) as caught:
        ask_child(sql, allow_files=allow_files)
    assert not any(text in str(caught.value) for text in ("\n", "stopped", "memory"))


@pytest.mark.parametrize(
    "sql",
    [
        "SELECT length(repeat('x', 2000000000))",
        "SELECT list(range) FROM range(1000000000)",
        "SELECT count(*) FROM range(100000000) a, range(100000000) b WHERE sqrt(a.range * b.range) = 3",
        "WITH RECURSIVE t(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM t) SELECT count(*) FROM t",
    ],
)
def test_bombs_are_stopped(ask_child: Any, sql: str) -> None:
    start = time.monotonic()
    with pytest.raises(QueryError, match=r"stopped after 0\.3 s|more than 128 MiB of memory"):
        ask_child(sql, limits=QueryLimits(timeout_s=0.3, memory_bytes=128 << 20))
    assert time.monotonic() - start < 3


def test_a_large_output_is_stopped_in_time(queried: Store, tmp_path: Path) -> None:
    with pytest.raises(QueryError, match="stopped"):
        run_query(
            queried.index_path,
            "SELECT * FROM range(10000000000)",
            format="csv",
            output=tmp_path / "rows.csv",
            limits=QueryLimits(timeout_s=0.3),
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        ("SELECT n_segment FROM frames", 'column "n_segment" not found.*"n_segments"'),
        ("FROM frame", 'frame does not exist.*Did you mean "frames".*SHOW TABLES'),
        ("SELEC 1", "syntax error"),
        ("SELECT 'x'::INTEGER", "Could not convert string 'x' to INT32"),
    ],
)
def test_errors_are_one_line_with_a_hint(ask_child: Any, sql: str, words: str) -> None:
    with pytest.raises(QueryError, match=words) as caught:
        ask_child(sql)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        ("DROP TABLE flights", "one SELECT"),
        ("SELECT 1; SELECT 2", "one SELECT"),
        ("FROM read_text('/etc/passwd')", "disabled"),
        ("SELEC 1", "syntax error"),
        ("SELECT count(*) FROM range(100000000000) a", r"stopped after 0\.3 s"),
        ("SELECT repeat('x', 2000000000)", "memory"),
    ],
)
def test_rows_for_python_are_as_safe_as_the_command(queried: Store, sql: str, words: str) -> None:
    with pytest.raises(QueryError, match=words):
        query_rows(queried, sql, limits=QueryLimits(timeout_s=0.3 if "100000000000" in sql else 20))
