"""The command line of `export`: formats by suffix, wrong pairs, stdout, exit codes."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import flights
import pytest
import typer
from typer.testing import CliRunner

from inspect_pipeline.commands.export import export

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from click.testing import Result

    from inspect_pipeline.store.store import Store


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return flights.published_store(tmp_path_factory.mktemp("store"), a=3, b=5)


@pytest.fixture
def run(store: Store) -> Callable[..., Result]:
    app = typer.Typer()
    app.command()(export)
    return lambda *arguments: CliRunner().invoke(app, [*map(str, arguments), "--store", str(store.root)])


@pytest.mark.parametrize(
    ("suffix", "chosen", "n_rows"), [(".geojson", "a.mcap", 3), (".csv", "--all", 8), (".json", "--all", 8)]
)
def test_flights_and_suffixes(
    run: Callable[..., Result], tmp_path: Path, suffix: str, chosen: str, n_rows: int
) -> None:
    path = tmp_path / f"frames{suffix}"
    done = run(chosen, "--what", "frames", "-o", path)
    if suffix == ".csv":
        assert done.stdout == f"{path}: {n_rows} rows of frames\n"
    else:  # these flights have no positions
        assert done.stdout == f"{path}: {n_rows} rows of frames, {n_rows} without a place\n"
        assert [one["geometry"] for one in json.loads(path.read_text())["features"]] == [None] * n_rows


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["last", "--what", "lines", "-o", "x.kml"], "can be exported as csv, parquet, rrd, not as kml"),
        (["last", "-o", "x.foo"], "names no format"),
        (["last", "--what", "evidence", "--format", "gpkg", "-o", "x"], "jpeg, coco, labelme, esri-oriented"),
        (["last", "--all", "-o", "x.csv"], "give a FLIGHT"),
        (["-o", "x.csv"], "give a FLIGHT"),
        (["--anomaly", "0a", "--redact", "drop", "-o", "x.mcap"], "as it is"),
        (["--anomaly", "0a", "-o", "x.csv"], "name an .mcap file"),
        (["--all", "-o", "x.rrd"], "holds one flight"),
    ],
)
def test_wrong_usage(
    run: Callable[..., Result],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*arguments)
    assert done.exit_code == 2
    assert said in " ".join(done.output.replace("│", " ").split())
    assert not list(tmp_path.iterdir())


def test_a_pipe_is_written_to(run: Callable[..., Result], tmp_path: Path) -> None:
    """/dev/stdout is a link to what the shell opened."""
    (tmp_path / "file").write_text("before\n")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert run("--all", "--what", "frames", "--format", "csv", "-o", tmp_path / "link").exit_code == 0
    assert (tmp_path / "link").is_symlink()
    assert len((tmp_path / "file").read_text().splitlines()) == 9


def test_where_nothing_is_flagged_there_is_no_evidence(run: Callable[..., Result], tmp_path: Path) -> None:
    done = run("--all", "--what", "evidence", "-o", tmp_path / "out")
    assert (done.exit_code, done.stdout) == (0, f"{tmp_path / 'out'}: 0 images\n")
