"""Queries: one reading statement, in every format, and nothing else, however it is put."""

from __future__ import annotations

import csv
import datetime
import io
import json
import math
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import duckdb
import flights
import pytest
import typer
from inline_queries import answer_here
from typer.testing import CliRunner

from inspect_pipeline.commands import index as index_command
from inspect_pipeline.commands.query import query
from inspect_pipeline.errors import QueryError, StoreError, StoreVersionError
from inspect_pipeline.index import query_output
from inspect_pipeline.index.query import QueryLimits, run_query
from inspect_pipeline.index.query import query as query_rows
from inspect_pipeline.index.reading import select
from inspect_pipeline.index.verify import verify
from inspect_pipeline.resources import MIGRATIONS
from inspect_pipeline.store.store import Store

if TYPE_CHECKING:
    from pathlib import Path


def test_json_is_an_array_of_objects(ask: Any) -> None:
    names = ["frame_idx", "status", "reason", "infer_ms", "log_time_utc"]
    assert json.loads(ask(f"SELECT {', '.join(names)} FROM frames WHERE frame_idx < 2 ORDER BY 1")) == [
        dict(zip(names, row, strict=True))
        for row in (
            (0, "ok", None, 2.0, "2023-11-14T22:13:20.123456Z"),
            (1, "bad", "corrupt JPEG", None, "2023-11-14T22:13:20.223456Z"),
        )
    ]
    assert json.loads(ask("SELECT 1 AS x WHERE false")) == []


VALUES = {
    "'NaN'::DOUBLE": None,
    "'-inf'::FLOAT": None,
    "[1.5, 'nan'::FLOAT, NULL]": [1.5, None, None],
    "{'a': {'b': 'inf'::DOUBLE, 'c': 'NaN'}}": {"a": {"b": None, "c": "NaN"}},
    "'NaN'": "NaN",
    "12345678901234567890123::HUGEINT": 12345678901234567890123,
    "1.10::DECIMAL(20, 2)": 1.1,
    "DATE '2026-01-02'": "2026-01-02",
    "TIMESTAMP_NS '2026-01-02 03:04:05.123456789'": "2026-01-02T03:04:05.123456789Z",
    "TIMESTAMPTZ '2026-01-02 03:04:05+02'": "2026-01-02T01:04:05Z",
    "INTERVAL 90 SECOND": "00:01:30",
    "MAP {'k': 1}": {"k": 1},
    "'ü \"\n\x1b[31m'": 'ü "\n\x1b[31m',
    "NULL": None,
    "true": True,
}


def test_values_in_json(ask: Any) -> None:
    text = ask("SELECT " + ", ".join(f"{sql} AS c{i}" for i, sql in enumerate(VALUES)))
    (row,) = json.loads(text, parse_constant=pytest.fail)
    assert list(row.values()) == list(VALUES.values())


def test_csv(ask: Any) -> None:
    text = ask("SELECT 'a,\"b\"\nc' AS x, NULL AS y, 1.5 AS z, points FROM lines LIMIT 1", "csv")
    rows = list(csv.reader(io.StringIO(text)))
    assert rows[0] == ["x", "y", "z", "points"]
    assert rows[1][:3] == ['a,"b"\nc', "", "1.5"]
    assert ask("SELECT 1 AS x, 2 AS y WHERE false", "csv") == "x,y\n"
    assert ask("EXPLAIN SELECT 1", "csv").startswith("explain_key,explain_value\nphysical_plan,")


def test_table(ask: Any) -> None:
    text = ask("SELECT 'a\x1b[31m\nb' AS name, NULL AS x, 12 AS number UNION ALL SELECT 'c', 3, 4", "table")
    assert text.splitlines() == [
        "name          x  number",
        "---------  ----  ------",
        "a\\x1b[31m  NULL      12",
        "b",
        "c             3       4",
        "(2 rows)",
    ]


def test_a_long_table_is_cut_on_the_screen_only(
    queried: Store, ask: Any, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    sql = "SELECT range, repeat('x', 200) AS long FROM range(5000)"
    run_query(queried.index_path, sql, limits=QueryLimits(max_rows=10))
    text = capsysbinary.readouterr().out.decode()
    assert text.count("\n") == 13
    assert "…" in text
    assert text.endswith("(the first 10 rows; a file or a pipe gets all of them)\n")
    text = ask(sql, "table")
    assert text.count("x" * 200) == 5000
    assert text.endswith("(5000 rows)\n")


def test_a_closed_stdout(queried: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(QueryError, match="stdout is closed"):
        run_query(queried.index_path, "SELECT 1")


def test_rows_for_python(queried: Store) -> None:
    """The store by its folder; the values as Python, Arrow and pandas have them."""
    sql = """
        SELECT 7 AS n, NULL AS nothing, 'é' AS text, [1.5, NULL] AS list, {'x': 1} AS struct,
               TIMESTAMP '2026-05-04 09:30:00' AS time, DATE '2026-05-04' AS day, 'NaN'::DOUBLE AS nan
    """
    result = query_rows(str(queried.root), sql)
    assert result.columns == ["n", "nothing", "text", "list", "struct", "time", "day", "nan"]
    assert len(result) == 1
    (row,) = result.fetchall()
    day = datetime.date(2026, 5, 4)
    assert row[:-1] == (7, None, "é", [1.5, None], {"x": 1}, datetime.datetime(2026, 5, 4, 9, 30), day)
    assert math.isnan(row[-1])
    assert result.arrow().column("n").to_pylist() == [7]
    assert result.df().shape == (1, 8)
    assert query_rows(queried, "SELECT 1 AS x WHERE false").fetchall() == []
    assert len(query_rows(queried.root, "FROM range(300000)")) == 300_000
    assert "physical_plan" in query_rows(queried, "EXPLAIN SELECT 1").fetchall()[0]


def test_a_data_frame_without_pandas(queried: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    result = query_rows(queried, "SELECT 1")
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(QueryError, match="pip install pandas"):
        result.df()


def test_an_index_that_another_program_writes_to(queried: Store) -> None:
    """The remedy is to close it there, not to make the index anew."""
    code = "import duckdb, sys; c = duckdb.connect(sys.argv[1]); print(flush=True); sys.stdin.read()"
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", code, str(queried.index_path)]
    with subprocess.Popen(command, stdin=pipe, stdout=pipe) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        words = "another program has it open for writing; close it"
        for action in (lambda: query_rows(queried, "SELECT 1"), lambda: select(queried, "SELECT 1")):
            with pytest.raises(StoreError, match=words):
                action()
        with pytest.raises(StoreError, match=words):
            verify(queried)
        holder.kill()


def test_order_and_number_of_many_rows(ask: Any) -> None:
    rows = json.loads(ask("SELECT 50000 - range AS n FROM range(50000) ORDER BY n"))
    assert [row["n"] for row in rows] == list(range(1, 50001))


def test_columns_of_the_same_name_are_kept_apart(ask: Any) -> None:
    assert json.loads(ask("SELECT 1 AS a, 2 AS a")) == [{"a": 1, "a_1": 2}]


def test_parquet(queried: Store, tmp_path: Path) -> None:
    output = tmp_path / "it's.parquet"
    run_query(queried.index_path, "FROM segments;", format="parquet", output=output)
    assert duckdb.read_parquet(str(output)).count("*").fetchall() == [(5,)]
    assert list(tmp_path.iterdir()) == [output]


@pytest.mark.parametrize(
    "sql",
    [
        "FROM frames",
        "WITH t AS (SELECT 1) FROM t; -- the end",
        "DESCRIBE frames",
        "SHOW TABLES",
        "SUMMARIZE segments",
        "EXPLAIN SELECT count(*) FROM frames",
        "EXPLAIN ANALYZE FROM frames;",
        "FROM flight_summary",
    ],
)
def test_reading_statements(ask: Any, sql: str) -> None:
    assert ask(sql, "table").rstrip().endswith(("row)", "rows)"))


def test_files_on_demand(ask_child: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    spans = tmp_path_factory.mktemp("files") / "spans.csv"
    spans.write_text("span,length_m\nA,80\n")
    assert json.loads(ask_child(f"FROM read_csv('{spans}')", allow_files=True)) == [
        {"span": "A", "length_m": 80}
    ]


def test_no_index_yet(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="run lsnet-pipe process first"):
        run_query(tmp_path / "index.duckdb", "SELECT 1")


def test_corrupt_and_newer_index(tmp_path: Path) -> None:
    path = tmp_path / "index.duckdb"
    path.write_bytes(b"not a database" * 1000)
    with pytest.raises(StoreError, match="index rebuild"):
        run_query(path, "SELECT 1")
    path.unlink()
    with duckdb.connect(path) as connection:
        connection.execute(f"CREATE TABLE schema_version AS SELECT {len(MIGRATIONS) + 1} AS version")
    with pytest.raises(StoreVersionError, match="upgrade"):
        run_query(path, "SELECT 1")


def test_an_output_that_cannot_be_written(
    queried: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer_here(monkeypatch)
    for output in (tmp_path / "missing" / "rows", tmp_path):
        with pytest.raises(QueryError, match="use another file"):
            run_query(queried.index_path, "SELECT 1", output=output)


app = typer.Typer()
app.command()(query)
app.add_typer(index_command.app, name="index")


def test_command(queried: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answer_here(monkeypatch)
    runner = CliRunner()
    arguments = ["query", "SELECT count(*) AS n FROM frames", "--store", str(queried.root)]
    assert json.loads(runner.invoke(app, [*arguments, "--format", "json"]).stdout) == [{"n": 4}]
    assert runner.invoke(app, [*arguments, "--format", "csv"]).stdout == "n\n4\n"
    assert "(1 row)" in runner.invoke(app, arguments).stdout
    output = tmp_path / "n.parquet"
    assert runner.invoke(app, [*arguments, "--format", "parquet", "-o", str(output)]).exit_code == 0
    assert duckdb.read_parquet(str(output)).fetchall() == [(4,)]
    parquet = runner.invoke(app, [*arguments, "--format", "parquet"]).stdout_bytes
    assert parquet == output.read_bytes()
    assert runner.invoke(app, [*arguments, "--format", "xml"]).exit_code == 2
    refused = runner.invoke(app, ["query", "DROP TABLE frames", "--store", str(queried.root)])
    assert isinstance(refused.exception, QueryError)


def test_index_commands(tmp_path: Path) -> None:
    runner = CliRunner()
    store = Store(tmp_path)
    flight_id = flights.write_flight(store, "a", 3)
    assert runner.invoke(app, ["index", "verify", "--store", str(tmp_path)]).exit_code == 1
    assert runner.invoke(app, ["index", "rebuild", "--store", str(tmp_path)]).stdout == "1 flight\n"
    assert runner.invoke(app, ["index", "verify", "--store", str(tmp_path)]).exit_code == 0
    (store.flight_dir(flight_id) / "lines.parquet").unlink()
    rebuilt = runner.invoke(app, ["index", "rebuild", "--store", str(tmp_path)])
    assert (rebuilt.exit_code, rebuilt.stdout) == (1, "0 flights\n")
    assert "process its recording again" in rebuilt.stderr


def test_a_reader_that_goes_away(queried: Store) -> None:
    code = "import typer; from inspect_pipeline.commands.query import query; typer.run(query)"
    arguments = ["FROM range(10000000)", "--format", "csv", "--store", str(queried.root)]
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=pipe, stderr=pipe) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == b"range\n"
        process.stdout.close()
        assert process.stderr.read() == b""


@pytest.mark.parametrize("width", [40, 60, 100])
def test_tables_fit_the_terminal(width: int) -> None:
    """In columns that are cut where that is enough, else a row as a block of lines."""
    names = [f"column_{i}" for i in range(8)]
    out = io.StringIO()
    rows = query_output.QueryRows(names, ["VARCHAR"] * 8, iter([tuple("x" * 5 * i for i in range(8))] * 2))
    query_output.write_table(rows, out, max_rows=10, width=width)
    text = out.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert all(name in text for name in names)
    assert text.endswith("(2 rows)\n")
